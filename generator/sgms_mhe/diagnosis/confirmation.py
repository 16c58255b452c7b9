"""Causes that hold on data that their fit has not seen, and over all of the record."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Final

from sgms_mhe.diagnosis.causes import SIGMAS, VAGUE, has_size, holds, is_possible, measured_causes
from sgms_mhe.diagnosis.compiling import bearing
from sgms_mhe.diagnosis.covariance import covariance, standard_deviations
from sgms_mhe.diagnosis.criteria import MATERIAL_NOISE, material_force, small_force
from sgms_mhe.diagnosis.descent import FitError
from sgms_mhe.diagnosis.fitting import ITERATIONS
from sgms_mhe.diagnosis.groups import Group, machine_groups, without_extra, without_group
from sgms_mhe.diagnosis.result import Cause
from sgms_mhe.diagnosis.rivals import Rejected
from sgms_mhe.diagnosis.selection import Selection
from sgms_mhe.diagnosis.settling import Settled, split_rms
from sgms_mhe.diagnosis.subject import Fit
from sgms_mhe.model.effects import BASE_CAUSES, effect_definition
from sgms_mhe.model.effects import cause as cause_definition
from sgms_mhe.recordings.evidence import gain_force, inconstancy
from sgms_mhe.support.decisions import log_decision

PATIENT_ITERATIONS: Final = 40
"""Steps of a fit, at most, where all of the machine's numbers may have far to go [1]: what is left then moves all of
them."""
REPLACED_LAW_GAIN: Final = 3.0
"""Gain of a wrong number, where elements that switch are stood in for by ones that slip almost at once [noise floors]:
that leaves up to 2.7 noise floors, which a Stribeck effect imitates."""
INCONSTANT: Final = 0.3
"""RMS change of a cause's size over the record that rules it out [size]: an imitation fits here and misfits there."""
ECHO: Final = 0.1
"""Gain below which a sine of the same period as another effect is none [gain of the other]: what the form of a large
sine gets wrong comes again with it."""
FOLLOWS: Final = 0.5
"""Gain of a refitted number without the effects, from which it is a cause of its own [gain beside the effects]: with
less it was right for a model without them."""


@dataclass(frozen=True, eq=False)
class Confirmed:
    """Causes that hold.

    Attributes:
        selection: of them.
        blind: its fit without the held-out blocks.
        causes: strongest first.
    """

    selection: Selection
    blind: Fit
    causes: tuple[Cause, ...]


def confirmed(settled: Settled, selection: Selection, *, constant: bool = False) -> Confirmed:
    """The causes that hold on held-out data; what does not is taken out, the weakest first.

    `constant`: they are known to be the same all over the record.
    """
    while selection.causes:
        fit = selection.fit
        blind = settled.fit(fit.extras, refitted=selection.refitted, warm=fit, rows=settled.seen)
        causes = measured_causes(settled, selection, blind)
        left, machine = settled.excess(fit), settled.subject.machine
        complete = left < material_force(machine, settled.floor)
        small = small_force(machine)
        doubts = {
            g: doubt
            for g, cause in causes.items()
            if (doubt := _doubt(settled, fit, g, causes, constant=constant, complete=complete))
        }
        found = Confirmed(selection, blind, _strongest_first(causes))
        if not doubts:
            doubts = dict.fromkeys(_undetermined(settled, found), "none once undetermined numbers are the file's")
        log_decision(
            "confirmation",
            "the weakest cause that a rule doubts is taken out",
            same_everywhere=constant,
            beyond_noise_N=left,
            complete=complete,
            least_gain_N=small,
            causes=[
                {"name": cause.label, "gain_N": cause.gain_N, "gain_interval_N": cause.gain_interval_N,
                 "p_value": cause.p_value, "parameters": cause.parameters, "std": cause.std,
                 "doubt": doubts.get(group)}
                for group, cause in causes.items()
            ],
        )  # fmt: skip
        if not doubts:
            return found
        weakest = min(doubts, key=lambda group: causes[group].gain_N)
        selection = _not_named(settled, selection, weakest) if constant else _without(settled, selection, weakest)
    return Confirmed(selection, selection.fit, ())


