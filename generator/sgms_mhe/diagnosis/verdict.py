"""`diagnose`: from a log and a machine to a verdict."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.configuration import override_machine
from sgms_mhe.diagnosis.evidence import gain_force, gain_interval, inconstancy
from sgms_mhe.diagnosis.excitation import measures
from sgms_mhe.diagnosis.extension import extend_machine
from sgms_mhe.diagnosis.fitting import ITERATIONS, SETTLED, Extra, Fit, FitError, Workshop
from sgms_mhe.diagnosis.residuals import Recording, excerpt, noise_floor, prepare
from sgms_mhe.diagnosis.result import (
    Alternative,
    BaseParameter,
    Cause,
    Diagnosis,
    Rms,
    Score,
    Traces,
    Verdict,
)
from sgms_mhe.diagnosis.selection import Selection, Selector, is_size
from sgms_mhe.diagnosis.structure import structure_map
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import effect_definition, effect_names
from sgms_mhe.model.effects.base import BASE_CAUSES
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import InputError

Array = NDArray[np.float64]
Progress = Callable[[str], None]
"""Called with what is being done."""

EXCITED: Final = 0.05  # of f_C: range of the simulated friction below which a record says nothing
SHARP: Final[Mapping[str, float]] = {"zeta": 0.995, "lambda": 700.0, "gamma": 700.0}
"""Smoothing of elements that slip almost at once: a hundredth of break-away from the switching law."""
SEARCH_RATE: Final = 1000.0  # Hz
UNEXPLAINED: Final = 0.02  # of f_C: RMS beyond noise that a complete explanation may leave
MOST_LEFT: Final = 0.75  # of the RMS beyond noise, where every cause is the same all over the record
INERTIAL: Final = ("force_delay", "actuator_lag", "mass_mismatch", "force_gain", "structural_resonance")
INCONSTANT: Final = 0.3  # RMS change of a cause's size over the record that rules it out, over the size
FOLLOWS: Final = 0.5  # gain of a refitted number without the effects, over that beside them, that makes it their sequel
PATIENT: Final = 40  # iterations of a fit that may start far from its end
SIGMAS: Final = 2.0
JOINT: Final = 1e-4  # significance of several wrong numbers together
NO_EFFECT: Final[Mapping[tuple[str, str], float]] = {("force_gain", "gain"): 1.0}
"""Sizes at which an effect is none, where that is not 0."""
UNEXPLAINED_SHARE: Final = 0.15  # of the RMS beyond noise of the machine as it is


def diagnose(
    machine: Machine,
    log: Log,
    *,
    progress: Progress | None = None,
    held_out_s: Sequence[tuple[float, float]] | None = None,
) -> Diagnosis:
    """Say what a machine's model gets wrong along a log, and why.

    Args:
        machine: the axis as it is believed to be.
        log: what was measured.
        progress: called with each step.
        held_out_s: intervals since the log's start [s] that no fit behind a reported gain may see; None: a third of the
            record, in blocks.

    Raises:
        InputError: the log does not fit the machine, or has too few usable samples.
    """
    started = time.monotonic()
    report = progress or (lambda _: None)
    report("preparing the log")
    record = prepare(machine, log, held_out_s)
    recording = excerpt(record)
    whole = Workshop(machine, recording)
    try:
        nominal = whole.fit((), base=())
    except FitError as error:
        raise InputError(log.source or "log", "simulated friction", None, f"finite, but {error}") from None
    floor = noise_floor(recording, nominal.residual)
    simulated = (recording.friction - nominal.residual)[recording.used]
    if float(np.ptp(simulated)) < EXCITED * machine.friction.coulomb:
        if recording is not record:
            # A long rest may hold all pieces; a whole record costs no more than this one run.
            recording, nominal = record, Workshop(machine, record).fit((), base=())
            floor = noise_floor(recording, nominal.residual)
        return _without_excitation(machine, log, recording, nominal, floor, started)
    report("refitting the base model")
    shops = []
    for shop in (whole, _sharp(machine, recording)):
        if shop is not None:
            shop.noise = floor
            # Searched on mean signals of a few samples, aligned with the whole record at each fit that matters.
            thin = shop.thinned(_thinning(recording))
            try:
                thin.align(thin.fit((), base=()))
            except FitError:  # so sharp a transition is no model of this record
                continue
            shops.append(thin)
    if len(shops) > 1:
        shops[0].other, shops[1].other = shops[1], shops[0]
    selector = Selector(
        shops[0], shops[1] if len(shops) > 1 else None, floor, measures(record.signals, machine), report
    )
    selection = selector.select()
    smoothing = "sharp" if selector.workshop is selector.sharp else "machine"
    return _Verdict(machine, log, record, selector.workshop, nominal, selection, smoothing, report).finish(started)


def _thinning(recording: Recording) -> int:
    """How many samples share a step of the search: the most that keep at least `SEARCH_RATE`."""
    rate = recording.machine.sampling.rate
    return max(
        k for k in range(1, recording.factor + 1) if k == 1 or (recording.factor % k == 0 and rate / k >= SEARCH_RATE)
    )


def _sharp(machine: Machine, recording: Recording) -> Workshop | None:
    """The same machine whose elements slip almost at once; None where they do so anyway."""
    smoothing = machine.friction.smoothing
    if smoothing.lambda_ >= SHARP["lambda"]:
        return None
    changes = {"friction": {"smoothing": dict(SHARP)}}
    return Workshop(override_machine(machine, changes), recording)


@dataclass(frozen=True)
class _Left:
    """What a fit leaves of the whole record: `residual` (m) [N], `loss` and `rows` per block as those of a fit."""

    residual: Array
    loss: Array
    rows: Array

    @property
    def rms(self) -> float:
        """RMS on used rows [N]."""
        return math.sqrt(float(self.loss.sum() / self.rows.sum()))


def _rms(fit: Fit | _Left, recording: Recording) -> tuple[float, float]:
    """RMS on blocks that the fit saw, and on the held-out ones."""
    seen, held = ~recording.held_out, recording.held_out

    def value(blocks: NDArray[np.bool_]) -> float:
        rows = float(fit.rows[blocks].sum())
        return math.sqrt(float(fit.loss[blocks].sum()) / rows) if rows > 0 else math.nan

    return value(seen), value(held)


class _Verdict:
    """Puts the evidence of a selection into a Diagnosis."""

    def __init__(
        self,
        machine: Machine,
        log: Log,
        record: Recording,
        workshop: Workshop,
        nominal: Fit,
        selection: Selection,
        smoothing: str,
        report: Progress,
    ) -> None:
        self.machine = machine
        self.log = log
        self.record = record
        # A long record is fitted in pieces; what is left is measured along all of it.
        pieces = (workshop.fine or workshop).recording
        self.along: Workshop | None = None
        self.known: dict[int, tuple[Fit, _Left]] = {}
        if len(pieces.signals) < len(record.signals):
            self.along = Workshop((workshop.fine or workshop).machine, record)
        self.workshop = workshop
        self.nominal = nominal
        for shop in (workshop, workshop.fine):
            if shop is not None:
                shop.enough = SETTLED
        self.selection = self._aligned(selection)
        self.smoothing = smoothing
        self.report = report
        self.recording = workshop.recording
        self.floor = workshop.noise = noise_floor(self.recording, self.selection.fit.residual)
        self.start = workshop.fit(())

    def _aligned(self, selection: Selection) -> Selection:
        """The selection fitted at the record's full rate, to the second order."""
        fit = selection.fit
        for _ in range(2):
            self.workshop.align(fit)
            extras = fit.extras if self.along is None else tuple(self._timed(fit, extra) for extra in fit.extras)
            fit = self.workshop.fit(extras, base=selection.base, warm=fit)
        return replace(selection, fit=fit)

    def _timed(self, fit: Fit, extra: Extra) -> Extra:
        """A step at the instant that the whole record says; pieces only know what two of them it is between."""
        if extra.name != "step_disturbance" or self.along is None:
            return extra
        record, step = self.record, extra.parameters["force_N"]
        shifts = np.where(record.time > extra.parameters["time_s"], step, 0.0)
        without = self.along.residual_along(fit, self.workshop.sampled) + shifts
        fitted = self.workshop.recording.time[self.workshop.recording.used]
        seen = np.searchsorted(fitted, extra.parameters["time_s"])
        inside = record.used.copy()
        if seen > 0:
            inside &= record.time >= fitted[seen - 1]
        if seen < len(fitted):
            inside &= record.time <= fitted[seen]
        if inside.sum() < 2:
            return extra
        rest, time = without[inside], record.time[inside]
        last = int(np.argmin(np.cumsum(rest**2 - (rest - step) ** 2)))  # before the step
        at = float(time[min(last + 1, len(time) - 1)])
        return replace(extra, parameters={**extra.parameters, "time_s": at - 0.5 / record.rate})

    def _left(self, fit: Fit) -> _Left:
        """What a fit leaves of the whole record."""
        if self.along is None:
            return _Left(fit.residual, fit.loss, fit.rows)
        if id(fit) not in self.known:
            # The machine as it is keeps the transition of its file.
            shop = Workshop(self.machine, self.record) if fit is self.nominal else self.along
            residual = shop.residual_along(fit, self.workshop.sampled)
            self.known[id(fit)] = fit, _Left(residual, self.record.sum_blocks(residual**2), shop.rows)
        return self.known[id(fit)][1]

    def _confirmed(self, selection: Selection, *, constant: bool = False) -> tuple[Selection, Fit, tuple[Cause, ...]]:
        """The causes that hold on data that their fit has not seen; what does not is taken out, the weakest first.

        `constant`: they are known to be the same all over the record. Also returns the fit that did not see the
        held-out blocks.
        """
        recording = self.recording
        seen = recording.used & ~recording.rows_held_out()
        while selection.causes:
            fit = selection.fit
            blind = self.workshop.fit(fit.extras, base=selection.base, warm=fit, rows=seen)
            causes = self._causes(selection, blind, seen)
            doubtful = [group for group, cause in causes.items() if not _holds(cause, constant=constant)]
            if not doubtful:
                ordered = sorted(causes.values(), key=lambda cause: -cause.gain_N)
                return selection, blind, tuple(ordered)
            weakest = min(doubtful, key=lambda group: causes[group].gain_N)
            selection = self._no_cause(selection, weakest) if constant else self._without(selection, weakest)
        return selection, selection.fit, ()

    def _without(self, selection: Selection, group: str) -> Selection:
        """The selection without one of its causes, the others fitted again."""
        fit = selection.fit
        base = tuple(g for g in selection.base if g != group)
        extras = tuple(e for i, e in enumerate(fit.extras) if f"+{i}" != group)
        fit = self.workshop.fit(extras, base=base, warm=fit)
        return self._named_less(replace(selection, fit=fit, base=base), selection, group)

    def _no_cause(self, selection: Selection, group: str) -> Selection:
        """The same where more is left than is known: a number of the machine stays refitted, but is no cause.

        Held at the file's it would pass its error on to the other causes, which then would seem to change.
        """
        if group.startswith("+"):
            return self._without(selection, group)
        return self._named_less(replace(selection, unnamed=(*selection.unnamed, group)), selection, group)

    def _named_less(self, selection: Selection, before: Selection, group: str) -> Selection:
        """What belongs to the causes of a selection that had one more, `group`, `before`."""
        name = _cause_name(before.fit, group)
        rivals = tuple(r for r in before.rivals if r.instead_of != name)
        rejected = {**before.rejected, name: (name, 0.0)}
        left = [g for g in before.causes if g != group]
        p_values = {new: before.p_values.get(old, math.nan) for old, new in zip(left, selection.causes, strict=True)}
        return replace(selection, rivals=rivals, rejected=rejected, p_values=p_values)

    def finish(self, started: float) -> Diagnosis:
        self.report("measuring the gain on held-out data")
        selection, blind, causes = self._confirmed(self.selection)
        fit = selection.fit
        coulomb = self.machine.friction.coulomb
        plain = self.workshop.fit((), base=())  # the machine as it is, with the transition that was chosen
        before = self._excess(plain)
        after = self._excess(fit)
        allowed = max(UNEXPLAINED * coulomb, 0.5 * self.floor)
        # The base numbers' own small errors are no structure that asks for a name.
        free = self.workshop.fit(fit.extras, warm=fit)
        after = min(after, self._excess(free))
        complete = after < max(allowed, UNEXPLAINED_SHARE * before)
        if not complete and selection.causes:
            # Something is left; but causes that are the same everywhere in the record are none the less real.
            selection, blind, causes = self._constant(self.selection)
            fit = selection.fit
            # What refitted numbers explain that are no cause is no merit of the causes.
            before = self._excess(self.workshop.fit((), base=selection.unnamed))
            complete = bool(causes) and self._excess(fit) < MOST_LEFT * before
        elif causes and self.smoothing == "sharp":
            selection, blind, causes = self._refitted(selection, blind, causes, constant=False)
            fit = selection.fit
        verdict: Verdict
        if not selection.causes:
            verdict = "adequate" if after < allowed else "unexplained"
        elif not complete:
            verdict = "unexplained"
        elif selection.rivals:
            verdict = "ambiguous"
        else:
            verdict = "explained"
        if verdict == "unexplained" and selection.causes:
            selection, causes = replace(selection, fit=plain, base=(), rivals=()), ()
        fit = selection.fit
        named = bool(causes)
        if not named:  # the machine's numbers, with the transition that fits
            blind = plain
        nominal, unseen = self._left(self.nominal), self._left(blind)
        rms_before, held_before = _rms(nominal, self.record)
        rms_after, held_after = _rms(unseen, self.record)
        extended, toml = self._extension(selection, causes) if named else (None, None)
        warnings = self.recording.warnings
        if self.smoothing == "sharp":
            better = math.sqrt(float(plain.loss.sum() / plain.rows.sum()))
            warnings += (
                "elements slip more sharply than [friction.smoothing] says: "
                f"{', '.join(f'{key} = {value:g}' for key, value in SHARP.items())} alone leave {better:.3g} N",
            )
        if extended is not None:
            now = extended.estimator.parameters
            warnings += tuple(
                f"{name}: 0 in the extended machine, which does not estimate it: there is no scale for it"
                for name in self.machine.estimator.parameters
                if name not in now
            )
        held = self.record.held_out
        interval = gain_interval(nominal.loss[held], unseen.loss[held], unseen.rows[held]) if named else (0.0, 0.0)
        final, start = self._left(fit), self._left(self.start)
        alternatives = self._alternatives(selection)
        rivals = [a for a in alternatives if a.rival]
        return Diagnosis(
            machine=self.machine,
            source=self.log.source,
            verdict=verdict,
            summary=_summary(verdict, [c.name for c in causes], [a.name for a in rivals], held_before, held_after),
            causes=causes,
            alternatives=alternatives,
            separating_experiment=_experiment(verdict, causes, rivals),
            rms=Rms(rms_before, rms_after, held_before, held_after),
            noise_floor_N=self.floor if self.along is None else noise_floor(self.record, final.residual),
            gain_interval_N=interval,
            base=_base_parameters(self.workshop, free if named else self.start),
            scores=selection.scores if verdict != "unexplained" else _unnamed(selection.scores),
            structure_before=structure_map(self.record, nominal.residual),
            structure_after=structure_map(self.record, final.residual if named else start.residual),
            traces=_traces(self.record, nominal, start, final if named else nominal, unseen),
            extended=extended,
            extended_toml=toml,
            smoothing=self.smoothing,
            excited=True,
            warnings=warnings,
            seconds=time.monotonic() - started,
        )

    def _constant(self, selection: Selection) -> tuple[Selection, Fit, tuple[Cause, ...]]:
        """The causes whose size is the same everywhere in the record, the least constant one taken out first."""
        for group in selection.causes:
            if self._follows(selection, group):
                selection = self._no_cause(selection, group)
        while selection.causes:
            change = {group: self._inconstancy(selection, group) for group in selection.causes}
            worst = max(change, key=lambda group: change[group])
            if change[worst] < INCONSTANT:
                break
            name = _cause_name(selection.fit, worst)
            selection = replace(self._no_cause(selection, worst), inconstant=(*selection.inconstant, name))
        return self._refitted(*self._confirmed(selection, constant=True), constant=True)

    def _follows(self, selection: Selection, group: str) -> bool:
        """Whether a number of the machine is wrong only beside the effects: it was right for a model without them."""
        if group.startswith("+") or not selection.fit.extras:
            return False
        fit, plain = selection.fit, self.workshop.fit((), base=())
        without = self.workshop.fit(fit.extras, base=tuple(g for g in selection.base if g != group), warm=fit)
        alone = self.workshop.fit((), base=(group,), warm=plain)
        return gain_force(plain.cross, alone.cross, fit.rows) < FOLLOWS * gain_force(without.cross, fit.cross, fit.rows)

    def _refitted(
        self, selection: Selection, blind: Fit, causes: tuple[Cause, ...], *, constant: bool
    ) -> tuple[Selection, Fit, tuple[Cause, ...]]:
        """The same causes with all numbers of the machine refitted, where that is better on held-out data.

        Where something is left that nothing accounts for, or the axis slips by another law than the file's, the
        machine's numbers may do best at other values, and held at the file's they pass their errors on to the effects.
        They are no causes for that. `constant`: the causes have to stay the same all over the record.
        """
        if not causes:
            return selection, blind, causes
        groups = tuple(dict.fromkeys(c.group for c in self.start.model.columns if not c.group.startswith("+")))
        fit, seen = selection.fit, self.recording.used & ~self.recording.rows_held_out()
        # Where all is explained the numbers are near the file's; else a fit may have far to go.
        starts, iterations = ((selection.free, self.start, fit), PATIENT) if constant else ((fit,), ITERATIONS)
        for warm in starts:
            free = self.workshop.fit(fit.extras, base=groups, warm=warm, iterations=iterations, again=True)
        blind_free = self.workshop.fit(fit.extras, base=groups, warm=free, rows=seen, iterations=iterations)
        if not _rms(blind_free, self.recording)[1] < _rms(blind, self.recording)[1]:
            return selection, blind, causes
        unnamed = tuple(group for group in groups if group not in selection.causes)
        whole = replace(selection, fit=free, base=groups, unnamed=unnamed)
        found = self._causes(whole, blind_free, seen)
        lost = [g for g, c in found.items() if not _holds(c) or (constant and self._inconstancy(whole, g) > INCONSTANT)]
        if any(group.startswith("+") for group in lost) or (lost and not constant):
            return selection, blind, causes
        # A number of the machine that is no cause any more stays refitted with the others.
        whole = replace(whole, unnamed=(*unnamed, *lost))
        found = {group: cause for group, cause in found.items() if group not in lost}
        return whole, blind_free, tuple(sorted(found.values(), key=lambda cause: -cause.gain_N))

    def _inconstancy(self, selection: Selection, group: str) -> float:
        """How much a cause's size changes over the record."""
        fit = selection.fit
        base = tuple(g for g in selection.base if g != group)
        extras = tuple(e for i, e in enumerate(fit.extras) if f"+{i}" != group)
        without = self.workshop.fit(extras, base=base, warm=fit)
        inertial = _cause_name(fit, group) in INERTIAL
        return inconstancy(self.recording, without.residual - fit.residual, fit.residual, inertial=inertial)

    def _excess(self, fit: Fit) -> float:
        """RMS beyond noise [N]; of a record fitted in pieces, that of the pieces or of the whole, whichever is more."""
        beyond = fit.cross_rms**2 - self.floor**2
        if self.along is not None:
            left = self._left(fit)
            beyond = max(beyond, left.rms**2 - noise_floor(self.record, left.residual) ** 2)
        return math.sqrt(max(0.0, beyond))

    def _causes(self, selection: Selection, blind: Fit, seen: NDArray[np.bool_]) -> dict[str, Cause]:
        """Causes by group, with parameters of all data and gains of the fit without the held-out blocks."""
        recording, fit = self.recording, selection.fit
        covariance = self.workshop.covariance(fit)
        held = recording.held_out
        causes = {}
        for group in selection.causes:
            name = label = _cause_name(fit, group)
            if group.startswith("+"):
                index = int(group[1:])
                extras = tuple(e for i, e in enumerate(blind.extras) if i != index)
                base = selection.base
                if any(e.name == name for e in fit.extras[:index]):
                    label = f"{name}_2"
            else:
                extras, base = blind.extras, tuple(g for g in selection.base if g != group)
                label = group.removeprefix("machine:")
            without = self.workshop.fit(extras, base=base, warm=blind, rows=seen)
            before, held_before = _rms(without, recording)
            after, held_after = _rms(blind, recording)
            values, std, nominal = _reported(fit, covariance, group)
            causes[group] = Cause(
                name=name,
                label=label,
                parameters=values,
                std=std,
                nominal=nominal,
                rms=Rms(before, after, held_before, held_after),
                gain_N=gain_force(without.loss[held], blind.loss[held], fit.rows[held]),
                gain_interval_N=gain_interval(without.loss[held], blind.loss[held], fit.rows[held]),
                p_value=selection.p_values.get(group, math.nan),
            )
        return causes

    def _extension(self, selection: Selection, causes: Sequence[Cause]) -> tuple[Machine, str]:
        fit, machine = selection.fit, self.machine
        friction: dict[str, Any] = {}
        for group in selection.base:
            if group.startswith("machine:"):
                continue
            for name, value in fit.values(group).items():
                if name.startswith("stiffness"):
                    friction.setdefault("stiffness", []).append(value)
                else:
                    friction[name] = value
        if self.smoothing == "sharp":
            friction["smoothing"] = dict(SHARP)
        effects: list[dict[str, Any]] = []
        for effect in machine.effects:
            values = fit.values(f"machine:{effect.label}")
            own = f"machine:{effect.label}" in selection.base
            effects.append({"name": effect.name, **(values if own else effect.parameters)})
        effects += [{"name": e.name, **_tidy(e.parameters)} for e in fit.extras]
        names = [cause.label for cause in causes]
        changed = bool(fit.extras) or any(g.startswith("machine:") for g in selection.base)
        return extend_machine(machine, names, friction, effects if changed else None)

    def _alternatives(self, selection: Selection) -> tuple[Alternative, ...]:
        found = [
            Alternative(
                rival.name,
                f"fits as well as {rival.instead_of} on this record",
                True,
                rival.instead_of,
                _rival_values(rival.fit, rival.name),
                max(0.0, rival.excess_N),
            )
            for rival in selection.rivals
        ]
        named = [_cause_name(selection.fit, group) for group in selection.causes]
        unnamed = {_cause_name(selection.fit, group) for group in selection.unnamed}
        if found:  # the named causes that have rivals are listed with them
            for cause in dict.fromkeys(rival.instead_of for rival in selection.rivals):
                others = ", ".join(r.name for r in selection.rivals if r.instead_of == cause)
                found.append(Alternative(cause, f"named; fits as well as {others} on this record", True, None, {}, 0.0))
        taken = {a.name for a in found} | set(named)
        for name, (cause, excess) in sorted(selection.rejected.items(), key=lambda entry: entry[1][1]):
            if name not in taken:
                taken.add(name)
                why = (
                    "refitted with the causes, no cause of its own"
                    if name in unnamed
                    else "its size is not the same all over the record"
                    if name in selection.inconstant
                    else "its size, or its gain on data not used in the fit, may be zero"
                    if name == cause
                    else f"in place of {cause} leaves {excess:.3g} N more"
                )
                found.append(Alternative(name, why, False, None if name == cause else cause, {}, excess))
        for score in selection.scores:
            if score.name not in taken and score.outcome in ("redundant", "too small"):
                taken.add(score.name)
                why = (
                    "superfluous beside what is named"
                    if score.outcome == "redundant"
                    else f"would explain {score.gain_N:.2g} N, less than matters"
                )
                found.append(Alternative(score.name, why, False, None, dict(score.parameters)))
        return tuple(found)


