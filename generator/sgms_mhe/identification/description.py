"""The numbers of a final fit as those of a machine file, and sentences on the questions the records leave open."""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from sgms_mhe.identification.elements import NO_RISE
from sgms_mhe.identification.final_fit import FinalIdentification, is_apart, late_force
from sgms_mhe.identification.fits import AxisFit, NumberEstimate, RecordView, Shape, fit_axis, hold_shape
from sgms_mhe.identification.result import Number
from sgms_mhe.identification.search import ChosenModel, is_better
from sgms_mhe.identification.spectrum import LARGEST
from sgms_mhe.identification.terms import LATE, LAW_AND_SAMPLING, effect_parameters, is_level
from sgms_mhe.machine import Units
from sgms_mhe.model.effects import MOVES, Measure, cause, effect_definition, separating_moves
from sgms_mhe.recordings.excitation import find_speeds_apart
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.numbers import SIGMAS, interval
from sgms_mhe.support.statements import Rule, Statement

KNOWN: Final = 0.25
"""Deviation over value up to which a number counts as determined."""
UNTOLD: Final = 10.0
"""Two deviations over the distance to a number's only limit from which on not even its order is known."""
ROUNDING: Final = 1e-12
MISFIT: Final = 2.0
"""Noise floors of a residual beyond which three quarters of its power are no noise."""
OPEN_LEVEL: Final = 0.15
"""Share of the level in elements beyond that from which a record counts as one of presliding alone."""
CONTROLLED: Final[Mapping[str, tuple[str, ...]]] = {
    "coulomb": ("coulomb",),
    "viscous": ("viscous",),
    "stribeck": ("stribeck_ratio", "stribeck_velocity"),
    "stiffness": ("stiffness", "fraction"),
}
"""Numbers by the cause whose excitation says what a motion must hold to show them."""
ELASTIC: Final = frozenset(CONTROLLED["stiffness"])
"""Numbers that reversals show, whatever the speeds between them."""


def check_slides(view: RecordView, final: FinalIdentification, shown: Collection[str], source: str) -> None:
    """Refuse records that stay below break-away: no level is seen in them, and any would do.

    An element that never breaks away is a spring over the travel. So a spring counts as one, unless the motion is such
    that it shows springs. It counts by the force it surely makes: its stiffness less two deviations.

    Args:
        view: the records.
        final: fit of all of them.
        shown: effects the motion can show.
        source: of the refusal.

    Raises:
        InputError: names the needed data.
    """
    fit = final.fit
    beside = [term for term in fit.terms if not is_level(term)]
    bare = fit_axis(view, beside, Shape(fit.shape.law, fit.shape.distances[:0], None), iterations=0)
    if not (fit.coulomb > 0.0 and is_better(hold_shape(view, fit), bare)):
        raise frictionless_error(source)
    travel, length = view.rows.extents.travel, view.rows.machine.plant.units.position
    slides = fit.shape.distances <= LARGEST * travel
    sliding, elastic = float(fit.levels[slides].sum()), 0.0
    stiffness = [final.numbers[f"stiffness_{k + 1}"] for k in np.flatnonzero(~slides).tolist()]
    for term in fit.terms:
        if term.name in LAW_AND_SAMPLING or term.name in shown or not effect_definition(term.name).elastic:
            continue
        place = fit.place(term.name).start
        stiffness.append(
            NumberEstimate(float(fit.coefficient(term.name)[0]), math.sqrt(float(final.cov[place, place])))
        )
    for number in stiffness:
        elastic += 0.5 * travel * max(0.0, number.value - SIGMAS * number.std)
    if elastic > OPEN_LEVEL * (elastic + sliding):
        refusal = FrictionError(
            source,
            "motion",
            f"{travel:.3g} {length} of travel, {100.0 * elastic / (elastic + sliding):.0f} % of the friction a spring "
            "over it",
            "motion well beyond break-away, in both directions: below it friction is a spring, and its level is open "
            f"({MOVES['speeds']}; {MOVES['loops']})",
        )
        refusal.left, refusal.unseen = final.held_out_rms, ("coulomb",)
        raise refusal


