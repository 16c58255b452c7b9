"""Result of a diagnosis: everything that diagnosis.json and a report need."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from sgms_mhe.diagnosis.combinations import KnownCombination
from sgms_mhe.diagnosis.document import make_document
from sgms_mhe.diagnosis.extension import extension_toml
from sgms_mhe.diagnosis.learned import Learned
from sgms_mhe.diagnosis.other_record import JudgedRecord, relative_errors
from sgms_mhe.diagnosis.own_numbers import OwnDifference
from sgms_mhe.diagnosis.parts import (
    Alternative,
    BaseParameter,
    Cause,
    PlainFriction,
    RefutedNumber,
    RivalFit,
    Rms,
    Score,
)
from sgms_mhe.diagnosis.structure import ResidualStructure
from sgms_mhe.diagnosis.traces import Traces
from sgms_mhe.diagnosis.written_file import WrittenError
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import cause as cause_definition
from sgms_mhe.model.effects import reported_name, separating_moves
from sgms_mhe.recordings.output_error import Refit
from sgms_mhe.support.libraries import data_frame
from sgms_mhe.support.notebooks import Presentation, Shown, labelled_axes
from sgms_mhe.support.statements import Rule, Statement, list_open

Verdict = Literal["explained", "unexplained", "ambiguous", "adequate"]
Standing = Literal["certain", "limited", "undecided", "failed", "nothing"]
"""How far a result holds: without reservation; but for numbers or questions that stay open; not decided; not; no
motion to judge by."""
TWICE: Final = "the same motion twice, and once at half the speed: what stays in place, in time or in velocity shows"
FINER: Final = "the same log with a lower [sampling] velocity_cutoff, or a finer encoder: what is below its noise shows"
PLATEAUS: Final = (
    "constant speeds from the slowest to the fastest, in both directions: friction over speed shows as it is"
)
MOTION: Final = "record a motion: strokes in both directions at several speeds, with reversals and rests"
"""Next moves: where something is left, where the encoder hides it, where it is a curve over speed, at a standstill."""
CHANCE: Final = 0.05
"""Chance that noise looks like a cause, from which the cause is not certain."""


@dataclass(frozen=True, repr=False)
class Diagnosis(Shown):
    """Verdict, causes and evidence. Parameters and numbers have a linear axis's names; files have those of the axis.

    Attributes:
        machine: as given.
        source: of the log.
        verdict: adequate, explained, ambiguous (others fit as well) or unexplained (something is left).
        rms: of the whole extension (an adequate machine: after = before).
        noise_floor_N: RMS of the friction measurement's noise at the fit's rate.
        structure_before, structure_after: of the residual.
        traces: decimated signals.
        law: of friction that fits the record, as in the machine file.
        excited: whether the axis moved.
        warnings: to the user about the record (gaps, saturation, too fast, too short).
        causes: strongest first.
        alternatives: candidates without a name; the rivals first.
        gain_interval_N: 95 % interval of the RMS of the explained force on held-out data.
        base: the base model's numbers.
        scores: every candidate of every round.
        extended: the extended machine, None where nothing is named or learned.
        changes: tables of its file that differ from the base's, as content of a machine file.
        seconds: computing time.
        rival_fits: of the alternatives that are rivals.
        undecided: questions open after any record of this motion.
        encoder_noise_N: RMS of the force the encoder's noise leaves, where most of the residual of an adequate or
            unexplained record is that; else 0.
        standalone: whether the extended machine's file has every table; otherwise it extends the base.
        plain: residual of plain friction on the same data.
        refuted: numbers of the machine file the record refutes.
        is_rough: whether the file was far from the record: then the diagnosis began from the record's numbers, which
            are no causes.
        offset_s: age of the logged force taken out, see `in_step`.
        records: all records where there are several, the first one first.
        combinations: of causes the record does not tell apart.
        learned: part of the residual no cause accounts for and coordinates of the motion predict.
        differences: numbers the records do not agree on; the extended machine has the first one's.
        written: errors of the machine's file and of the extended one along each record.
        refit: numbers the extended machine has by its motion; None where the force says all of them.
    """

    machine: Machine
    source: str
    verdict: Verdict
    rms: Rms
    noise_floor_N: float
    structure_before: tuple[ResidualStructure, ...]
    structure_after: tuple[ResidualStructure, ...]
    traces: Traces
    law: str
    excited: bool
    warnings: tuple[str, ...]
    causes: tuple[Cause, ...] = ()
    alternatives: tuple[Alternative, ...] = ()
    gain_interval_N: tuple[float, float] = (0.0, 0.0)
    base: tuple[BaseParameter, ...] = ()
    scores: tuple[Score, ...] = ()
    extended: Machine | None = None
    changes: Mapping[str, Any] | None = None
    seconds: float = 0.0
    rival_fits: tuple[RivalFit, ...] = ()
    undecided: tuple[Statement, ...] = ()
    encoder_noise_N: float = 0.0
    standalone: bool = False
    plain: PlainFriction | None = None
    refuted: tuple[RefutedNumber, ...] = ()
    is_rough: bool = False
    offset_s: float = 0.0
    records: tuple[JudgedRecord, ...] = ()
    combinations: tuple[KnownCombination, ...] = ()
    learned: Learned | None = None
    differences: tuple[OwnDifference, ...] = ()
    written: tuple[WrittenError, ...] = ()
    refit: Refit | None = None

    @property
    def errors(self) -> dict[str, float]:
        """Simulation error on held-out data over the RMS of the force there: before, after, of plain friction [1]."""
        plain, rms = self.plain, self.rms
        return (plain and relative_errors(rms.held_out_before, rms.held_out_after, plain.held_out, plain.force)) or {}

    @property
    def summary(self) -> str:
        """Return the verdict in one sentence."""
        return self._verdict.sentence

    @property
    def standing(self) -> Standing:
        """Return how far the verdict holds."""
        verdict = self._verdict
        if verdict.rule is Rule.STILL:
            return "nothing"
        standings: dict[str, Standing] = {"no": "failed", "open": "undecided"}
        return standings.get(verdict.sure, "limited" if self.limits else "certain")

    @property
    def limits(self) -> tuple[str, ...]:
        """Sentences on the questions left open by this record."""
        return tuple(statement.sentence for statement in list_open(self.statements))

    @property
    def separating_experiment(self) -> str | None:
        """Return the next thing to do, None if there is none."""
        moves = [f"{s.about}: {s.next}" if s.kind == "choice" else s.next for s in self.statements if s.next]
        return ". ".join(moves) or None

    def identifies(self, cause: Cause) -> bool:
        """Return True if a cause is certain, and the record determines its numbers."""
        return self.is_certain(cause) and not cause.vague

    def is_certain(self, cause: Cause) -> bool:
        """Return True if no rival of a cause fits as well, other records agree, and noise does not look like it."""
        return self.state_cause(cause).sure == "yes"

    def find_combination(self, cause: Cause) -> KnownCombination | None:
        """Return the combination with another cause known in place of its own numbers, if there is one."""
        return next((known for known in self.combinations if cause.label in known.causes), None)

    @property
    def statements(self) -> tuple[Statement, ...]:
        """Return every judgement, the verdict first."""
        learned = () if self.learned is None else self.learned.state(self.machine.plant.units.force)
        return (
            self._verdict,
            *self._state_residual(),
            *self._state_choices(),
            *(s for cause in self.causes for s in (self.state_cause(cause), *self.state_numbers(cause))),
            *(known.state() for known in self.combinations),
            *self.undecided,
            *self._state_records(),
            *learned,
            *(() if self.refit is None else (self.refit.state(self.machine.plant.units.position),)),
            *self._state_base(),
        )

    @property
    def said(self) -> tuple[Statement, ...]:
        """Return the statements but those on numbers of the base model a refit leaves, for terminal and file."""
        return tuple(statement for statement in self.statements if statement.rule is not Rule.REFITTED)

    def _state(
        self, rule: Rule, about: str, value: float, next: str | None = None, **numbers: float | str
    ) -> Statement:
        """Return a statement on a force."""
        return Statement(rule, about, value, None, self.machine.plant.units.force, numbers, next)

    @property
    def _verdict(self) -> Statement:
        """Return the statement on the record as a whole."""
        named = [cause.name for cause in self.causes]
        certain = ", ".join(cause.name for cause in self.causes if not cause.stands_for)
        if not self.excited:
            rule = Rule.STILL
        elif self.verdict == "unexplained":
            unnamed = Rule.UNEXPLAINED if certain else Rule.UNNAMED
            rule = Rule.HIDDEN if self.encoder_noise_N > 0.0 else unnamed
        elif self.verdict == "adequate":
            rule = Rule.ROUGH if self.is_rough else Rule.ADEQUATE
        else:
            rule = Rule.AMBIGUOUS if self.verdict == "ambiguous" else Rule.EXPLAINED
        others = dict.fromkeys(a.name for a in self.alternatives if a.rival and a.name not in named)
        return self._state(
            rule,
            "record",
            self.rms.held_out_after,
            None if self.excited else MOTION,
            before_N=self.rms.held_out_before,
            noise_floor_N=self.noise_floor_N,
            encoder_N=self.encoder_noise_N,
            names=certain or ", ".join(named) or "nothing",
            others=", ".join(others),
        )

    def _state_residual(self) -> Iterator[Statement]:
        """Yield open questions, with the motion or the log that shows more of it."""
        rms, move = self.rms.held_out_after, None
        if self.verdict == "unexplained":
            curved = any(cause.stands_for == "curve over speed" for cause in self.causes)
            move = FINER if self.encoder_noise_N > 0.0 else PLATEAUS if curved else TWICE
        if self.encoder_noise_N > 0.0:
            yield self._state(Rule.ENCODER, "residual", rms, move, encoder_N=self.encoder_noise_N)
        elif self.verdict == "unexplained" and self.excited:
            yield self._state(Rule.LEFT, "residual", rms, move, ratio=rms / self.noise_floor_N)

    def _state_choices(self) -> Iterator[Statement]:
        """Yield the choices between a named cause and a rival, with the move that makes each."""
        for a in self.alternatives:
            if a.rival and a.instead_of is not None:
                wanted = dict.fromkeys(cause_definition(name).excitation.text for name in (a.instead_of, a.name))
                move = next(iter(separating_moves(a.instead_of, a.name)), "; and ".join(wanted))
                names = {"named": a.instead_of, "rival": a.name}
                yield self._state(Rule.RIVAL, f"{a.instead_of} or {a.name}", math.nan, move, **names)

    def state_cause(self, cause: Cause) -> Statement:
        """Return the statement on a named cause: the gravest doubt, or the force it explains."""
        asked = {t.label for record in self.records[:1] for t in record.causes}  # the first too: they are of all
        doubts = {
            Rule.UNEQUAL: any(one.group.name == cause.label for one in self.differences),
            Rule.NOT_EVERYWHERE: cause.transfers is False and cause.label in asked,
            Rule.FIRST_ALONE: cause.transfers is False,
            Rule.NAMELESS: cause.stands_for == "what has no name",
            Rule.PART_OF_CURVE: cause.stands_for == "curve over speed",
            Rule.CHANCE: cause.p_value > CHANCE,
            Rule.HAS_RIVAL: any(a.rival and a.instead_of == cause.name for a in self.alternatives),
            Rule.COMBINED: self.find_combination(cause) is not None,
            Rule.NO_GAIN: not cause.gain_interval_N[0] > 0.0,
            Rule.TRANSFERS: bool(cause.transfers),
        }
        rule = next((rule for rule, holds in doubts.items() if holds), Rule.FOUND)
        numbers = {"p_value": cause.p_value}
        unit = self.machine.plant.units.force
        return Statement(rule, cause.label, cause.gain_N, cause.gain_interval_N, unit, numbers)

    def state_numbers(self, cause: Cause) -> Iterator[Statement]:
        """Yield the numbers of a cause."""
        units, settled = self.machine.plant.units, Rule.DETERMINED if self.is_certain(cause) else Rule.OF_DOUBTFUL
        differing = {one.reported_name: one.state(units) for one in self.differences}
        for name, value in cause.parameters.items():
            rule, about = Rule.VAGUE if name in cause.vague else settled, f"{cause.label}.{units.named(name)}"
            number = Statement.of_number(rule, about, value, cause.std.get(name, math.nan), units.unit(name))
            other = differing.get(name) or differing.get(f"{cause.label}.{name}")
            yield number if other is None else replace(other, about=about)

    def _state_records(self) -> Iterator[Statement]:
        """Yield the errors along each record, and whether the extended machine is worth anything there."""
        push = self.machine.plant.units.push
        errors = {record.name: record.errors for record in self.records} or {self.source: self.errors}
        for name, shares in errors.items():
            percents = {key: 100.0 * share for key, share in shares.items()}
            if percents:
                yield Statement(Rule.SEEN, name, percents.pop("after"), None, "%", percents | {"push": push})
        for record in self.records[1:] if self.extended is not None else ():
            if record.is_worse_than_plain:
                yield self._state(Rule.NOT_RECOMMENDED, record.name, record.held_out_after, plain_N=record.plain)
        yield from (said for one in self.written if self.extended is not None for said in one.state(push))

    def _state_base(self) -> Iterator[Statement]:
        """Yield the machine's numbers but those of causes: that differ between records, are refuted, are refitted."""
        units = self.machine.plant.units
        stated = {name for c in self.causes for key in c.parameters for name in (key, f"{c.label}.{key}")}
        own = [(one.reported_name, one.state(units)) for one in self.differences]
        for n in self.refuted if self.is_rough else ():
            unit, about = units.unit(n.name), units.named(n.name)
            own.append((n.name, Statement.of_number(Rule.REFUTED, about, n.record, n.std, unit, file=n.file)))
        for name, statement in own:
            if name not in stated:
                stated.add(name)
                yield statement
        for b in self.base:
            if (name := reported_name(b.name)) not in stated:
                value, rule = (b.refitted, Rule.REFITTED) if math.isfinite(b.std) else (math.nan, Rule.UNSEEN)
                yield Statement.of_number(rule, units.named(b.name), value, b.std, units.unit(name), file=b.nominal)

    @property
    def extended_name(self) -> str | None:
        """File name of the extended machine."""
        return None if self.extended is None else f"{self.extended.name}.toml"

    def extended_file(self, folder: str | Path = ".") -> str | None:
        """Return the extended machine's file as it is to lie in a folder: the path to the base leads from there."""
        if self.extended is None or self.changes is None:
            return None
        lines = [statement.line for statement in self.said]
        return extension_toml(self.machine, self.extended, self.changes, Path(folder), lines, alone=self.standalone)

    def to_frame(self) -> Any:
        """A pandas.DataFrame with a row per parameter of each cause: value, deviation, whether it is determined."""
        named = self.machine.plant.units.named
        rows = [(cause, name) for cause in self.causes for name in cause.parameters]
        columns = {
            "cause": np.array([cause.name for cause, _ in rows]),
            "parameter": np.array([named(name) for _, name in rows]),
            "value": np.array([cause.parameters[name] for cause, name in rows]),
            "std": np.array([cause.std.get(name, math.nan) for cause, name in rows]),
            "identified": np.array([self.identifies(cause) for cause, _ in rows]),
        }
        return data_frame(columns)

    def plot(self, axes: Any | None = None) -> Any:
        """Draw the residual over time before and after; return the matplotlib axes, those given or new ones."""
        axes = labelled_axes(axes, "time [s]", f"residual [{self.machine.plant.units.force}]")
        t, used = self.traces, self.traces.used
        axes.plot(t.time_s[used], t.residual_before[used], linewidth=0.6, color="0.6", label="before")
        axes.plot(t.time_s[used], t.residual_after[used], linewidth=0.6, label="after")
        axes.legend()
        return axes

    def _shown(self) -> Presentation:
        rows = [(s.kind, s.line, s.next or "") for s in self.said[1:]]
        return f"{self.verdict}: {self.summary}", ("kind", "statement (+-: 2 sigma)", "next"), rows

    def to_json(self) -> dict[str, Any]:
        """Content of diagnosis.json; non-finite numbers become null."""
        rms, named = self.rms, self.machine.plant.units.named
        return make_document(
            self.machine,
            self.verdict,
            self.statements,
            causes=[
                {
                    "name": cause.name,
                    "parameters": dict(cause.parameters),
                    "std": dict(cause.std),
                    "residual_rms_N": asdict(cause.rms),
                    "gain_N": cause.gain_N,
                    "gain_interval_N": list(cause.gain_interval_N),
                    "identified": self.identifies(cause),
                    "stands_for": cause.stands_for or None,
                    "transfers": cause.transfers,
                    "known_combination": None if (known := self.find_combination(cause)) is None else known.to_json(),
                }
                for cause in self.causes
            ],
            records=[record.to_json() for record in self.records],
            written=[one.to_json() for one in self.written],
            alternatives=[
                {"name": a.name, "why_not": a.why_not, "rival": a.rival, "parameters": dict(a.parameters)}
                for a in self.alternatives
            ],
            separating_experiment=self.separating_experiment,
            residual_rms_N=asdict(rms) | {"noise_floor": self.noise_floor_N},
            plain=None if self.plain is None else {"rms_N": self.plain.rms, "held_out_N": self.plain.held_out},
            simulation_error=self.errors,
            refuted=[{"name": named(n.name), "file": n.file, "record": n.record, "std": n.std} for n in self.refuted],
            extended_machine=self.extended_name,
            learned=None if self.learned is None else self.learned.to_json(),
            law=self.law,
            structure_left=[
                {"coordinate": s.coordinate, "rms_N": s.rms_N, "p_value": s.p_value, "peak": s.peak}
                for s in self.structure_after
            ],
            base=[
                {"name": named(b.name), "nominal": b.nominal, "refitted": b.refitted, "std": b.std} for b in self.base
            ],
            warnings=self.warnings,
        )
