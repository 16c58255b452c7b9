"""One row of a fleet, in a process of its own: from machine and log to the files of its result."""

import json
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, Self

from sgms_mhe.api.diagnosis import diagnose
from sgms_mhe.api.estimation import estimate
from sgms_mhe.api.fleet.table import Row, Verb
from sgms_mhe.api.identification import identify
from sgms_mhe.diagnosis.result import Standing
from sgms_mhe.evaluation.watching import RunSummary
from sgms_mhe.machine import Kind, Machine
from sgms_mhe.model import build_model
from sgms_mhe.model.effects import BASE_CAUSES
from sgms_mhe.report import attempt_report
from sgms_mhe.signals.estimates import write_estimates
from sgms_mhe.support.json_values import finite

RESULT: Final = "result.json"
_USUAL: Final = frozenset({"hold", "filling"})
"""Flags of a log that stands still at times and has a beginning."""


@dataclass(frozen=True)
class FleetNumber:
    """A number a log determines: one standard deviation, and the machine file's value (NaN where it has none).

    The name is that of a linear axis, an effect's label before its parameter: `coulomb`, `force_ripple.amplitude_N`.
    """

    name: str
    value: float
    std: float
    nominal: float


@dataclass(frozen=True)
class Result:
    """Result of a row.

    Attributes:
        verdict: of a diagnosis; of an estimation `good` or its most frequent flag; of an identification the law.
        standing: how far that holds.
        summary: one sentence.
        kind: of the axis.
        machine: name of the machine.
        numbers: that the log determines.
        notes: on how the log was read.
    """

    verdict: str
    standing: Standing
    summary: str
    kind: Kind
    machine: str
    numbers: tuple[FleetNumber, ...]
    notes: tuple[str, ...]

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> Self:
        """Out of a result's file."""
        numbers = tuple(
            FleetNumber(n["name"], n["value"], n["std"], math.nan if n["nominal"] is None else n["nominal"])
            for n in content["numbers"]
        )
        return cls(**{**content, "numbers": numbers, "notes": tuple(content["notes"])})


def work(verb: Verb, row: Row, machine: Machine | None, table: Mapping[str, Any]) -> dict[str, bytes]:
    """Return the files of a row's result: result.json, and those that the command of the verb's name writes.

    Args:
        verb: which command.
        row: of the fleet's table.
        machine: of the row; None: the log speaks for itself.
        table: content of a table `[log]` that is laid over the machine's.

    Raises:
        InputError: bad input of that command.
    """
    notes: list[str] = []
    with TemporaryDirectory() as scratch:
        folder = Path(scratch)
        if machine is None or verb == "identify":
            result = _identify(row, machine, table, folder, notes)
        elif verb == "estimate":
            result = _estimate(row, machine, folder, notes)
        else:
            result = _diagnose(row, machine, folder, notes)
        _write_json(folder / RESULT, asdict(result))
        return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def json_text(content: Any) -> str:
    """A file of results as JSON."""
    return json.dumps(finite(content), indent=1, allow_nan=False) + "\n"


def _write_json(path: Path, content: Any) -> None:
    path.write_text(json_text(content), encoding="utf-8")


def _diagnose(row: Row, machine: Machine, folder: Path, notes: list[str]) -> Result:
    # The row may be worked on by another host: no path from its scratch folder leads anywhere.
    found = replace(diagnose(machine, row.log, note=notes.append), standalone=True)
    _write_json(folder / "diagnosis.json", found.to_json())
    attempt_report(found, folder, notes.append)
    effects = [cause for cause in found.causes if cause.name not in BASE_CAUSES and found.identifies(cause)]
    numbers = [FleetNumber(b.name, b.refitted, b.std, b.nominal) for b in found.base]
    numbers += [
        FleetNumber(f"{cause.label}.{name}", value, cause.std.get(name, math.nan), math.nan)
        for cause in effects
        for name, value in cause.parameters.items()
    ]
    return Result(
        found.verdict,
        found.standing,
        found.summary,
        machine.plant.kind,
        machine.name,
        _finite_numbers(numbers),
        (*notes, *found.warnings),
    )


def _estimate(row: Row, machine: Machine, folder: Path, notes: list[str]) -> Result:
    estimates = estimate(machine, row.log, note=notes.append)
    write_estimates(folder / "estimates.csv", estimates)
    run = RunSummary(machine, build_model(machine))
    run.add(estimates)
    found = run.summary()
    numbers = [FleetNumber(name, p["estimate"], p["std"], p["nominal"]) for name, p in found["parameters"].items()]
    verdict, summary = _judge(machine, found)
    standing: Standing = "certain" if verdict == "good" else "undecided"
    return Result(verdict, standing, summary, machine.plant.kind, machine.name, _finite_numbers(numbers), tuple(notes))


def _judge(machine: Machine, found: Mapping[str, Any]) -> tuple[str, str]:
    """How an estimation went: `good`, or the flag that more updates had than had none, or none but of a standstill."""
    counts, rms = dict(found["status"]), found["residual_rms_N"]
    good = counts.pop("good")
    worst = max(counts.keys() - _USUAL, key=lambda name: counts[name])
    usual = good + max(counts[name] for name in _USUAL)
    left = "nothing" if rms is None else f"{rms:.3g} {machine.plant.units.force}"
    said = "".join(f", {count} {name}" for name, count in counts.items() if count)
    summary = f"{found['updates']} updates, {good} good{said}; measured minus estimated {left} rms"
    return ("good" if usual >= counts[worst] else worst), summary


def _identify(row: Row, machine: Machine | None, table: Mapping[str, Any], folder: Path, notes: list[str]) -> Result:
    name = machine_name(row.axis)
    found = identify(row.log, name, mass=row.mass, like=machine, table=table, note=notes.append)
    (folder / f"{name}.toml").write_text(found.toml, encoding="utf-8")
    _write_json(folder / "identification.json", found.to_json())
    return Result(
        found.law,
        "limited" if found.limits else "certain",
        f"{found.machine.friction.n_z} elements; {found.others[-1].sentence}",
        found.machine.plant.kind,
        name,
        _finite_numbers(FleetNumber(n.name, n.value, n.std, math.nan) for n in found.numbers if n.determined),
        (*found.limits, *found.warnings),
    )


def machine_name(axis: str) -> str:
    """A name a machine may have, out of that of an axis."""
    plain = re.sub(r"\W+", "_", axis, flags=re.ASCII).strip("_").lower() or "axis"
    return plain if plain[0].isalpha() else f"axis_{plain}"


def _finite_numbers(numbers: Iterable[FleetNumber]) -> tuple[FleetNumber, ...]:
    return tuple(n for n in numbers if math.isfinite(n.value) and math.isfinite(n.std) and n.std > 0.0)
