"""Measured records by their protocol: fitted on one stretch, compared on another one."""

import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sgms_bench.measured.table import Beginning, MeasuredRecord, MeasuredTable
from sgms_mhe.api.diagnosis import diagnose
from sgms_mhe.api.estimation import predict
from sgms_mhe.api.identification import identify
from sgms_mhe.api.inputs import load, read_log
from sgms_mhe.api.starting import start_text
from sgms_mhe.configuration import override_log, override_machine
from sgms_mhe.diagnosis import Diagnosis
from sgms_mhe.evaluation.prediction import ForceError, PredictedFriction, force_error
from sgms_mhe.machine import Machine
from sgms_mhe.signals.chain import Signals, signals_from_log
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.tables import CsvTable

Array = NDArray[np.float64]
SIGMAS: Final = 2.0
"""Half an interval of 95 % [standard deviations]."""
CAUSES_SHOWN: Final = 4


@dataclass(frozen=True)
class MeasuredOutcome:
    """Result of one record from one beginning.

    Attributes:
        name: of the record.
        begin: what the diagnosis began from.
        published: of others, by name; in percent of the force or in the force's unit, as `published_in` says.
        published_in: percent or rms.
        unit: of the force.
        ours: error of the extended machine, without what was learned, on the stretch that no fit has seen; None: it was
            refused.
        learned: error there with what was learned; None: nothing was.
        plain: the same of Coulomb and viscous friction by least squares.
        verdict: of the diagnosis, with its causes; or the sentence of a refusal.
        numbers: numbers that both halves have; 0: one half alone was diagnosed.
        apart: those of them whose interval of the difference does not hold zero, each with its two values.
        seconds: of this beginning.
    """

    name: str
    begin: Beginning
    published: Mapping[str, float]
    published_in: str
    unit: str
    ours: ForceError | None
    plain: ForceError
    verdict: str
    learned: ForceError | None = None
    numbers: int = 0
    apart: tuple[str, ...] = ()
    seconds: float = 0.0

    @property
    def best(self) -> ForceError | None:
        """Error of the extended machine, which has what was learned where that gains."""
        return self.ours if self.learned is None else self.learned


@dataclass(frozen=True)
class _Protocol:
    """Logs of a record: all of it, the part that is fitted, and the part that is compared."""

    record: MeasuredRecord
    log: Log
    fit: tuple[float, float]
    compared: Log
    predict: tuple[float, float]

    @property
    def training(self) -> Log:
        """Stretch that models see."""
        return self.log.part(*self.fit)

    @property
    def unseen(self) -> Log:
        """Stretch that they do not see, as a log of its own."""
        return self.compared.part(*self.predict)


def run_table(table: MeasuredTable, *, halves: bool = False) -> Iterator[MeasuredOutcome]:
    """Run every record of a table from each of its beginnings.

    Args:
        table: records and folder.
        halves: diagnose the compared stretch too, and compare the numbers of both.

    Raises:
        InputError: a log or machine that cannot be read.
    """
    for record in table.records:
        for begin in record.beginnings:
            yield _run_record(table, record, begin, halves=halves)


def _run_record(table: MeasuredTable, record: MeasuredRecord, begin: Beginning, *, halves: bool) -> MeasuredOutcome:
    started = time.monotonic()
    stated = None if record.machine is None else override_log(_load(table, record.machine), record.table)
    protocol = _read_protocol(table, record, stated)
    machine: Machine | None = None
    found: Diagnosis | None = None
    try:
        machine = _begin(record, stated, protocol, begin, protocol.training)
        found = diagnose(machine, protocol.training, note=_ignore)
        verdict = _describe(found)
    except InputError as error:
        verdict = f"refused: {error.where}: {error.allowed}"
    reference = machine or stated or _make_start(record, protocol.training)
    axis = machine if found is None or found.extended is None else found.extended
    named, taught = axis, None
    if axis is not None and found is not None and found.learned is not None and found.learned.in_file:
        named, taught = override_machine(axis, {"learned": False}), axis
    ours = None if found is None or named is None else _compare(record, predict_of(named, protocol), protocol)
    outcome = MeasuredOutcome(
        name=record.name,
        begin=begin,
        published=record.published,
        published_in=record.published_in,
        unit=reference.plant.units.force,
        ours=ours,
        plain=_compare(record, predict_plain(_set_lowpass(reference, record), protocol), protocol),
        verdict=verdict,
        learned=None if taught is None else _compare(record, predict_of(taught, protocol), protocol),
    )
    if halves and found is not None:
        outcome = _add_halves(outcome, found, record, stated, protocol, begin)
    return replace(outcome, seconds=time.monotonic() - started)


def _load(table: MeasuredTable, name: str) -> Machine:
    path = table.locate(name)
    return load(path if path.is_file() else name)


