"""Criteria of a search for causes: gains that count, and candidates ranked by their gains."""

import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from sgms_mhe.diagnosis.fits import Fit, Subject
from sgms_mhe.diagnosis.parametrisation import CandidateEffect, ParameterGroup
from sgms_mhe.diagnosis.proposals import Proposal
from sgms_mhe.machine import DiagnosisTable, Machine
from sgms_mhe.model.effects import EFFECT_NAMES, Measure, cause, effect_definition, effect_names
from sgms_mhe.model.effects.search import Step
from sgms_mhe.model.scales import scales_of
from sgms_mhe.recordings.evidence import EQUAL_T as EQUAL_T
from sgms_mhe.recordings.evidence import cross_loss, gain_force
from sgms_mhe.recordings.excitation import in_step
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.parallel import run_parallel

Progress = Callable[[str, float], None]
"""Called with what is done now and the share of the work that was done before it, never less than the last time."""
BASE_BEGINS: Final = 0.02
SEARCH_BEGINS: Final = 0.05
RIVALS_BEGIN: Final = 0.5
JUDGEMENT_BEGINS: Final = 0.8
"""Where the stages begin, as a share of the time of a whole diagnosis: about what records with causes take."""
_LEFT: Final = 0.6
"""Of a stage, after each of its rounds: nobody knows how many there will be."""
_REFITS: Final = 0.4
"""Of a round: where refits begin."""
_ANY: Final[Mapping[str, float]] = defaultdict(float)
MATERIAL_NOISE: Final = 0.25
"""RMS gain that matters, at least this and `material` of the machine file [noise floor]: a smaller gain drowns."""
SMALL_GAIN: Final = 0.007
"""Gain from which on more than an effect explains may be left beside it, and of any wrong number [f_C]: a smaller one
may be a part of what is left, or of what the law gets wrong."""
GAIN_SHARE: Final = 0.25
"""Gain that an effect must have to be added [RMS beyond noise]: a small share of a lot only imitates a part of what is
really there. What is left when a search ends tells no smaller one from itself."""
PROMISING: Final = 0.7
"""Linear gain from which a candidate is refitted [gain to be added, of the cause whose place it takes, and of the best
one where its force is linear in its sizes]: a refit finds more."""
CLOSE: Final = 0.5
"""The same where a force is not linear in its sizes [of the best one], or known to be confused with a cause's: a refit
changes the order. RMS that a rival may leave more, however surely [gain that matters]."""
EQUAL_EXCESS: Final = 0.25
"""RMS by which two candidates for a place are equals [gain that matters]: it does not matter."""
MOST_ALIKE: Final = 2
"""Effects of one name, at most [1]: more sines are the Fourier series of something else."""
SMALL_SHARE: Final = 0.15
"""RMS that may be left of a force that is explained, and that a rival may leave more where t does not tell the two
apart or it does not matter [of that force]: 98 % of the power is explained."""
SAME_FORCE: Final = 0.985
"""Correlation from which two candidates make one force [1]: the one with fewer numbers is refitted."""


@dataclass(frozen=True)
class ProgressReport:
    """Tells `report` how far a diagnosis is."""

    report: Progress

    def report_start(self) -> None:
        """The log is made ready."""
        self.report("preparing the log", 0.0)

    def report_identification(self, step: str) -> None:
        """The record's own numbers are looked for: `step` of an identification."""
        self.report(f"the file is far from the record; identifying it: {step}", 0.0)

    def report_base(self) -> None:
        """The machine's own numbers are fitted."""
        self.report("refitting the base model", BASE_BEGINS)

    def report_search(self, number: int) -> None:
        """A round of the search begins; `number` from 1."""
        self.report(f"searching effects, round {number}", _within(SEARCH_BEGINS, RIVALS_BEGIN, number - 1.0))

    def report_refits(self, number: int, names: Sequence[str]) -> None:
        """Effects are refitted in a round."""
        self.report(f"refitting {', '.join(names)}", _within(SEARCH_BEGINS, RIVALS_BEGIN, number - 1.0 + _REFITS))

    def report_rivals(self, number: int, share: float, cause: str, names: Sequence[str]) -> None:
        """Others are put in a cause's place, `share` of a round's causes having been tried; `number` from 1."""
        text = f"comparing {cause} with {', '.join(names)}" if names else "comparing rivals"
        self.report(text, _within(RIVALS_BEGIN, JUDGEMENT_BEGINS, number - 1.0 + share))

    def report_judgement(self) -> None:
        """Causes are measured."""
        self.report("measuring the gain on held-out data", JUDGEMENT_BEGINS)

    def report_record(self, name: str) -> None:
        """Causes are judged on another record."""
        self.report(f"judging the causes on {name}", JUDGEMENT_BEGINS)

    def report_motion(self) -> None:
        """Numbers are fitted to the motion, which may take minutes."""
        self.report("fitting numbers to the motion, by free runs", JUDGEMENT_BEGINS)