def _cause_name(fit: Fit, group: str) -> str:
    """What a group's cause is called: the effect under test, the machine's own effect, or the base number."""
    if group.startswith("+"):
        return fit.extras[int(group[1:])].name
    return next((c.effect for c in fit.model.columns if c.group == group and c.effect), group)


def _holds(cause: Cause, *, constant: bool = False) -> bool:
    """Whether a cause has a size, and a gain on data that its fit has not seen.

    Of a cause that is the same all over the record (`constant`) the gain may be uncertain where it is certain that the
    cause is there: few blocks of a short record, not all of which it acts in.
    """
    certain = constant and cause.gain_N > 0.0 and cause.p_value < JOINT
    if not (cause.gain_interval_N[0] > 0.0 or certain):
        return False
    zero = cause.nominal or {key: NO_EFFECT.get((cause.name, key), 0.0) for key in cause.parameters}
    sizes = [
        key
        for key, value in cause.parameters.items()
        if math.isfinite(cause.std[key]) and (cause.nominal or is_size(cause.name, key)) and math.isfinite(value)
    ]
    if cause.nominal and len(sizes) > 1 and cause.p_value < JOINT:
        return True  # none of several numbers is determined alone, but together they differ
    return not sizes or any(abs(cause.parameters[key] - zero[key]) > SIGMAS * cause.std[key] for key in sizes)