class FrictionError(InputError):
    """Refusal that describes the friction: true where nearly nothing is left that no fit explains.

    Attributes:
        left: residual of the fit behind it [N]; inf: that without dry friction is.
        unseen: numbers it says are open.
    """

    left: float = math.inf
    unseen: tuple[str, ...] = ()


def frictionless_error(source: str) -> FrictionError:
    """Return the refusal of logs whose fit ends at a Coulomb level of 0, which no machine file may state."""
    return FrictionError(
        source,
        "friction",
        None,
        "a log that shows dry friction: inertia, viscous friction and forces that do not change with direction "
        f"explain this one ({MOVES['speeds']}; {MOVES['loops']})",
    )


def list_unexcited(measured: Mapping[Measure, float]) -> tuple[str, ...]:
    """Numbers of the law (arrays without index) that a motion of these measures cannot show, whatever fits it."""
    return tuple(
        name
        for known, names in CONTROLLED.items()
        for name in names
        if any(need.times is None for need in cause(known).excitation.unmet(measured, {}))
    )


def law_numbers(final: FinalIdentification, unseen: Sequence[str]) -> tuple[Number, ...]:
    """Numbers of [friction] and of the effects, in the file's order; `unseen`: see `list_unexcited`."""
    found, count, shape = final.numbers, len(final.fit.levels), final.fit.shape
    numbers = [_number("coulomb", found["coulomb"])]
    numbers += [_number(f"stiffness_{k}", found[f"stiffness_{k}"]) for k in range(1, count + 1)]
    numbers += [_number(f"fraction_{k}", found[f"fraction_{k}"], upper=1.0) for k in range(1, count + 1)]
    stiffest = final.fit.levels / final.view.limits[0]
    held = {f"stiffness_{k + 1}": float(stiffest[k]) for k in np.flatnonzero(final.unresolved)}
    numbers = [_number(n.name, NumberEstimate(held[n.name], math.inf)) if n.name in held else n for n in numbers]
    if "viscous" in found:
        numbers.append(_number("viscous", found["viscous"]))
    else:
        numbers.append(Number("viscous", 0.0, math.nan, Rule.DEFAULT))
    if shape.rise is None:
        numbers.append(Number("stribeck_ratio", 0.0, math.nan, Rule.DEFAULT))
        # It opens the gate of the elements alone: no later than where one breaks away within a sample.
        gate = final.view.rows.machine.sampling.rate * float(shape.distances.min())
        numbers.append(Number("stribeck_velocity", min(NO_RISE.velocity, gate), math.nan, Rule.DEFAULT))
    else:
        numbers += [_number(name, found[name]) for name in ("stribeck_ratio", "stribeck_velocity")]
    numbers = [_doubt(n) if _stem(n.name) in unseen else n for n in numbers]
    numbers += effect_numbers(final)
    if find_speeds_apart(final.view.rows) is not None:
        numbers = [n if _stem(n.name) in ELASTIC else _doubt(n) for n in numbers]
    return tuple(numbers)


def _doubt(number: Number) -> Number:
    """Return a number the records do not show, whatever its deviation."""
    return replace(number, rule=Rule.STAND_IN) if number.determined else number


def _stem(name: str) -> str:
    """A number's name without its index."""
    stem, _, index = name.rpartition("_")
    return stem if index.isdecimal() else name