def _within(begin: float, end: float, rounds: float) -> float:
    """Share of the work after so many rounds of a stage."""
    return end - (end - begin) * float(_LEFT**rounds)


@dataclass(frozen=True)
class Criteria:
    """Criteria of a gain, on this record.

    Attributes:
        table: [diagnosis] of the machine file.
        floor: noise of the measured friction [N].
        material: RMS gain that matters [N].
        excited: effects the record can show.
        one_speed: whether the motion has but one speed: a force periodic in place is periodic in time too.
        progress: told of each step.
    """

    table: DiagnosisTable
    floor: float
    material: float
    excited: tuple[str, ...]
    one_speed: bool
    progress: ProgressReport

    def has_same_clock(self, first: str, second: str) -> bool:
        """Return True if two causes repeat with the same clock: at one speed place is one, and so is time."""
        return self.one_speed and _is_periodic(first) and _is_periodic(second)

    def alike(self, first: str, second: str) -> bool:
        """Return True if two causes are known to be confused, or this record's motion confuses them."""
        known = first in cause(second).confused_with or second in cause(first).confused_with
        return known or self.has_same_clock(first, second)

    def excess(self, fit: Fit) -> float:
        """RMS of a fit's residual beyond noise [N].

        Of the rows it has seen: where a record turns round but once, a fit without that fold predicts anything.
        """
        return math.sqrt(max(0.0, fit.rms**2 - self.floor**2))

    def is_as_good(self, fit: Fit, other: Fit) -> bool:
        """Return True if another fit's residual is larger by no more than matters, on unseen folds."""
        return fit.gain_over(other) < self.material

    def enough(self, fit: Fit) -> float:
        """Return the least gain of an effect in a fit [N]: one that matters, and a fair share of the residual.

        Where a lot is left, something with a small share of it only imitates a part of the real cause.
        """
        return max(self.material, GAIN_SHARE * self.excess(fit))


def material_force(machine: Machine, floor: float) -> float:
    """RMS of a force that matters on a record of this noise floor [N]."""
    return max(machine.diagnosis.material * machine.friction.coulomb, MATERIAL_NOISE * floor)


def small_force(machine: Machine) -> float:
    """RMS of a force that matters only where nothing else is left [N]."""
    return SMALL_GAIN * machine.friction.coulomb


def make_criteria(
    machine: Machine,
    floor: float,
    excitation: Mapping[Measure, float],
    progress: ProgressReport,
    *,
    one_speed: bool = False,
    several: bool = False,
) -> Criteria:
    """The criteria of a record of this noise floor [N] and these measures.

    `several`: it is several logs, whose clocks have nothing in common: no force has an instant or a phase in all.
    """
    # What a record does not excite cannot be found in it; what only imitates it can.
    excited = tuple(
        name
        for name in effect_names(machine.plant.kind)
        if not effect_definition(name).learned
        and not any(need.times is None for need in effect_definition(name).excitation.unmet(excitation, _ANY))
        and not (several and hangs_on_time(name))
    )
    return Criteria(machine.diagnosis, floor, material_force(machine, floor), excited, one_speed, progress)


def hangs_on_time(name: str) -> bool:
    """Return True if the force of an effect hangs on when a log begins."""
    definition = effect_definition(name)
    return isinstance(definition.search, Step) or (definition.sine is not None and definition.sine.coordinate == "time")


def raise_floor(criteria: Criteria, floor: float) -> Criteria:
    """Return the criteria of the same record with a higher noise floor [N]; a lower one changes nothing."""
    if floor <= criteria.floor:
        return criteria
    return replace(criteria, floor=floor, material=max(criteria.material, MATERIAL_NOISE * floor))