def _tidy(values: Mapping[str, float]) -> dict[str, float]:
    """Phases within one turn, amplitudes positive."""
    tidy = dict(values)
    if "phase_rad" in tidy:
        size = next((k for k in tidy if k.startswith(("amplitude", "ratio"))), None)
        if size is not None and tidy[size] < 0.0:
            tidy[size], tidy["phase_rad"] = -tidy[size], tidy["phase_rad"] + math.pi
        tidy["phase_rad"] = math.remainder(tidy["phase_rad"], 2.0 * math.pi)
    return tidy


_UNITS: Final = {
    "coulomb": "coulomb_N",
    "viscous": "viscous_N_s_m",
    "stribeck_ratio": "stribeck_ratio",
    "stribeck_velocity": "stribeck_velocity_m_s",
}


def _report_name(name: str) -> str:
    return f"{name}_N_m" if name.startswith("stiffness_") and name[10:].isdigit() else _UNITS.get(name, name)


def _reported(fit: Fit, covariance: Array, group: str) -> tuple[dict[str, float], dict[str, float], dict[str, float]]:
    values, std, nominal = {}, {}, {}
    for i, column in enumerate(fit.model.columns):
        if column.group != group:
            continue
        name = column.name if group.startswith(("+", "machine:")) else _report_name(column.name)
        values[name] = column.si(float(fit.theta[i]))
        std[name] = math.sqrt(float(covariance[i, i])) * abs(column.scale) if fit.free[i] else math.nan
        if not group.startswith("+"):
            nominal[name] = column.si(column.machine_theta)
    return (_tidy(values) if group.startswith("+") else values), std, nominal