def _ignore(sentence: str) -> None:
    """Take a sentence on how a log was read; the table says what came of it."""


def _read_protocol(table: MeasuredTable, record: MeasuredRecord, stated: Machine | None) -> _Protocol:
    def read(name: str) -> Log:
        return read_log(table.locate(name), stated, table=None if stated is not None else record.table, note=_ignore)

    log = read(record.log)
    end = float(log.time_s[-1] - log.time_s[0])
    fit = record.fit or ((0.0, end) if record.other else (0.0, 0.5 * end))
    if record.other is not None:
        return _Protocol(record, log, fit, read(record.other), record.predict or (0.0, math.inf))
    return _Protocol(record, log, fit, log, record.predict or (0.5 * end, end))


def _begin(record: MeasuredRecord, stated: Machine | None, protocol: _Protocol, begin: Beginning, log: Log) -> Machine:
    """Return the machine that a diagnosis of a stretch begins from."""
    if begin == "file":
        if stated is None:
            raise ValueError("a record without a machine has no file to begin from")
        return stated
    if begin == "start":
        return _make_start(record, protocol.training)
    given = record.start.mass if "mass" in record.start.model_fields_set and not log.is_friction_alone else None
    own = (given, None) if log.kind == "linear" else (None, given)
    return identify(log, mass=own[0], inertia=own[1], note=_ignore).machine


def _make_start(record: MeasuredRecord, log: Log) -> Machine:
    speed = np.abs(np.gradient(log.position_m) * log.rate) if log.velocity_m_s is None else np.abs(log.velocity_m_s)
    fastest = float(np.nanmax(speed))
    stated = record.start.model_dump() | {"max_velocity": record.start.max_velocity or 2.0 * fastest}
    return start_text(Path("measured.toml"), log.kind, rate=float(f"{log.rate:.6g}"), **stated)[1]


def _set_lowpass(machine: Machine, record: MeasuredRecord) -> Machine:
    """Return a machine with the low-pass of the comparison."""
    if record.lowpass is None:
        return machine
    return override_machine(machine, {"sampling": {"velocity_cutoff": record.lowpass}})


def predict_of(machine: Machine, protocol: _Protocol) -> PredictedFriction:
    """Run a machine along all of the log that it is compared on."""
    return predict(machine, protocol.compared, lowpass_Hz=protocol.record.lowpass, note=_ignore)


def predict_plain(machine: Machine, protocol: _Protocol) -> PredictedFriction:
    """Return Coulomb and viscous friction along the compared log: least squares over the fitted stretch.

    An offset stands beside them and, where a force was logged, the mass. `machine`: whose signal chain counts.
    """
    seen, compared = (signals_from_log(log, machine) for log in (protocol.training, protocol.compared))
    b = np.linalg.lstsq(_columns(seen)[seen.valid], seen.friction[seen.valid], rcond=1e-12)[0]
    measured = np.where(compared.valid, compared.friction, np.nan)
    source, kind = protocol.compared.source, machine.plant.kind
    return PredictedFriction(compared.time, measured, _columns(compared) @ b, compared.force, source, kind)


def _columns(signals: Signals) -> Array:
    v, a = signals.velocity, signals.acceleration
    inertial = np.zeros_like(a) if np.array_equal(signals.force, signals.friction) else a
    return np.column_stack((np.sign(v), v, np.ones(len(v)), inertial))


def _compare(record: MeasuredRecord, prediction: PredictedFriction, protocol: _Protocol) -> ForceError:
    start, end = protocol.predict
    return force_error(prediction, start_s=start, end_s=end, factor=record.decimate)


def _describe(found: Diagnosis) -> str:
    names = [cause.name for cause in found.causes]
    more = [f"{len(names) - CAUSES_SHOWN} more"] if len(names) > CAUSES_SHOWN else []
    return f"{found.verdict}: {', '.join([*names[:CAUSES_SHOWN], *more]) or 'no cause'}"


def _add_halves(
    outcome: MeasuredOutcome,
    found: Diagnosis,
    record: MeasuredRecord,
    stated: Machine | None,
    protocol: _Protocol,
    begin: Beginning,
) -> MeasuredOutcome:
    """Return the outcome with the share of numbers on which both stretches agree."""
    try:
        other = diagnose(_begin(record, stated, protocol, begin, protocol.unseen), protocol.unseen, note=_ignore)
    except InputError:
        return outcome
    pairs = pair_numbers(found, other)
    apart = tuple(
        f"{name} {a:.4g} +- {SIGMAS * s:.2g} and {b:.4g} +- {SIGMAS * t:.2g}"
        for name, (a, s, b, t) in pairs.items()
        if abs(a - b) > SIGMAS * math.hypot(s, t)
    )
    return replace(outcome, numbers=len(pairs), apart=apart)


