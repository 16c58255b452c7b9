"""From logs alone to a machine."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from sgms_mhe.api.inputs import LogSource, Note, load, read_log
from sgms_mhe.identification import Identification, Wanted
from sgms_mhe.identification import identify as identify_logs
from sgms_mhe.machine import Machine


def identify(
    logs: Sequence[LogSource],
    name: str,
    *,
    mass: float | None = None,
    elements: int | None = None,
    like: str | Path | Machine | None = None,
    note: Note | None = None,
) -> Identification:
    """Identify an axis from its logs alone; no starting values are asked for.

    Args:
        logs: files, Logs or DataFrames of one axis at one rate, in any order.
        name: of the machine.
        mass: what moves [kg], of a rotary axis its inertia [kg m^2]; None: the one that the motion shows.
        elements: number of friction elements, 1 to 10; None: as many as held-out data gain by.
        like: take sampling, estimator, code and `[log]` from this machine.
        note: called with each step, and with each sentence on how the logs were read.

    Returns:
        The machine, the text of its file as `toml`, and every number with its standard deviation.

    Raises:
        InputError: logs that cannot tell: without motion, below break-away, of different rates, ...
    """
    model = None if like is None else load(like)
    read = [read_log(log, model, note=note) for log in logs]
    return identify_logs(read, Wanted(name, mass, elements, model), note or (lambda _: None))