def _rival_values(fit: Fit, name: str) -> dict[str, float]:
    for extra in fit.extras:
        if extra.name == name:
            return _tidy(extra.parameters)
    return {_report_name(k): v for k, v in (fit.values(name) or fit.values(f"machine:{name}")).items()}


def _base_parameters(workshop: Workshop, fit: Fit) -> tuple[BaseParameter, ...]:
    covariance = workshop.covariance(fit)
    return tuple(
        BaseParameter(
            c.name if ":" not in c.group else f"{c.group.removeprefix('machine:')}.{c.name}",
            c.si(c.machine_theta),
            c.si(float(fit.theta[i])),
            math.sqrt(float(covariance[i, i])) * abs(c.scale) if fit.free[i] else math.nan,
        )
        for i, c in enumerate(fit.model.columns)
        if not c.group.startswith("+")
    )


def _unnamed(scores: Sequence[Score]) -> tuple[Score, ...]:
    return tuple(replace(s, outcome="redundant") if s.outcome == "named" else s for s in scores)


def _traces(recording: Recording, nominal: _Left, start: _Left, extended: _Left, blind: _Left) -> Traces:
    measured = recording.reduce(recording.signals.friction)
    return Traces(
        time_s=recording.time,
        position_m=recording.position,
        velocity_m_s=recording.velocity,
        acceleration_m_s2=recording.acceleration,
        force_N=recording.force,
        friction_N=measured,
        nominal_N=measured - nominal.residual,
        refitted_N=measured - start.residual,
        extended_N=measured - extended.residual,
        held_out_fit_N=measured - blind.residual,
        used=recording.used,
        held_out=recording.rows_held_out(),
        block=recording.block,
        rate=recording.rate,
    )


