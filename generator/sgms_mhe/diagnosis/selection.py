"""Which causes: forward selection over refits, backward pruning, rivals."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.diagnosis.candidates import degenerate, motion_of, search, stiffness_start, stribeck_start
from sgms_mhe.diagnosis.evidence import difference_statistic, gain_force, nuisance, score_test
from sgms_mhe.diagnosis.fitting import BASE_GROUPS, Extra, Fit, FitError, Workshop, cross_loss
from sgms_mhe.diagnosis.proposals import Proposal
from sgms_mhe.diagnosis.result import Score
from sgms_mhe.model.effects import effect_definition, effect_names
from sgms_mhe.model.effects.excitation import Measure

Array = NDArray[np.float64]

SIGNIFICANCE: Final = 1e-3  # of a candidate, all candidates and all their trials counted
MATERIAL: Final = 0.007  # of f_C, RMS: less is no cause but a detail
MATERIAL_NOISE: Final = 0.25  # of the noise floor
ROUNDS: Final = 5
REFITS: Final = 4  # per round
CLEAR: Final = 0.8  # the same for an effect that its linear gain says all of
CLOSE: Final = 0.55  # a candidate with less than this share of the best linear gain is not refitted
SHARPER: Final = 0.97  # RMS by which the sharp transition must fit better to be taken
DECIDED: Final = 0.8  # and by which it must, or must not, for the other one not to be tried again
ALIGNMENTS: Final = 2
SHARE: Final = 0.25  # of the RMS beyond noise
LEFT: Final = 0.2  # of the RMS beyond noise that stays unexplained: smaller gains are not told from it
RIVAL_SHARE: Final = 0.15  # RMS by which a rival may fit worse, over what the cause explains
RIVAL_T: Final = 2.5
COSTLY: Final = ("backlash", "frictional_lag", "dwell_dependence")
"""Effects whose search runs models; put in a cause's place only if they ever showed, or are known to be confused."""
SPECIAL: Final[Mapping[str, tuple[str, ...]]] = {
    "position_spring": ("constant_offset",),
    "step_disturbance": ("constant_offset",),
    "force_ripple": ("constant_offset", "position_spring"),
    "periodic_disturbance": ("constant_offset", "step_disturbance"),
    "hose_hysteresis": ("position_spring",),
    "friction_drift": ("coulomb",),
    "viscous_drift": ("viscous",),
    "eddy_current_damping": ("viscous",),
    "position_dependent_friction": ("coulomb",),
}
"""Effects with a simpler cause as a limit: that is meant unless the effect explains something more that matters."""
SIZES: Final = (
    "amplitude",
    "ratio",
    "force_N",
    "difference",
    "damping_N",
    "coefficient",
    "mass",
    "gain",
    "stiffness",
    "delay",
)
"""How the names of parameters begin that a force is proportional to."""
INSTEAD: Final[Mapping[str, tuple[str, ...]]] = {
    "force_delay": ("actuator_lag",),
    "actuator_lag": ("force_delay",),
}
"""Never both: one makes the log late, the other the force, and together they cancel."""
_ANY: Final[Mapping[str, float]] = defaultdict(float)
REPEATABLE: Final = ("force_ripple", "periodic_disturbance")
MOST_ALIKE: Final = 2
"""More sines than that are the Fourier series of something else."""


@dataclass(frozen=True)
class Rival:
    """A candidate that fits as well as a cause: `fit` has it in the cause's place."""

    name: str
    instead_of: str
    fit: Fit
    excess_N: float
    statistic: float


@dataclass(frozen=True)
class Selection:
    """What was selected.

    Attributes:
        fit: effects and the numbers of the base model that are wrong; all other numbers as in the machine file.
        base: groups of the machine's own numbers that are refitted.
        unnamed: those of them that are no cause: refitted because something else is left, not because they are wrong.
        inconstant: candidates that are no cause because their size changes over the record.
        free: where the forward search ended, all of the machine's numbers refitted.
        scores: of all rounds.
        rivals: of the causes in `fit`.
        rejected: candidates that were refitted in a cause's place and lost: name to (cause, excess [N]).
        p_values: of each cause, by group.
    """

    fit: Fit
    base: tuple[str, ...]
    scores: tuple[Score, ...]
    rivals: tuple[Rival, ...]
    rejected: dict[str, tuple[str, float]] = field(default_factory=dict)
    p_values: dict[str, float] = field(default_factory=dict)
    unnamed: tuple[str, ...] = ()
    inconstant: tuple[str, ...] = ()
    free: Fit | None = None

    @property
    def causes(self) -> tuple[str, ...]:
        """Groups that are named: base groups, then effects under test."""
        base = tuple(group for group in self.base if group not in self.unnamed)
        return base + tuple(f"+{i}" for i in range(len(self.fit.extras)))


