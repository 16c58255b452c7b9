"""Causes that hold on data their fit has not seen: sizes, intervals, gains, and the machine extended by them."""

import math
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Final

from sgms_mhe.diagnosis.criteria import MATERIAL_NOISE, hangs_on_time, material_force, small_force
from sgms_mhe.diagnosis.final_fit import FinalFit, split_rms
from sgms_mhe.diagnosis.fits import ITERATIONS, Fit, fit_model, report_name, report_values
from sgms_mhe.diagnosis.models import FitError
from sgms_mhe.diagnosis.parametrisation import ParameterGroup, drop_effect, drop_group, machine_groups, smooth_law
from sgms_mhe.diagnosis.parts import Cause, Rms
from sgms_mhe.diagnosis.rivals import Rejected, Selection
from sgms_mhe.diagnosis.uncertainty import covariance, standard_deviations
from sgms_mhe.model.effects import BASE_CAUSES, effect_definition
from sgms_mhe.model.effects import cause as cause_definition
from sgms_mhe.model.scales import scales_of
from sgms_mhe.recordings.evidence import gain_force, gain_interval, inconstancy
from sgms_mhe.support.decisions import log_decision
from sgms_mhe.support.numbers import SIGMAS

CERTAIN_SIGMAS: Final = 10.0
"""The same of a size that is certain, whatever the interval of its gain, where its cause leaves nothing [standard
deviations]: what acts in a few blocks alone may be in none of those that the interval draws."""
VAGUE: Final = 0.5
"""Interval from which a number of the machine that does not differ from the file is not determined [value]: half of it
may be chance: the file's stays."""
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


def measure_causes(final: FinalFit, selection: Selection, blind: Fit) -> dict[ParameterGroup, Cause]:
    """Causes of a selection, with parameters of all data and gains of a fit `blind` to the held-out blocks."""
    recording, fit = final.recording, selection.fit
    deviations = standard_deviations(covariance(final.subject, fit, final.other), fit)
    held = recording.held_out
    causes = {}
    for group in selection.causes:
        effects, refitted = drop_effect(blind.effects, group), drop_group(selection.refitted, group)
        without = fit_model(final.subject, effects, refitted=refitted, warm=blind, rows=final.seen)
        before, held_before = split_rms(without, recording)
        after, held_after = split_rms(blind, recording)
        causes[group] = Cause(
            name=group.cause,
            label=name_cause(fit, group),
            parameters=report_values(fit, group),
            std={
                # Of a number that a bound stops, the record says that it is beyond.
                report_name(group, c.name): math.nan if stops else s
                for c, s, stops in zip(fit.model.columns, deviations, fit.free & ~fit.interior, strict=True)
                if c.group == group
            },
            nominal=_file_values(fit, group),
            rms=Rms(before, after, held_before, held_after),
            gain_N=gain_force(without.loss[held], blind.loss[held], fit.rows[held]),
            gain_interval_N=gain_interval(without.loss[held], blind.loss[held], fit.rows[held]),
            p_value=selection.p_values.get(group, math.nan),
        )
    return {group: replace(cause, vague=find_vague(cause)) for group, cause in causes.items()}


def name_cause(fit: Fit, group: ParameterGroup) -> str:
    """Return the label of a cause within the extended machine."""
    again = group.is_candidate and any(e.name == group.cause for e in fit.effects[: group.index])
    return f"{group.cause}_2" if again else group.name


def find_vague(cause: Cause) -> tuple[str, ...]:
    """Return the parameters the record does not determine: intervals as wide as they are, or none."""
    found = []
    for key, value in cause.parameters.items():
        margin = SIGMAS * cause.std[key]
        if cause.nominal:
            known = margin <= VAGUE * abs(value)
        else:
            parameter = effect_definition(cause.name).parameter(key)
            known = parameter.role == "place" or margin < abs(value - parameter.none)
        if not known:  # NaN included
            found.append(key)
    return tuple(found)


def is_confirmed(cause: Cause, *, complete: bool = False, certain_p: float = 0.0) -> bool:
    """Return True if a cause has a size, and a gain on data its fit has not seen.

    The gain may be uncertain where it is certain the cause is there: few blocks of a short record, not all of
    which it acts in. It is where its test gives less than `certain_p`; and where the fit
    leaves nothing that matters (`complete`), by its sizes.
    """
    sizes = _sizes(cause)
    apart = [abs(cause.parameters[key] - none) / cause.std[key] for key, none in sizes.items() if cause.std[key] > 0.0]
    known = complete and bool(apart) and min(apart) > CERTAIN_SIGMAS
    certain = cause.gain_N > 0.0 and (known or cause.p_value < certain_p)
    return (cause.gain_interval_N[0] > 0.0 or certain) and has_size(cause)