def pair_numbers(one: Diagnosis, other: Diagnosis) -> dict[str, tuple[float, float, float, float]]:
    """Return (value, deviation, value, deviation) of each number that two diagnoses both determine, by its name."""
    first, second = _numbers(one), _numbers(other)
    return {".".join(key): (*first[key], *second[key]) for key in first if key in second}


def _numbers(found: Diagnosis) -> dict[tuple[str, str], tuple[float, float]]:
    """Determined numbers of a diagnosis with their deviations: of the base model, and of causes that stand once.

    An interval of the base model that reaches zero says nothing, and holds whatever the other half says.
    """
    known: dict[tuple[str, str], tuple[float, float]] = {
        ("base", number.name): (number.refitted, number.std)
        for number in found.base
        if SIGMAS * number.std < number.refitted
    }
    for cause in found.causes:
        if cause.nominal or cause.label != cause.name:
            continue
        for name, value in cause.parameters.items():
            if name not in cause.vague:
                known[cause.name, _name_harmonic(name, cause.parameters)] = value, cause.std[name]
    return {key: (value, std) for key, (value, std) in known.items() if math.isfinite(std) and std > 0.0}


def _name_harmonic(name: str, parameters: Mapping[str, float]) -> str:
    """Return the name of a number with the order of its harmonic: which comes first in a map differs by the record."""
    part, _, rest = name.partition("_")
    place, _, unit = rest.partition("_")
    order = parameters.get(f"order_{place}")
    return name if order is None or part == "order" else f"{part}_{unit} of order {order:g}"


@dataclass
class MeasuredTally:
    """Outcomes as they come, and their tables."""

    outcomes: list[MeasuredOutcome] = field(default_factory=list)

    def add(self, outcome: MeasuredOutcome, tell: Callable[[str], None]) -> None:
        """Keep one and say it."""
        self.outcomes.append(outcome)
        error = "-" if outcome.ours is None else f"{outcome.ours.residual_rms_N:.4g} {outcome.unit}"
        more = "" if outcome.learned is None else f", learned {outcome.learned.residual_rms_N:.4g} {outcome.unit}"
        tell(f"{outcome.name} from {outcome.begin}: {error}{more}, {outcome.verdict} ({outcome.seconds:.0f} s)")

    def tables(self) -> list[CsvTable]:
        """Return ours beside the published numbers; and how often both halves agree, where both were diagnosed."""
        rows: list[dict[str, Any]] = []
        for o in self.outcomes:
            best = min(o.published.items(), key=lambda item: item[1], default=None)
            rows.append(
                {
                    "record": o.name,
                    "from": o.begin,
                    "unit": o.unit,
                    "ours": None if o.ours is None else o.ours.residual_rms_N,
                    "learned": None if o.learned is None else o.learned.residual_rms_N,
                    "plain": o.plain.residual_rms_N,
                    "best [%]": None if o.best is None else 100.0 * o.best.relative,
                    "plain [%]": 100.0 * o.plain.relative,
                    "published": "" if best is None else f"{best[1]:g}{' %' * (o.published_in == 'percent')} {best[0]}",
                    "ahead": "" if best is None else "yes" if self._is_ahead(o, best[1]) else "no",
                    "verdict": o.verdict,
                }
            )
        formats = {"record": "", "from": "", "unit": "", "ours": ".4g", "learned": ".4g"}
        formats |= {"plain": ".4g", "best [%]": ".3g", "plain [%]": ".3g", "published": "", "ahead": "", "verdict": ""}
        ahead = sum(row["ahead"] == "yes" for row in rows)
        judged = sum(row["ahead"] != "" for row in rows)
        plain = sum(o.best is not None and o.best.residual_rms_N < o.plain.residual_rms_N for o in self.outcomes)
        notes = (
            f"ahead of the best published number: {ahead} of {judged}; of plain friction: {plain} of {len(rows)}",
            *self._coverage(),
        )
        title = "RMS of measured minus simulated force on the stretch that no fit has seen; % of the force there"
        return [CsvTable(title, formats, rows, notes)]

    @staticmethod
    def _is_ahead(outcome: MeasuredOutcome, published: float) -> bool:
        error = outcome.best
        if error is None:
            return False
        return (error.residual_rms_N if outcome.published_in == "rms" else 100.0 * error.relative) < published

    def _coverage(self) -> tuple[str, ...]:
        numbers = sum(o.numbers for o in self.outcomes)
        if not numbers:
            return ()
        apart = [f"  {o.name} from {o.begin}: {number}" for o in self.outcomes for number in o.apart]
        inside = numbers - len(apart)
        share = f"{inside} of {numbers} numbers, {100.0 * inside / numbers:.0f} %"
        return (f"both stretches agree within two standard deviations of their difference: {share}", *apart)