class Selector:
    """Forward selection, pruning and rivals on one recording."""

    def __init__(
        self,
        workshop: Workshop,
        sharp: Workshop | None,
        floor: float,
        excitation: Mapping[Measure, float],
        report: Callable[[str], None],
    ) -> None:
        self.workshop = self.plain = workshop
        self.sharp = sharp
        self.report = report
        machine = workshop.machine
        self.floor = floor
        self.material = max(MATERIAL * machine.friction.coulomb, MATERIAL_NOISE * floor)
        self.own = tuple(f"machine:{effect.label}" for effect in machine.effects)
        self.groups = tuple(BASE_GROUPS) + self.own
        # What a record does not excite cannot be found in it; what only imitates it can.
        self.excited = tuple(
            name
            for name in effect_names()
            if not any(need.times is None for need in effect_definition(name).excitation.unmet(excitation, _ANY))
        )
        self.scores: list[Score] = []
        self.seen: set[str] = set()
        self.decided = False  # on the transition

    # --- forward ------------------------------------------------------------------------------------------------

    def select(self) -> Selection:
        """Select causes, from the machine with all its own numbers refitted."""
        self._start_stribeck()
        current = self._transition(())
        p_values: dict[str, float] = {}
        for number in range(1, ROUNDS + 1):
            if self._excess(current) < self.material:  # what is left could not make any cause matter
                break
            self.report(f"searching effects, round {number}")
            step = self._round(current, number)
            if step is None:
                break
            current = self._transition(self._pruned(step).extras)
        # What is left unexplained is no measure for the machine's numbers, but no finer one than that is possible.
        self.material = max(self.material, LEFT * self._excess(current))
        base, fit = self._wrong_numbers(current)
        fit, base = self._leaner(fit, base)
        rivals: list[Rival] = []
        rejected: dict[str, tuple[str, float]] = {}
        for _ in range(3):
            self.report("comparing rivals")
            better, rivals, rejected = self._rivals(fit, base)
            if better is None:
                break
            base, fit = self._wrong_numbers(better)
            fit, base = self._leaner(fit, base)
        for group in base + tuple(f"+{i}" for i in range(len(fit.extras))):
            p_values[group] = self._p_value(fit, group)
        return Selection(fit, base, tuple(self.scores), tuple(rivals), rejected, p_values, free=current)

    def _attempt(
        self, extras: Sequence[Extra], *, base: Sequence[str] | None = None, warm: Fit | None = None
    ) -> Fit | None:
        """A fit, or None where the model is not finite from its start on."""
        try:
            return self.workshop.fit(extras, base=base, warm=warm)
        except FitError:
            return None

    def _called(self, group: str) -> str:
        """Name of a candidate: that of its effect where it is a number of an effect that the machine has."""
        label = group.removeprefix("machine:")
        return next((e.name for e in self.workshop.machine.effects if group != label and e.label == label), group)

    def names(self, extras: Sequence[Extra]) -> list[str]:
        """Effects that may still be added."""
        taken = {extra.name for extra in extras} | {effect.name for effect in self.workshop.machine.effects}
        taken |= {other for name in taken for other in INSTEAD.get(name, ())}
        twice = {extra.name for extra in extras if sum(other.name == extra.name for other in extras) >= MOST_ALIKE}
        return [name for name in self.excited if name not in taken or (name in REPEATABLE and name not in twice)]

    def _start_stribeck(self) -> None:
        """A machine file without a Stribeck effect says nothing about its velocity: look for it first."""
        if self.plain.machine.friction.stribeck_ratio > 0.0:
            return
        recording = self.plain.recording
        fit = self.plain.fit((), base=tuple(g for g in self.groups if g != "stribeck"))
        found = stribeck_start(recording, fit, nuisance(fit.slopes[recording.used][:, fit.loose]))
        for workshop in (self.plain, self.sharp):
            if workshop is not None:
                workshop.starts.update(found)

    def _start_stiffness(self, extras: Sequence[Extra]) -> None:
        """Start fits from the common factor on the stiffnesses that leaves clearly less than the machine file's.

        Where elements turn round all the time the sum of squares is rough in their stiffness, and a fit that starts far
        from it stops short. With other effects it may be another one.
        """
        for workshop in (self.workshop,) if self.decided else (self.plain, self.sharp):
            if workshop is not None:
                for name in [name for name in workshop.starts if name.startswith("stiffness")]:
                    del workshop.starts[name]
                workshop.starts.update(stiffness_start(workshop, extras, self.material))

    def _transition(self, extras: Sequence[Extra]) -> Fit:
        """Fit with the transition from sticking to slipping that fits better, from now on.

        How sharply an element slips is a property of the smoothed law, not of an axis: a real one may switch. Both are
        tried, after every effect again, so that the difference is not taken for an effect, nor an effect for it; each
        with its own thinned model brought into line, or what thinning does to the new effect would decide.
        """
        self._start_stiffness(extras)
        if self.sharp is None or self.decided:
            return self._aligned(self.workshop, self.workshop.fit(extras))
        fit = self._aligned(self.plain, self.plain.fit(extras))
        other = self._sharp_fit(self.sharp, fit)
        if other is None:
            self.workshop = self.plain
            return fit
        ratio = other.cross_rms / fit.cross_rms
        better = other if ratio < SHARPER else fit
        self.decided = not DECIDED < ratio < 1.0 / DECIDED and self._excess(better) < 2.0 * self.material
        self.workshop = self.sharp if better is other else self.plain
        return better

    def _aligned(self, workshop: Workshop, fit: Fit) -> Fit:
        """The fit with everything at hand, its thinned model brought into line with the record's full rate."""
        for _ in range(ALIGNMENTS):
            workshop.align(fit)
            fit = workshop.fit(fit.extras, warm=fit)
        return fit

    def _sharp_fit(self, sharp: Workshop, fit: Fit) -> Fit | None:
        """The sharp transition with the effects of a fit, in line; None where it cannot be fitted.

        The switching law's sum of squares is rough: from the machine's numbers and from the smooth fit's.
        """
        found: Fit | None = None
        for _ in range(ALIGNMENTS):
            if found is not None:
                sharp.align(found)
            for warm in (None, found or fit):
                try:
                    found = sharp.fit(fit.extras, warm=warm, again=warm is not None)
                except FitError:
                    continue
        return None if found is None else self._aligned(sharp, found)

    def _round(self, current: Fit, number: int) -> Fit | None:
        """Search, refit the best, return the fit with the one to add."""
        recording = self.workshop.recording
        free = nuisance(current.slopes[recording.used][:, current.loose])
        names = self.names(current.extras)
        proposals = search(self.workshop, current, [n for n in names if n not in COSTLY], free)
        gains = {id(p): self._linear_gain(current, p) for p in proposals}
        costly = self._costly(current, proposals, gains)
        if costly:
            more = search(self.workshop, current, [n for n in names if n in costly], free)
            gains |= {id(p): self._linear_gain(current, p) for p in more}
            proposals += more
        best: dict[str, Proposal] = {}
        for p in proposals:
            if p.name not in best or gains[id(p)] > gains[id(best[p.name])]:
                best[p.name] = p
        proposals = list(best.values())
        enough = self._enough(current)
        strong = [
            p for p in proposals if p.feasible and p.p_value * len(names) < SIGNIFICANCE and gains[id(p)] > 0.8 * enough
        ]
        strong.sort(key=lambda p: -gains[id(p)])
        top = gains[id(strong[0])] if strong else 0.0
        shortlist = _distinct([(gains[id(p)], p) for p in strong if gains[id(p)] > CLOSE * top])[:REFITS]
        shortlist = [p for p in shortlist if gains[id(p)] > CLEAR * gains[id(shortlist[0])] or not _is_linear(p.name)]
        fits: dict[str, Fit] = {}
        for proposal in shortlist:
            self.report(f"refitting {proposal.name}")
            fit = self._attempt((*current.extras, proposal.extra), warm=current)
            if fit is not None:
                fits[proposal.name] = fit
        chosen = self._choose(current, fits)
        self.seen |= {p.name for p in strong}
        for p in proposals:
            gain = gains[id(p)]
            refit = gain_force(current.cross, fits[p.name].cross, current.rows) if p.name in fits else math.nan
            outcome = (
                "named"
                if p.name == chosen
                else "redundant"
                if p in strong
                else "too small"
                if p.feasible and p.p_value * len(names) < SIGNIFICANCE
                else "not significant"
            )
            self.scores.append(
                Score(
                    p.name, number, min(1.0, p.p_value * len(names)), max(0.0, gain), refit, dict(p.parameters), outcome
                )
            )
        return fits[chosen] if chosen is not None else None

    def _costly(self, current: Fit, proposals: Sequence[Proposal], gains: Mapping[int, float]) -> list[str]:
        """Effects worth a search that runs models: where the others leave something, or look like one of them."""
        found = [p for p in proposals if p.feasible]
        best = max(found, key=lambda p: gains[id(p)], default=None)
        if best is None:
            return list(COSTLY)
        left = math.sqrt(max(0.0, self._excess(current) ** 2 - max(0.0, gains[id(best)]) ** 2))
        return [
            name
            for name in COSTLY
            if left > self.material or best.name in effect_definition(name).confused_with or name in self.seen
        ]

    def _enough(self, current: Fit) -> float:
        """What an effect must explain to be added [N]: what matters, and a fair share of what there is to explain.

        Where a lot is left, something with a small share of it only imitates a part of what is really there.
        """
        return max(self.material, SHARE * self._excess(current))

    def _excess(self, fit: Fit) -> float:
        """RMS of what a fit leaves beyond noise [N]."""
        return math.sqrt(max(0.0, fit.cross_rms**2 - self.floor**2))

    def _choose(self, current: Fit, fits: dict[str, Fit]) -> str | None:
        """The candidate to add: the best by cross-validation; among equals the one that leaves other numbers alone."""
        gains = {name: gain_force(current.cross, fit.cross, fit.rows) for name, fit in fits.items()}
        gains = {
            name: gain
            for name, gain in gains.items()
            if gain > self._enough(current) and not self._degenerate(fits[name], name)
        }
        if not gains:
            return None
        best = max(gains, key=lambda name: gains[name])
        equal = [
            name
            for name in gains
            if name == best
            or difference_statistic(fits[best].cross, fits[name].cross) < RIVAL_T
            or gains[name] > 0.97 * gains[best]
        ]
        if len(equal) == 1:
            return best
        plain = {name: self.workshop.fit(fits[name].extras, base=(), warm=None) for name in equal}
        return min(plain, key=lambda name: float(plain[name].cross.sum()))

    def _degenerate(self, fit: Fit, name: str) -> bool:
        """Whether the effect that was added last has turned into a simpler one."""
        if not fit.extras or fit.extras[-1].name != name:
            return False
        return degenerate(name, fit.extras[-1].parameters, motion_of(self.workshop.recording, fit))

    def _linear_gain(self, current: Fit, proposal: Proposal) -> float:
        """RMS of the force that a proposal explains by cross-validation, to first order."""
        recording = self.workshop.recording
        # Columns are projected on used rows: the other parameters follow by themselves.
        full = np.zeros((len(recording.time), proposal.columns.shape[1]))
        full[recording.used] = proposal.columns
        shift = np.zeros(len(recording.time))
        shift[recording.used] = proposal.columns @ proposal.coefficients
        prior = 1e-9 * np.maximum(np.sum(full**2, axis=0), 1e-300)
        after = cross_loss(recording, full, current.residual - shift, prior)
        return gain_force(current.loss, after, current.rows)

    def _pruned(self, fit: Fit) -> Fit:
        """Drop effects that the others have made superfluous."""
        while len(fit.extras) > 1:
            losses = []
            for i in range(len(fit.extras)):
                rest = tuple(e for j, e in enumerate(fit.extras) if j != i)
                without = self.workshop.fit(rest, warm=fit)
                losses.append((gain_force(without.cross, fit.cross, fit.rows), without))
            gain, without = min(losses, key=lambda entry: entry[0])
            if gain > self.material:
                return fit
            fit = without
        return fit

    # --- the machine's own numbers ------------------------------------------------------------------------------

    def _wrong_numbers(self, fit: Fit) -> tuple[tuple[str, ...], Fit]:
        """Which of the machine's numbers must differ from the file: the fewest groups that leave no material gain."""
        extras = fit.extras
        everything = self.workshop.fit(extras, warm=fit)
        named: tuple[str, ...] = ()
        current = self.workshop.fit(extras, base=(), warm=everything)
        while True:
            missing = gain_force(current.cross, everything.cross, fit.rows)
            rest = [group for group in self.groups if group not in named]
            if missing < self.material or not rest:
                break
            trials = {group: self.workshop.fit(extras, base=(*named, group), warm=everything) for group in rest}
            best = min(trials, key=lambda group: float(trials[group].cross.sum()))
            gain = gain_force(current.cross, trials[best].cross, fit.rows)
            if gain < self.material:
                break
            named, current = (*named, best), trials[best]
        for group in list(named):  # an early one may have stood in for later ones
            if len(named) < 2:
                break
            without = tuple(g for g in named if g != group)
            trial = self.workshop.fit(extras, base=without, warm=current, again=True)
            if gain_force(trial.cross, current.cross, fit.rows) < self.material:
                named, current = without, trial
        return named, current

    def _leaner(self, fit: Fit, base: tuple[str, ...]) -> tuple[Fit, tuple[str, ...]]:
        """Drop effects that are superfluous now that the base numbers are what they are."""
        while fit.extras:
            losses = []
            for i in range(len(fit.extras)):
                rest = tuple(e for j, e in enumerate(fit.extras) if j != i)
                without = self.workshop.fit(rest, base=base, warm=fit)
                losses.append((gain_force(without.cross, fit.cross, fit.rows), without))
            gain, without = min(losses, key=lambda entry: entry[0])
            if gain > self.material:
                break
            fit = without
        return fit, base

    # --- rivals -------------------------------------------------------------------------------------------------

    def _rivals(self, fit: Fit, base: tuple[str, ...]) -> tuple[Fit | None, list[Rival], dict[str, tuple[str, float]]]:
        """Put every other candidate in each cause's place; a better one is returned, equal ones are rivals."""
        recording = self.workshop.recording
        rivals: list[Rival] = []
        rejected: dict[str, tuple[str, float]] = {}
        for group in base + tuple(f"+{i}" for i in range(len(fit.extras))):
            if group.startswith("+"):
                extras = tuple(e for i, e in enumerate(fit.extras) if f"+{i}" != group)
                free_base, cause = base, fit.extras[int(group[1:])].name
            else:
                extras, free_base, cause = fit.extras, tuple(g for g in base if g != group), self._called(group)
            without = self.workshop.fit(extras, base=free_base, warm=fit)
            own_gain = gain_force(without.cross, fit.cross, fit.rows)
            if own_gain <= 0.0:
                continue
            free = nuisance(without.slopes[recording.used][:, without.loose])
            names = [
                n
                for n in self.names(extras)
                if n != cause and (n not in COSTLY or n in self.seen or cause in effect_definition(n).confused_with)
            ]
            proposals = [p for p in search(self.workshop, without, names, free) if p.feasible]
            trials: list[tuple[float, Proposal]] = [(self._linear_gain(without, p), p) for p in proposals]
            for other in self.groups:
                if other in base or other == group:
                    continue
                columns = [i for i, c in enumerate(without.model.columns) if c.group == other]
                Z = free.project(without.slopes[recording.used][:, columns])
                p, size = score_test(recording, Z, free.project(without.residual[recording.used]))
                proposal = Proposal(other, {}, Z, size, 0.0, 1.0, p, True)
                trials.append((self._linear_gain(without, proposal), proposal))
            trials.sort(key=lambda trial: -trial[0])
            kept = _distinct(trials)[:REFITS]
            for gain, proposal in trials:
                group_name, name = proposal.name, self._called(proposal.name)
                if name == cause:
                    continue
                if not any(proposal is k for k in kept) or gain < 0.7 * own_gain:
                    rejected.setdefault(name, (cause, math.sqrt(max(0.0, own_gain**2 - max(gain, 0.0) ** 2))))
                    continue
                self.report(f"comparing {cause} with {name}")
                trial = (
                    self._attempt((*extras, proposal.extra), base=free_base, warm=without)
                    if group_name not in self.groups
                    else self._attempt(extras, base=(*free_base, group_name), warm=without)
                )
                if trial is None:
                    continue
                excess = gain_force(trial.cross, fit.cross, fit.rows)
                statistic = difference_statistic(fit.cross, trial.cross)
                better = statistic < -RIVAL_T and excess < -0.2 * self.material
                if self._degenerate(trial, name):
                    rejected[name] = (cause, max(0.0, excess))
                    continue
                if better or (name in SPECIAL.get(cause, ()) and excess < self.material):
                    return trial, [], {}
                if cause in SPECIAL.get(name, ()) and (excess > -0.2 * self.material or statistic > -RIVAL_T):
                    # More numbers and no better: it only imitates.
                    rejected[name] = (cause, max(0.0, excess))
                    continue
                if excess < 0.3 * self.material or (excess < RIVAL_SHARE * own_gain and statistic < RIVAL_T):
                    rivals.append(Rival(name, cause, trial, excess, statistic))
                else:
                    rejected[name] = (cause, excess)
        return None, rivals, rejected

    def _p_value(self, fit: Fit, group: str) -> float:
        """Score test of a group's parameters at the fit (Wald form)."""
        recording = self.workshop.recording
        inside = np.array([c.group == group for c in fit.model.columns]) & fit.free
        X = fit.slopes[recording.used]
        free = nuisance(X[:, fit.loose & ~inside])
        Z = free.project(X[:, inside])
        # What the group contributes at the fit stands in for the sizes that the parameters started from.
        start = np.array([c.machine_theta if not group.startswith("+") else 0.0 for c in fit.model.columns])
        if group.startswith("+"):
            sizes = _amplitudes(fit, group)
            shift = np.where(sizes, fit.theta - _zero(fit, group), 0.0)[inside]
        else:
            shift = (fit.theta - start)[inside]
        p, _ = score_test(recording, Z, free.project(fit.residual[recording.used]) + Z @ shift)
        return p