def _doubt(
    settled: Settled, fit: Fit, group: Group, causes: Mapping[Group, Cause], *, constant: bool, complete: bool
) -> str | None:
    """Return the rule by which a cause does not hold, None if it does; `complete`: its fit leaves next to nothing."""
    cause, small = causes[group], small_force(settled.subject.machine)
    if not holds(cause, constant=constant, complete=complete):
        return "its size, or its gain on held-out data, may be zero"
    if not is_possible(cause, settled):
        return "a number that is physically impossible"
    if _imitates(settled, fit, group, cause):
        return "may be the difference of the laws of friction"
    if _echoes(cause, causes.values()):
        return "a small sine with the period of a large one"
    if cause.gain_N < (min(small, settled.excess(fit)) if group.is_extra else small):
        return "its gain is less than matters"
    return None


def _echoes(cause: Cause, causes: Collection[Cause]) -> bool:
    """Whether a small sine has the period of a large one: what the form of that gets wrong comes again with it."""
    own = _period(cause)
    if own is None:
        return False
    coordinate, length, margin = own
    return any(
        cause.gain_N < ECHO * other.gain_N
        and (period := _period(other)) is not None
        and period[0] == coordinate
        and abs(period[1] - length) < margin + period[2]
        for other in causes
    )


def _period(cause: Cause) -> tuple[str, float, float] | None:
    """Of a sine: over what it repeats, how long, and how far off that may be; None: it is none."""
    sine = None if cause.name in BASE_CAUSES else effect_definition(cause.name).sine
    if sine is None:
        return None
    return sine.coordinate, cause.parameters[sine.period], SIGMAS * cause.std[sine.period]


def _imitates(settled: Settled, fit: Fit, group: Group, cause: Cause) -> bool:
    """Whether a wrong number may be no more than what elements get wrong that stand in for ones that switch.

    Beside an effect that stands with no such elements no record says that an axis does not switch.
    """
    laws = (settled.subject, settled.other or settled.subject)
    if group.is_extra or all(bearing(law.machine, fit.extras) is law.machine for law in laws):
        return False
    return cause.gain_N < REPLACED_LAW_GAIN * settled.floor


def constant_causes(settled: Settled, selection: Selection) -> Confirmed:
    """The causes whose size is the same everywhere in the record, the least constant one taken out first."""
    for group in selection.causes:
        if _follows(settled, selection, group):
            selection = _not_named(settled, selection, group)
    while selection.causes:
        change = {group: _inconstancy(settled, selection, group) for group in selection.causes}
        worst = max(change, key=lambda group: change[group])
        log_decision(
            "constancy",
            "the cause whose size changes most over the record is taken out",
            change={group.name: value for group, value in change.items()},
            allowed=INCONSTANT,
        )
        if change[worst] < INCONSTANT:
            break
        less = _not_named(settled, selection, worst)
        selection = replace(less, inconstant=(*selection.inconstant, worst.cause))
    return refitted_beside(settled, confirmed(settled, selection, constant=True), constant=True)


def refitted_beside(settled: Settled, found: Confirmed, *, constant: bool) -> Confirmed:
    """The same causes with all numbers of the machine refitted, where that is better on held-out data.

    Where something is left that nothing accounts for, or the axis slips by another law than the file's, the machine's
    numbers may do best at other values, and held at the file's they pass their errors on to the effects. They are no
    causes for that. `constant`: the causes have to stay the same all over the record.
    """
    if not found.causes:
        return found
    selection = found.selection
    fit, groups = selection.fit, machine_groups(settled.subject.machine)
    # Where all is explained the numbers are near the file's; else a fit may have far to go.
    starts = (selection.free, settled.start, fit) if constant else (fit,)
    iterations = PATIENT_ITERATIONS if constant else ITERATIONS
    free: Fit | None = None
    for warm in starts:
        with suppress(FitError):  # beside a gap some of them are no model of the record
            free = settled.fit(fit.extras, refitted=groups, warm=warm, iterations=iterations, again=True)
    if free is None:
        return found
    blind = settled.fit(fit.extras, refitted=groups, warm=free, rows=settled.seen, iterations=iterations)
    if not split_rms(blind, settled.recording)[1] < split_rms(found.blind, settled.recording)[1]:
        return found
    unnamed = tuple(group for group in groups if group not in selection.causes)
    whole = replace(selection, fit=free, refitted=groups, unnamed=unnamed)
    causes = measured_causes(settled, whole, blind)
    lost = [
        group
        for group, cause in causes.items()
        if not holds(cause) or (constant and _inconstancy(settled, whole, group) > INCONSTANT)
    ]
    if any(group.is_extra for group in lost) or (lost and not constant):
        return found
    # A number of the machine that is no cause any more stays refitted with the others.
    whole = replace(whole, unnamed=(*unnamed, *lost))
    return Confirmed(whole, blind, _strongest_first({g: c for g, c in causes.items() if g not in lost}))


