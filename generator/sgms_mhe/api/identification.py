"""From logs alone to a machine."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from sgms_mhe.api.inputs import LOGGER, LogSource, Note, Step, load, read_logs
from sgms_mhe.configuration import override_log
from sgms_mhe.identification import Identification, Wanted
from sgms_mhe.identification import identify as identify_logs
from sgms_mhe.identification.survey import Survey
from sgms_mhe.identification.survey import survey as survey_logs
from sgms_mhe.machine import Machine, Units
from sgms_mhe.machine.writing import toml_log
from sgms_mhe.recordings.output_error import check_objective
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.notebooks import read_only
from sgms_mhe.support.options import Option


def identify(
    logs: LogSource | Iterable[LogSource],
    name: str = "axis",
    *,
    mass: Annotated[float | None, Option("KG", 1e-9, 1e6)] = None,
    inertia: Annotated[float | None, Option("KG_M2", 1e-12, 1e6)] = None,
    elements: int | None = None,
    like: Annotated[str | Path | Machine | None, Option("MACHINE")] = None,
    table: Mapping[str, Any] | None = None,
    objective: Annotated[Literal["force", "motion", "both"], Option()] = "force",
    note: Note | None = None,
    progress: Step | None = None,
) -> Identification:
    """Identify an axis from its logs alone; no starting values are asked for.

    Args:
        logs: one log or several of one axis at one rate, in any order: files, Logs, DataFrames or arrays by name. All
            with a force; or with none but a command: runs that state load, gain and supply, or any with a command that
            the [drive] of `like` takes, whose torque constant and resistance stay.
        name: of the machine.
        mass: moved mass [kg]; None: the one that the motion shows.
        inertia: the same of a rotary axis [kg m^2], as its logs say it is.
        elements: number of friction elements, 1 to 10; None: as many as held-out data gain by.
        like: take sampling, estimator, code and [log] from this machine.
        table: content of a table `[log]`, laid over that of `like`; without `like` it stands in the file.
        objective: force: all numbers are fitted to it; motion: mass, level, damping and sizes of effects then once
            more, to the motion the force alone makes; both: each error over its noise.
        note: called with each sentence on how the logs were read; None: they are `LogWarning`s.
        progress: called with each step; None: the logger `sgms_mhe.progress` is.

    Returns:
        The machine, the text of its file as `toml`, and every number with its standard deviation.

    Raises:
        InputError: logs that cannot tell: without motion, below break-away, of different rates, ...
    """
    check_objective("identify", objective)
    model = None if like is None else override_log(load(like), table or {})
    read = read_logs(logs, model, table=table, note=note)
    moved = _moved_mass(read[0].units, mass, inertia)
    found = identify_logs(read, Wanted(name, moved, elements, model, objective), progress or LOGGER.info)
    own = toml_log(table, read[0].kind) if table and model is None else ""
    return read_only(replace(found, toml=found.toml + own))


def survey(
    logs: LogSource | Iterable[LogSource],
    name: str = "axis",
    *,
    mass: float | None = None,
    inertia: float | None = None,
    table: Mapping[str, Any] | None = None,
    note: Note | None = None,
    progress: Step | None = None,
) -> Survey:
    """Take a first look at an axis by its logs, in seconds: least squares, where `identify` searches.

    Args:
        logs, name, mass, inertia, table, note, progress: as of `identify`.

    Returns:
        Statements on sign, mass, friction, constant force and noise, and on open questions.

    Raises:
        InputError: as `identify`; a log that is of no such axis.
    """
    read = read_logs(logs, table=table, note=note)
    moved = _moved_mass(read[0].units, mass, inertia)
    return survey_logs(read, Wanted(name, moved), progress or LOGGER.info)


def _moved_mass(units: Units, mass: float | None, inertia: float | None) -> float | None:
    """Return the one of the axis's kind. Raises InputError for the other one."""
    own, other, option = (mass, inertia, "inertia") if units.kind == "linear" else (inertia, mass, "mass")
    if other is not None:
        raise InputError(
            "identify", option, other, f"{units.inert} [{units.mass}]: the logs are of a {units.kind} axis"
        )
    return own