def _realigned(workshop: Workshop, fit: Fit) -> Fit:
    """The fit against a record that was aligned with it, not with one that an effect was missing in."""
    workshop.align(fit)
    return workshop.fit(fit.extras, warm=fit)


def _distinct(ranked: list[tuple[float, Proposal]]) -> list[Proposal]:
    """Without proposals that make the same force as another one with fewer numbers."""
    kept: list[tuple[float, Proposal]] = []
    forces: dict[int, Array] = {id(p): p.columns @ p.coefficients for _, p in ranked}

    def same(a: Proposal, b: Proposal) -> bool:
        x, y = forces[id(a)], forces[id(b)]
        return float(x @ y) > 0.985 * math.sqrt(float(x @ x) * float(y @ y))

    for gain, proposal in ranked:
        if not any(_numbers(p) < _numbers(proposal) and same(p, proposal) for _, p in ranked):
            kept.append((gain, proposal))
    return [proposal for _, proposal in kept]


def _is_linear(name: str) -> bool:
    """Whether an effect's force is its columns times its sizes: then its linear gain is what a refit would find."""
    return (
        name in effect_names() and not effect_definition(name).states and name not in ("micro_viscous", "force_ripple")
    )


def _numbers(proposal: Proposal) -> int:
    """Numbers of a candidate: an effect's parameters, a base group's columns."""
    return len(proposal.parameters) or proposal.columns.shape[1]


def is_size(effect: str, parameter: str) -> bool:
    """Whether an effect is none where this parameter is zero (or a gain one)."""
    return parameter.startswith(SIZES) or (effect, parameter) in (
        ("actuator_lag", "time_constant_s"),
        ("frictional_lag", "time_constant_s"),
        ("backlash", "gap_m"),
    )


def _amplitudes(fit: Fit, group: str) -> NDArray[np.bool_]:
    """Parameters of an effect that its force is proportional to, by their names."""
    return np.array([c.group == group and c.name.startswith(SIZES) for c in fit.model.columns])


def _zero(fit: Fit, group: str) -> Array:
    """theta at which an effect's sizes vanish."""
    return np.array([c.theta(1.0 if c.name == "gain" else 0.0) if c.group == group else 0.0 for c in fit.model.columns])


__all__ = ["Rival", "Selection", "Selector", "is_size"]