def without_undetermined(settled: Settled, found: Confirmed) -> Confirmed:
    """The same causes with numbers at the machine file's that the record does not determine, where that costs nothing.

    A refit moves all numbers of a cause together. One of an element that hardly shows may end anywhere, and would stand
    in the extended machine as if it were known.
    """
    selection = found.selection
    fit = selection.fit
    deviations = standard_deviations(covariance(settled.subject, fit, settled.other), fit)
    held: set[str] = set()
    for group in machine_groups(settled.subject.machine):
        numbers = [
            (c.name, c.si(float(t)), c.si(c.machine_theta), SIGMAS * s)
            for c, t, s in zip(fit.model.columns, fit.theta, deviations, strict=True)
            if c.group == group and math.isfinite(s)
        ]
        vague = {
            name for name, value, file, margin in numbers if abs(value - file) <= margin and margin > VAGUE * abs(value)
        }
        held |= vague if len(vague) < len(numbers) else set()
    if not held:
        return found
    names = frozenset(held)
    least = settled.fit(fit.extras, refitted=selection.refitted, warm=fit, held=names)
    level = settled.subject.machine.diagnosis.material * settled.subject.machine.friction.coulomb
    if gain_force(least.cross, fit.cross, fit.rows) > max(level, MATERIAL_NOISE * settled.floor):
        return found
    blind = settled.fit(least.extras, refitted=selection.refitted, warm=least, rows=settled.seen, held=names)
    selection = replace(selection, fit=least)
    return Confirmed(selection, blind, _strongest_first(measured_causes(settled, selection, blind)))


def _undetermined(settled: Settled, found: Confirmed) -> list[Group]:
    """Wrong numbers of the machine that are none once the ones are as in its file that the record does not determine.

    Together they may make up for what something else gets wrong.
    """
    own = [group for group in found.selection.causes if not group.is_extra]
    if not own:
        return own
    known = {cause.name for cause in without_undetermined(settled, found).causes if has_size(cause)}
    return [group for group in own if group.cause not in known]


def _strongest_first(causes: Mapping[Group, Cause]) -> tuple[Cause, ...]:
    return tuple(sorted(causes.values(), key=lambda cause: -cause.gain_N))


def _without(settled: Settled, selection: Selection, group: Group) -> Selection:
    """The selection without one of its causes, the others fitted again."""
    refitted = without_group(selection.refitted, group)
    fit = settled.fit(without_extra(selection.fit.extras, group), refitted=refitted, warm=selection.fit)
    return _named_less(replace(selection, fit=fit, refitted=refitted), selection, group)


def _not_named(settled: Settled, selection: Selection, group: Group) -> Selection:
    """The same where more is left than is known: a number of the machine stays refitted, but is no cause.

    Held at the file's it would pass its error on to the other causes, which then would seem to change.
    """
    if group.is_extra:
        return _without(settled, selection, group)
    return _named_less(replace(selection, unnamed=(*selection.unnamed, group)), selection, group)


def _named_less(selection: Selection, before: Selection, group: Group) -> Selection:
    """What belongs to the causes of a selection that had one more, `group`, `before`."""
    left = [g for g in before.causes if g != group]
    return replace(
        selection,
        rivals=tuple(rival for rival in before.rivals if rival.instead_of != group.cause),
        rejected={**before.rejected, group.cause: Rejected(group.cause, 0.0)},
        p_values={new: before.p_values.get(old, math.nan) for old, new in zip(left, selection.causes, strict=True)},
    )


def _inconstancy(settled: Settled, selection: Selection, group: Group) -> float:
    """How much a cause's size changes over the record."""
    fit = selection.fit
    refitted = without_group(selection.refitted, group)
    without = settled.fit(without_extra(fit.extras, group), refitted=refitted, warm=fit)
    inertial = cause_definition(group.cause).inertial
    return inconstancy(settled.recording, without.residual - fit.residual, fit.residual, inertial=inertial)


def _follows(settled: Settled, selection: Selection, group: Group) -> bool:
    """Whether a number of the machine is wrong only beside the effects: it was right for a model without them."""
    if group.is_extra or not selection.fit.extras:
        return False
    fit, plain = selection.fit, settled.fit((), refitted=())
    without = settled.fit(fit.extras, refitted=without_group(selection.refitted, group), warm=fit)
    alone = settled.fit((), refitted=(group,), warm=plain)
    gained = gain_force(plain.cross, alone.cross, fit.rows)
    return gained < FOLLOWS * gain_force(without.cross, fit.cross, fit.rows)