def separating_move(first: str, second: str) -> str | None:
    """The move that tells two causes apart, from their definitions."""
    for one, other in ((first, second), (second, first)):
        table: Mapping[str, str] = {}
        if one in effect_names():
            table = effect_definition(one).confused_with
        elif one in BASE_CAUSES:
            table = BASE_CAUSES[one].confused_with
        if other in table:
            return table[other]
    return None


def _excitation(name: str) -> str | None:
    if name in effect_names():
        return effect_definition(name).excitation.text
    return BASE_CAUSES[name].excitation.text if name in BASE_CAUSES else None


def _experiment(verdict: Verdict, causes: Sequence[Cause], rivals: Sequence[Alternative]) -> str | None:
    if verdict == "unexplained":
        return "the same motion twice, and once at half the speed: what stays in place, in time or in velocity shows"
    moves = []
    for rival in rivals:
        if rival.instead_of is None:
            continue
        move = separating_move(rival.instead_of, rival.name)
        if move is None:
            wanted = [text for text in (_excitation(rival.instead_of), _excitation(rival.name)) if text]
            move = "; and ".join(dict.fromkeys(wanted)) or "another motion"
        moves.append(f"{rival.instead_of} or {rival.name}: {move}")
    return ". ".join(moves) if moves else None


def _summary(verdict: Verdict, causes: Sequence[str], rivals: Sequence[str], before: float, after: float) -> str:
    gain = f"the residual on data not used in the fit goes from {before:.3g} N to {after:.3g} N RMS"
    if verdict == "adequate":
        return f"The simulation explains the record; {before:.3g} N RMS are left, nothing is named."
    if verdict == "unexplained":
        return f"{before:.3g} N RMS are left that no known effect accounts for; nothing is named."
    if verdict == "ambiguous":
        others = [name for name in dict.fromkeys(rivals) if name not in causes]
        return f"{', '.join(causes)}, but {', '.join(others)} would fit as well: {gain}."
    return f"{', '.join(causes)}: {gain}."


def _without_excitation(
    machine: Machine, log: Log, recording: Recording, nominal: Fit, floor: float, started: float
) -> Diagnosis:
    rms, held = _rms(nominal, recording)
    maps = structure_map(recording, nominal.residual)
    excess = math.sqrt(max(0.0, nominal.rms**2 - floor**2))
    return Diagnosis(
        machine=machine,
        source=log.source,
        verdict="adequate" if excess < max(UNEXPLAINED * machine.friction.coulomb, 0.5 * floor) else "unexplained",
        summary="There is no excitation in this record: the axis hardly moves, so nothing can be said about friction.",
        causes=(),
        alternatives=(),
        separating_experiment="record a motion: strokes in both directions at several speeds, with reversals and rests",
        rms=Rms(rms, rms, held, held),
        noise_floor_N=floor,
        gain_interval_N=(0.0, 0.0),
        base=(),
        scores=(),
        structure_before=maps,
        structure_after=maps,
        traces=_traces(recording, *4 * (_Left(nominal.residual, nominal.loss, nominal.rows),)),
        extended=None,
        extended_toml=None,
        smoothing="machine",
        excited=False,
        warnings=(*recording.warnings, "no excitation: the axis hardly moves"),
        seconds=time.monotonic() - started,
    )