def effect_numbers(final: FinalIdentification) -> tuple[Number, ...]:
    """Numbers of the effects that stand beside the elements, their names before those of their parameters."""
    numbers = []
    for term in final.fit.terms:
        if term.name in LAW_AND_SAMPLING:
            continue
        definition = effect_definition(term.name)
        place = final.fit.place(term.name)
        sizes, cov = final.fit.coefficient(term.name), final.cov[place, place]
        values = effect_parameters(term, sizes)
        for key, value in values.items():
            steps = np.sqrt(np.diag(cov))
            slope = np.array(
                [
                    (effect_parameters(term, sizes + step)[key] - value) / step.max() if step.max() > 0.0 else 0.0
                    for step in np.diag(1e-3 * steps)
                ]
            )
            std = math.sqrt(max(float(slope @ cov @ slope), 0.0))
            parameter = definition.parameter(key)
            limits = (-math.pi, math.pi) if parameter.is_angle else (parameter.lower, parameter.upper)
            number = _number(f"{term.name}.{key}", NumberEstimate(float(value), std), *limits)
            if parameter.array and math.isfinite(number.std):  # an entry may be 0: all of the list are as sure
                largest = max(abs(other) for name, other in values.items() if parameter.holds(name))
                number = replace(_number(number.name, NumberEstimate(largest, std), *limits), value=number.value)
            if parameter.is_angle:  # it is no share of itself
                number = replace(number, rule=Rule.DETERMINED if std <= KNOWN else Rule.STAND_IN)
            others = final.rivals.get(term.name, ())
            if others:
                number = replace(number, rule=Rule.ALIKE, words={"others": ", ".join(others)})
            numbers.append(number)
    return tuple(numbers)


def identified_effects(fit: AxisFit) -> dict[str, dict[str, float]]:
    """Return the parameters of the effects that stand beside the elements of a fit, by their names."""
    found = {term.name: effect_parameters(term, fit.coefficient(term.name)) for term in fit.terms}
    return {name: values for name, values in found.items() if values}


def _number(name: str, quantity: NumberEstimate, lower: float = 0.0, upper: float = math.inf) -> Number:
    """Return a number of these limits; without a deviation where that says no more than they do."""
    value, std = quantity.value, math.hypot(quantity.std, quantity.spread)
    if quantity.std <= ROUNDING * abs(value):  # the share of an only element
        return Number(name, value, math.nan)
    if quantity.relative <= KNOWN:
        return Number(name, value, std)
    room = min(upper - lower, UNTOLD * abs(value - lower), UNTOLD * abs(upper - value))
    if not SIGMAS * std < room:
        return Number(name, float(f"{value:.3g}"), math.nan, Rule.STAND_IN)
    return Number(name, value, std, Rule.STAND_IN)


def mass_number(
    final: FinalIdentification, given: float | None, adopted: float, units: Units
) -> tuple[Number, tuple[Statement, ...]]:
    """The mass, or inertia, that is written, and the choice where another one was given."""
    seen = final.mass
    if seen is None:
        if given is None:  # refused before
            raise ValueError("neither a mass nor a motion that shows one")
        return Number("mass", adopted, math.nan, Rule.MASS_UNSEEN, next=f"{MOVES['jerks']} (sgms-mhe plan)"), ()
    if given is None:
        return Number("mass", adopted, math.hypot(seen.std, seen.spread), Rule.MASS_SEEN, {"push": units.push}), ()
    motion = interval(seen.value, seen.std)
    if adopted == given:
        return Number("mass", given, math.nan, Rule.MASS_HOLDS, {"motion": motion}), ()
    words: dict[str, float | str] = {"given": given, "motion": motion, "push": units.push, "ratio": adopted / given}
    move = f"where it is the {units.push}, a scale in [log]; the file has the {units.inert} that goes with it as logged"
    choice = Statement(Rule.SCALE, units.inert, adopted, unit=units.mass, numbers=words, next=move)
    return Number("mass", adopted, seen.std, Rule.MASS_MOVED, {"given": given}), (choice,)


def unknown_mass(given: float | None, assumed: float, units: Units) -> Number:
    """Return the mass, or inertia, that is written where friction alone was recorded."""
    if given is not None:
        return Number("mass", given, math.nan, Rule.MASS_GIVEN)
    move = f"its value, before a {units.push} is read with the file"
    return Number("mass", assumed, math.nan, Rule.MASS_FREE, next=move)