def list_addable(
    machine: Machine, effects: Sequence[CandidateEffect], criteria: Criteria, *, instead_of: str | None = None
) -> list[str]:
    """Effects that may still be added to a machine with others under test.

    `instead_of`: the cause whose place one would take. Its look-alikes count then though the record does not excite
    them: on a motion in one direction nothing tells a wrong level from an asymmetric one. A curve of any shape is not
    among them (`fit_curve`).
    """
    tested = [effect.name for effect in effects]
    taken = {*tested, *(effect.name for effect in machine.effects)}
    taken |= {other for name in taken for other in cause(name).excludes}
    full = {name for name in tested if tested.count(name) >= MOST_ALIKE}
    return [
        name
        for name in effect_names(machine.plant.kind)
        if not (effect_definition(name).learned or effect_definition(name).any_curve)
        and (name in criteria.excited or (instead_of is not None and criteria.alike(name, instead_of)))
        and (name not in taken or (effect_definition(name).repeatable and name not in full))
    ]


def _is_periodic(name: str) -> bool:
    return name in EFFECT_NAMES and effect_definition(name).periodic


@dataclass(frozen=True, eq=False)
class Ranked:
    """A proposal and the RMS of the force it explains by cross-validation, to first order [N].

    `group`: numbers of the machine it is; None: an effect.
    """

    gain: float
    proposal: Proposal
    group: ParameterGroup | None = None


def make_effect(proposal: Proposal) -> CandidateEffect:
    """Return the effect a refit of a proposal starts from."""
    return CandidateEffect(proposal.name, proposal.parameters)


def is_ruled_out(fit: Fit, name: str, subject: Subject) -> bool:
    """Return True if the effect added last has turned into a simpler one, or into an impossible one."""
    if not fit.effects or fit.effects[-1].name != name:
        return False
    parameters = fit.effects[-1].parameters
    definition = effect_definition(name)
    if not definition.possible(parameters, scales_of(subject.machine)):
        return True
    if hangs_on_time(name) and definition.sine is not None:
        frequency = np.array([parameters[definition.sine.period]])
        if in_step(subject.recording, frequency).any():
            return True
    return cause(name).simpler.reached(parameters, subject.recording.extents)


def rank_proposals(subject: Subject, current: Fit, proposals: Sequence[Proposal]) -> list[Ranked]:
    """Proposals with their explained share by cross-validation, in their order."""
    gains = run_parallel([partial(linear_gain, subject, current, proposal) for proposal in proposals])
    return [Ranked(gain, proposal) for gain, proposal in zip(gains, proposals, strict=True)]


def linear_gain(subject: Subject, current: Fit, proposal: Proposal) -> float:
    """RMS of the force a proposal explains by cross-validation, to first order [N]."""
    recording = subject.recording
    # Columns are projected on used rows: the other parameters follow by themselves.
    full = np.zeros((len(recording.time), proposal.columns.shape[1]))
    full[recording.used] = proposal.columns
    shift = np.zeros(len(recording.time))
    shift[recording.used] = proposal.columns @ proposal.coefficients
    prior = 1e-9 * np.maximum(np.sum(full**2, axis=0), 1e-300)
    after = cross_loss(recording, full, current.residual - shift, prior)
    return gain_force(current.loss, after, current.rows)


def _count_free(proposal: Proposal) -> int:
    """Return how many numbers of a proposal a fit moves; of the machine's own numbers one a column."""
    if not proposal.parameters:
        return int(proposal.columns.shape[1])
    known = (effect_definition(proposal.name).parameter(key) for key in proposal.parameters)
    return sum(parameter.main or bool(parameter.times) for parameter in known)


def drop_duplicates(ranked: Sequence[Ranked], same_force: float) -> list[Ranked]:
    """Without proposals that make the same force as another one with fewer numbers."""
    forces = [r.proposal.columns @ r.proposal.coefficients for r in ranked]
    numbers = [_count_free(r.proposal) for r in ranked]

    def same(x: Array, y: Array) -> bool:
        return float(x @ y) > same_force * math.sqrt(float(x @ x) * float(y @ y))

    return [
        candidate
        for candidate, force, count in zip(ranked, forces, numbers, strict=True)
        if not any(other < count and same(at, force) for at, other in zip(forces, numbers, strict=True))
    ]