def has_size(cause: Cause) -> bool:
    """Return True if a determined size differs significantly from its no-effect value."""
    sizes = _sizes(cause)
    return not sizes or any(abs(cause.parameters[key] - none) > SIGMAS * cause.std[key] for key, none in sizes.items())


def is_possible(cause: Cause, final: FinalFit) -> bool:
    """Return True if an axis can have a cause of this size."""
    if cause.nominal:
        return True
    return effect_definition(cause.name).possible(cause.parameters, scales_of(final.subject.machine))


def _sizes(cause: Cause) -> dict[str, float]:
    """Parameters the record determines and that say how much of a cause there is, and where it is none."""
    known = [key for key, value in cause.parameters.items() if math.isfinite(cause.std[key]) and math.isfinite(value)]
    if cause.nominal:
        return {key: cause.nominal[key] for key in known}
    definition = effect_definition(cause.name)
    return {key: definition.parameter(key).none for key in known if definition.parameter(key).is_size}


def _file_values(fit: Fit, group: ParameterGroup) -> dict[str, float]:
    """Return the machine file's numbers of a group; none for an effect under test."""
    return {
        report_name(group, c.name): c.si(c.machine_theta)
        for c in fit.model.columns
        if c.group == group and not group.is_candidate
    }


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


def confirm_causes(final: FinalFit, selection: Selection) -> Confirmed:
    """The causes that hold on held-out data; the others are taken out, the weakest first."""
    while selection.causes:
        fit = selection.fit
        blind = fit_model(final.subject, fit.effects, refitted=selection.refitted, warm=fit, rows=final.seen)
        causes = measure_causes(final, selection, blind)
        doubts = _find_doubts(final, fit, causes, explained=True)
        found = Confirmed(selection, blind, _strongest_first(causes))
        if not doubts:
            doubts = dict.fromkeys(_find_undetermined(final, found), "none once undetermined numbers are the file's")
        log_decision(
            "confirmation",
            "the weakest cause that a rule doubts is taken out",
            beyond_noise_N=final.excess(fit),
            least_gain_N=small_force(final.subject.machine),
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
        selection = _without(final, selection, weakest)
    return Confirmed(selection, selection.fit, ())


def _find_doubts(
    final: FinalFit, fit: Fit, causes: Mapping[ParameterGroup, Cause], *, explained: bool
) -> dict[ParameterGroup, str]:
    """Return the rule by which a cause does not hold, of each that does not; `explained`: as of `refit_numbers`."""
    machine, left = final.subject.machine, final.excess(fit)
    complete, small = left < material_force(machine, final.floor), small_force(machine)
    # Where something is left a short cause has few blocks to draw the interval from, but a test of its own.
    certain_p = 0.0 if explained else machine.diagnosis.significance

    def doubt(group: ParameterGroup, cause: Cause) -> str:
        if not is_confirmed(cause, complete=complete, certain_p=certain_p):
            return "its size, or its gain on held-out data, may be zero"
        if not is_possible(cause, final):
            return "a number that is physically impossible"
        if _is_imitation(final, fit, group, cause):
            return "may be the difference of the laws of friction"
        if _is_echo(cause, causes.values()):
            return "a small sine with the period of a large one"
        if cause.gain_N < (min(small, left) if group.is_candidate else small):
            return "its gain is less than matters"
        if not group.is_candidate and cause.gain_N < final.encoder_friction:
            return "its gain is no more than the encoder's steps leave where elements stick"
        return ""

    return {group: rule for group, cause in causes.items() if (rule := doubt(group, cause))}


def _is_echo(cause: Cause, causes: Collection[Cause]) -> bool:
    """Return True if a small sine has the period of a large one: the error in the form of that repeats with it."""
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
    """Return coordinate, period and margin of a sine; None of any other cause."""
    sine = None if cause.name in BASE_CAUSES else effect_definition(cause.name).sine
    if sine is None:
        return None
    return sine.coordinate, cause.parameters[sine.period], SIGMAS * cause.std[sine.period]


def _is_imitation(final: FinalFit, fit: Fit, group: ParameterGroup, cause: Cause) -> bool:
    """Return True if a wrong number may be the error of elements that stand for switching ones.

    Beside an effect that stands with no such elements no record says that an axis does not switch.
    """
    laws = (final.subject, final.other or final.subject)
    if group.is_candidate or all(smooth_law(law.machine, fit.effects) is law.machine for law in laws):
        return False
    return cause.gain_N < REPLACED_LAW_GAIN * final.floor


def keep_predictive(final: FinalFit, selection: Selection) -> Confirmed:
    """The causes without which more is left on held-out data; the weakest of the others is taken out first.

    For where something is left that no cause accounts for: the machine that predicts best, whether its causes have
    names (`find_nameless`) or not. A cause in time has to be sure, and every other constant over the record: a force
    that wanders may be left, which such causes take the form of; and they predict no other record. A number
    of the machine without a name stays refitted, but is not listed.
    """
    for group in selection.causes:
        if _is_consequence(final, selection, group):
            selection = _unname(final, selection, group)
    while timed := [group for group in selection.causes if _hangs_on_time(group)]:
        change = {group: _inconstancy(final, selection, group) for group in selection.causes}
        if max(change.values()) < INCONSTANT:
            break
        worst = max(timed, key=lambda group: change[group])
        less = _unname(final, selection, worst)
        selection = replace(less, inconstant=(*selection.inconstant, worst.cause))
    while selection.causes:
        fit = selection.fit
        blind = fit_model(final.subject, fit.effects, refitted=selection.refitted, warm=fit, rows=final.seen)
        causes = measure_causes(final, selection, blind)
        doubts = _find_doubts(final, fit, causes, explained=False)
        lost = [
            group
            for group, cause in causes.items()
            if not (cause.gain_N > 0.0 and is_possible(cause, final))
            or (group in doubts and (not group.is_candidate or _hangs_on_time(group)))
        ]
        log_decision(
            "prediction",
            "the weakest is taken out of what gains nothing on held-out data, and of doubted numbers and timed causes",
            gain_N={cause.label: cause.gain_N for cause in causes.values()},
            lost=[causes[group].label for group in lost],
        )
        if not lost:
            return refit_numbers(final, Confirmed(selection, blind, _strongest_first(causes)), explained=False)
        selection = _unname(final, selection, min(lost, key=lambda group: causes[group].gain_N))
    return Confirmed(selection, selection.fit, ())


def find_nameless(final: FinalFit, found: Confirmed) -> frozenset[str]:
    """Return the labels of the causes that are none: a rule doubts them, or their size changes over the record."""
    selection = found.selection
    groups = {name_cause(selection.fit, group): group for group in selection.causes}
    causes = {groups[cause.label]: cause for cause in found.causes}
    change = {cause.label: _inconstancy(final, selection, group) for group, cause in causes.items()}
    doubts = _find_doubts(final, selection.fit, causes, explained=False)
    log_decision(
        "constancy",
        "a cause that is doubted or whose size changes over the record has no name",
        change=change,
        allowed=INCONSTANT,
        doubts={causes[group].label: rule for group, rule in doubts.items()},
    )
    doubted = frozenset(causes[group].label for group in doubts)
    return doubted.union(label for label, value in change.items() if not value < INCONSTANT)


def _hangs_on_time(group: ParameterGroup) -> bool:
    """Return True if it is an effect under test whose force hangs on when a log begins."""
    return group.is_candidate and hangs_on_time(group.cause)


def refit_numbers(final: FinalFit, found: Confirmed, *, explained: bool) -> Confirmed:
    """The same causes with all numbers of the machine refitted, where that is better on held-out data.

    Where something is left that nothing accounts for, or the axis slips by another law than the file's, the machine's
    numbers may do best at other values, and fixed at the file's they pass their errors on to the effects. They are no
    causes for that. `explained`: nothing is left, so that each cause has to hold; else each has to gain.
    """
    if not found.causes:
        return found
    selection = found.selection
    fit, groups = selection.fit, machine_groups(final.subject.machine)
    # Where all is explained the numbers are near the file's; else a fit may have far to go.
    starts = (fit,) if explained else (selection.free, final.start, fit)
    iterations = ITERATIONS if explained else PATIENT_ITERATIONS
    free: Fit | None = None
    for warm in starts:
        with suppress(FitError):  # beside a gap some of them are no model of the record
            free = fit_model(final.subject, fit.effects, refitted=groups, warm=warm, iterations=iterations, again=True)
    if free is None:
        return found
    blind = fit_model(final.subject, fit.effects, refitted=groups, warm=free, rows=final.seen, iterations=iterations)
    if not split_rms(blind, final.recording)[1] < split_rms(found.blind, final.recording)[1]:
        return found
    unnamed = tuple(group for group in groups if group not in selection.causes)
    whole = replace(selection, fit=free, refitted=groups, unnamed=unnamed)
    causes = measure_causes(final, whole, blind)
    lost = [
        group
        for group, cause in causes.items()
        if not (cause.gain_N > 0.0 if group.is_candidate and not explained else is_confirmed(cause))
    ]
    if any(group.is_candidate or explained for group in lost):
        return found
    # A number of the machine that is no cause any more stays refitted with the others.
    whole = replace(whole, unnamed=(*unnamed, *lost))
    return Confirmed(whole, blind, _strongest_first({g: c for g, c in causes.items() if g not in lost}))


def restore_undetermined(final: FinalFit, found: Confirmed) -> Confirmed:
    """The same causes with numbers at the machine file's that the record does not determine, where that costs nothing.

    A refit moves all numbers of a cause together. One of an element that hardly shows may end anywhere, and would stand
    in the extended machine as if it were known. Where the machine's numbers are the record's own there is no file's.
    """
    if final.subject.is_open:
        return found
    selection = found.selection
    fit = selection.fit
    deviations = standard_deviations(covariance(final.subject, fit, final.other), fit)
    fixed: set[str] = set()
    for group in machine_groups(final.subject.machine):
        numbers = [
            (c.name, c.si(float(t)), c.si(c.machine_theta), SIGMAS * s)
            for c, t, s in zip(fit.model.columns, fit.theta, deviations, strict=True)
            if c.group == group and math.isfinite(s)
        ]
        vague = {
            name for name, value, file, margin in numbers if abs(value - file) <= margin and margin > VAGUE * abs(value)
        }
        fixed |= vague if len(vague) < len(numbers) else set()
    if not fixed:
        return found
    names = frozenset(fixed)
    least = fit_model(final.subject, fit.effects, refitted=selection.refitted, warm=fit, fixed=names)
    level = final.subject.machine.diagnosis.material * final.subject.machine.friction.coulomb
    if fit.gain_over(least) > max(level, MATERIAL_NOISE * final.floor):
        return found
    blind = fit_model(
        final.subject, least.effects, refitted=selection.refitted, warm=least, rows=final.seen, fixed=names
    )
    selection = replace(selection, fit=least)
    return Confirmed(selection, blind, _strongest_first(measure_causes(final, selection, blind)))


def _find_undetermined(final: FinalFit, found: Confirmed) -> list[ParameterGroup]:
    """Wrong numbers of the machine that are none once the ones are as in its file the record does not determine.

    Together they may make up for an error of something else.
    """
    own = [group for group in found.selection.causes if not group.is_candidate]
    if not own:
        return own
    known = {cause.name for cause in restore_undetermined(final, found).causes if has_size(cause)}
    return [group for group in own if group.cause not in known]


def _strongest_first(causes: Mapping[ParameterGroup, Cause]) -> tuple[Cause, ...]:
    return tuple(sorted(causes.values(), key=lambda cause: -cause.gain_N))


def _without(final: FinalFit, selection: Selection, group: ParameterGroup) -> Selection:
    """The selection without one of its causes, the others fitted again."""
    refitted = drop_group(selection.refitted, group)
    fit = fit_model(final.subject, drop_effect(selection.fit.effects, group), refitted=refitted, warm=selection.fit)
    return _remove_name(replace(selection, fit=fit, refitted=refitted), selection, group)


def _unname(final: FinalFit, selection: Selection, group: ParameterGroup) -> Selection:
    """The same where more is left than is known: a number of the machine stays refitted, but is no cause.

    Held at the file's it would pass its error on to the other causes, which then would seem to change.
    """
    if group.is_candidate:
        return _without(final, selection, group)
    return _remove_name(replace(selection, unnamed=(*selection.unnamed, group)), selection, group)


def _remove_name(selection: Selection, before: Selection, group: ParameterGroup) -> Selection:
    """Return the causes of a selection that had one more, `group`, `before`."""
    left = [g for g in before.causes if g != group]
    return replace(
        selection,
        rivals=tuple(rival for rival in before.rivals if rival.instead_of != group.cause),
        rejected={**before.rejected, group.cause: Rejected(group.cause, 0.0)},
        p_values={new: before.p_values.get(old, math.nan) for old, new in zip(left, selection.causes, strict=True)},
    )


def _inconstancy(final: FinalFit, selection: Selection, group: ParameterGroup) -> float:
    """Return the relative change of a cause's size over the record."""
    fit = selection.fit
    refitted = drop_group(selection.refitted, group)
    without = fit_model(final.subject, drop_effect(fit.effects, group), refitted=refitted, warm=fit)
    inertial = cause_definition(group.cause).inertial
    return inconstancy(final.recording, without.residual - fit.residual, fit.residual, inertial=inertial)


def _is_consequence(final: FinalFit, selection: Selection, group: ParameterGroup) -> bool:
    """Return True if a number of the machine is wrong only beside the effects: right for a model without them."""
    if group.is_candidate or not selection.fit.effects:
        return False
    fit, plain = selection.fit, fit_model(final.subject, (), refitted=())
    without = fit_model(final.subject, fit.effects, refitted=drop_group(selection.refitted, group), warm=fit)
    alone = fit_model(final.subject, (), refitted=(group,), warm=plain)
    gained = alone.gain_over(plain)
    return gained < FOLLOWS * fit.gain_over(without)