def list_limits(
    numbers: Sequence[Number],
    found: ChosenModel,
    final: FinalIdentification,
    view: RecordView,
    units: Units,
    unexcited: Sequence[str],
) -> Iterator[Statement]:
    """Yield the open questions of the records, with the move that would answer each.

    `unexcited`: numbers the motion cannot show (`list_unexcited`).
    """
    length, speed = units.position, units.velocity
    if not found.decided and found.other is not found.fit:
        left = {"other": found.other.cross_rms}
        yield Statement(Rule.LAW, "law", found.fit.cross_rms, None, units.force, left, _needed("stiffness"))
    unknown = {number.name for number in numbers if not number.determined}
    beside = [term.name for term in final.fit.terms if term.name not in LAW_AND_SAMPLING]
    if (speeds := find_speeds_apart(view.rows)) is not None:
        about = ", ".join(("coulomb", "viscous", "stribeck", *beside))
        both = "the same speeds both ways"
        yield Statement(Rule.ONE_WAY, about, speeds[0], None, speed, {"back": speeds[1]}, both)
    else:
        fastest, rise = view.rows.extents.speed, final.numbers.get("stribeck_velocity")
        slow = rise is not None and rise.value + SIGMAS * rise.std > fastest
        for name in ("coulomb", "viscous", "stribeck"):
            if not unknown & set(CONTROLLED[name]):
                continue
            if slow:
                yield Statement(Rule.TOO_SLOW, name, fastest, unit=speed, next=_needed("stribeck"))
            elif CONTROLLED[name][0] in unexcited:
                yield Statement(Rule.UNEXCITED, name, next=_needed(name))
            else:
                motion = {"motion": cause(name).excitation.text}
                yield Statement(Rule.COVERED, name, numbers=motion, next="more of that motion")
    for name, others in final.rivals.items():
        for other in others:
            yield Statement(Rule.UNTOLD, name, numbers={"other": other}, next="; ".join(separating_moves(name, other)))
    for name in final.beside_mass:
        if name not in final.rivals and any(number.startswith(f"{name}.") for number in unknown):
            move = f"{MOVES['jerks']} (sgms-mhe plan)"
            yield Statement(Rule.LIKE_MASS, name, numbers={"inert": units.inert}, next=move)
    if is_apart(final.fit, final.cov, view):
        late = float(final.fit.coefficient(LATE)[0])
        words = {
            "push": units.push,
            "side": "after" if late > 0.0 else "before",
            "force_N": late_force(final.fit, view),
        }
        yield Statement(Rule.TIMING, "timing", 1e3 * abs(late), None, units.force, words, "sgms-mhe diagnose")
    travel, distances = view.rows.extents.travel, final.fit.shape.distances.tolist()
    for k, distance in enumerate(distances, start=1):
        about = f"element {k}"
        if final.unresolved[k - 1]:
            yield Statement(Rule.UNRESOLVED, about, view.limits[0], unit=length)
        elif distance > LARGEST * travel:
            yield Statement(Rule.NOT_REACHED, about, distance, unit=length, numbers={"travel": travel})
        elif unknown & {f"stiffness_{k}", f"fraction_{k}"}:
            move = f"{_needed('stiffness')}, about {distance:.1g} {length} wide"
            yield Statement(Rule.NOT_ALONE, about, distance, unit=length, next=move)


def list_misfit(residual: float, floor: float, units: Units) -> Iterator[Statement]:
    """Yield the statement on a residual well above the noise: intervals hold where it has no pattern.

    Args:
        residual: on data no fit has seen [N, N m].
        floor: noise of the measured friction [N, N m].
        units: of the axis.
    """
    if residual > MISFIT * floor:
        ratio = {"ratio": residual / floor}
        yield Statement(Rule.MISFIT, "residual", residual, None, units.force, ratio, "sgms-mhe diagnose")


def _needed(name: str) -> str:
    """Return the motion that shows a cause, and how to get one."""
    return f"{cause(name).excitation.text} (sgms-mhe plan makes such a motion)"
