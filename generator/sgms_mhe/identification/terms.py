"""Forces that are linear in a number, beside those of the elements: viscous, inertial, of effects, of the sampling."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.polynomial.legendre import legvander

from sgms_mhe.identification.elements import Stribeck
from sgms_mhe.model.effects import EffectDefinition, effect_definition, effect_names
from sgms_mhe.model.effects.motion import MotionRecord, shift_to_sample
from sgms_mhe.model.effects.search import Columns, CurveColumns
from sgms_mhe.recordings.recording import Recording
from sgms_mhe.support.arrays import Array

LATE: Final = "late"
"""Name of the time [s] by which the force comes late."""
HELD: Final = "held"
"""Name of the change [s^2] of the force with its second derivative."""
PLACE: Final = "place"
"""Name of a force over the place that is no straight line: a spring is judged beside it, no file states it."""
OFFSET_OF_RECORD: Final = "record_offset"
"""Name of what the offset [N] of a record is beyond the mean over records."""
LEVEL_OF_RECORD: Final = "record_level"
"""Name of the same of the Coulomb level [N]."""
DAMPING_OF_RECORD: Final = "record_damping"
"""Name of the same of the damping [N s/m]."""
MASS_OF_RECORD: Final = "record_mass"
"""Name of the same of the moved mass [kg], where each record moves a payload."""
OF_RECORD: Final = (OFFSET_OF_RECORD, LEVEL_OF_RECORD, DAMPING_OF_RECORD, MASS_OF_RECORD)
SAMPLING: Final = (LATE, HELD)
"""Names of errors of sampling, which no machine file states."""
LAW_AND_SAMPLING: Final = ("viscous", "mass", *SAMPLING, PLACE, *OF_RECORD)
"""Names of terms that are no effects."""
BENDS: Final = (2, 3, 4, 5)
"""Orders of the polynomials over the travel that such a force has."""
TIMING: Final = 1.0
"""Samples that force and position are apart in time, one standard deviation: a drive holds its force for one."""


@dataclass(frozen=True, eq=False)
class Term:
    """Columns of force [N] per unit of their coefficients.

    Attributes:
        name: one of `LAW_AND_SAMPLING`, or an effect's.
        columns: on all rows (m, k).
        positive: whether the coefficients are at least 0; otherwise free in sign.
        deviation: of a prior about 0, in the coefficients' units; inf: none.
        given: numbers of an effect its columns are not linear in.
        noise: variance of noise in the columns [their unit squared]; the measured friction holds -`known` times it.
        known: size the measured friction has taken off already [coefficients' unit].
    """

    name: str
    columns: Array
    positive: bool = False
    deviation: float = math.inf
    given: Mapping[str, float] = field(default_factory=dict)
    noise: float = 0.0
    known: float = 0.0


def viscous_term(rows: Recording) -> Term:
    """Return the term of damping, over the speed at the instant of the force."""
    velocity = shift_to_sample(rows.velocity, rows.acceleration, rows.machine.sampling.step)
    return Term("viscous", velocity[:, None], positive=True)


def mass_term(rows: Recording) -> Term:
    """Return the term of the moved mass minus that of the machine."""
    moved = rows.machine.plant.moved
    return Term("mass", rows.acceleration[:, None], noise=rows.acceleration_noise, known=moved)


def sampling_terms(rows: Recording) -> tuple[Term, ...]:
    """Return the errors of sampling: the first and second difference of the force.

    Force and position are not of the same instant, be it by h: all of the force is then late, to first order. A drive
    that holds its force f over a sample moves the axis as their means do, exactly,

        (f[k] + f[k-1]) / 2 = f[k] - (f[k+1] - f[k-1]) / 4 + (f[k+1] - 2 f[k] + f[k-1]) / 4
    """
    step, force = rows.machine.sampling.step, rows.signals.force
    rate = -np.gradient(force) / step
    second = np.diff(np.pad(force, 1, mode="edge"), 2) / step**2
    return (
        Term(LATE, rows.reduce(rate)[:, None], deviation=TIMING * step),
        Term(HELD, rows.reduce(second)[:, None], deviation=0.5 * (TIMING * step) ** 2),
    )


def record_terms(rows: Recording, lengths: Sequence[int], sliding: Array) -> tuple[Term, ...]:
    """Return the terms of a record and not of the axis; none of one record alone.

    Each is the difference to the mean over records, that of the last one minus the sum of the others'.

    Args:
        rows: of all records (m).
        lengths: rows of each.
        sliding: derivative of the elements' force in their Coulomb level (m).
    """
    if len(lengths) < 2:
        return ()
    each = np.repeat(np.eye(len(lengths)), lengths, axis=0)
    apart = each[:, :-1] - each[:, -1:]
    slopes = [np.ones((len(apart), 1)), sliding[:, None], viscous_term(rows).columns]
    if rows.has_payload:
        slopes.append(mass_term(rows).columns)
    return tuple(Term(name, slope * apart) for name, slope in zip(OF_RECORD, slopes, strict=False))


def record_sizes(coefficients: Array) -> Array:
    """Return each record's (k) difference from the mean, by the coefficients (k - 1) of its term; none of no term."""
    if not len(coefficients):
        return coefficients
    return np.append(coefficients, -float(np.sum(coefficients)))


def place_curve(rows: Recording) -> Term:
    """Return the term of a force over the place that is no straight line, in Legendre polynomials over the travel."""
    place = rows.position[rows.used]
    low, high = float(place.min()), float(place.max())
    scaled = (2.0 * rows.position - low - high) / max(high - low, np.finfo(float).tiny)
    curves: Array = np.asarray(legvander(np.clip(scaled, -1.0, 1.0), max(BENDS)), dtype=np.float64)
    return Term(PLACE, curves[:, BENDS])


@dataclass(frozen=True, eq=False)
class KnownFriction:
    """Friction of a fit, and its load.

    Attributes:
        friction: all of it (m) [N].
        elements: the share of the elements (m) [N].
        inertia: kg, kg m^2.
    """

    friction: Array
    elements: Array
    inertia: float


def companion_names(rows: Recording) -> tuple[str, ...]:
    """Return the names of all effects looked for beside friction, those of its level too."""
    return tuple(definition.name for definition, _ in _companions(rows))


def companion_terms(rows: Recording) -> tuple[Term, ...]:
    """Effects looked for beside friction from the first, as they say themselves; free in sign."""
    motion = _motion(rows, rows.force, rows.velocity)
    return tuple(
        Term(definition.name, search.columns(motion, {}))
        for definition, search in _companions(rows)
        if definition.stage != "level"
    )


def level_terms(
    rows: Recording, transmitted: Array, sliding: Array, rise: Stribeck | None, known: KnownFriction | None = None
) -> tuple[Term, ...]:
    """Effects looked for in the level of friction: their load is known once gravity and mass are.

    One that is linear in its size changes the force the elements have, which a fit of them tells.

    Args:
        rows: of the records.
        transmitted: torque the drive transmits (m) [N m].
        sliding: force of the elements over the level they slip at now, -1 to 1 (m).
        rise: of the level towards low speed, in which they share; None: none.
        known: of a fit, for effects that are linear, and for trials of an effect's nonlinear parameters;
            None: of the others the first trial alone.
    """
    motion, terms = _motion(rows, transmitted, sliding), []
    if known is not None:
        own = replace(motion, velocity=rows.velocity, level=known.elements)
        force = transmitted + known.friction
        motion = replace(motion, force=force, level=known.friction, mass=known.inertia)
    for definition, search in _companions(rows):
        if definition.stage != "level":
            continue
        if definition.linear:
            terms += [Term(definition.name, search.columns(own, {}))] if known is not None else []
            continue
        for given in search.variants(motion) if known is not None else ({},):
            columns = np.abs(sliding)[:, None] * search.columns(motion, given)
            if rise is not None and search.rise:
                share = np.exp(-((rows.velocity / rise.velocity) ** 2))
                columns = np.column_stack((columns, share * columns[:, 0]))
            terms.append(Term(definition.name, columns, positive=True, given=given))
    return tuple(terms)


def curve_terms(rows: Recording) -> tuple[Term, ...]:
    """Curves over speed of any shape, of few numbers first; free in sign."""
    motion = _motion(rows, rows.force, shift_to_sample(rows.velocity, rows.acceleration, rows.machine.sampling.step))
    definitions = (effect_definition(name) for name in effect_names(rows.machine.plant.kind))
    return tuple(
        Term(definition.name, definition.search.columns(motion, given), given=given)
        for definition in definitions
        if isinstance(definition.search, CurveColumns)
        for given in definition.search.grid(motion)
    )


def effect_parameters(term: Term, sizes: Array) -> dict[str, float]:
    """Return an effect's parameters from the coefficients of its term (k); none of a term that is no effect."""
    if term.name in LAW_AND_SAMPLING:
        return {}
    definition = effect_definition(term.name)
    search = definition.search
    if not isinstance(search, Columns):
        return {}
    if definition.stage != "level" or not search.rise:
        return dict(search.parameters(term.given, sizes))
    rise = {search.rise: float(sizes[1])} if len(sizes) > 1 else {}
    return {**search.parameters(term.given, sizes[:1]), **rise}


def is_within_limits(term: Term, sizes: Array) -> bool:
    """Return True if a machine file may state an effect's coefficients (k)."""
    found = effect_parameters(term, sizes)
    limits = {name: effect_definition(term.name).parameter(name) for name in found}
    return all(limits[name].lower <= value <= limits[name].upper for name, value in found.items())


def is_level(term: Term) -> bool:
    """Return True if a term is of an effect of the level."""
    return term.name not in LAW_AND_SAMPLING and effect_definition(term.name).stage == "level"


def is_friction(term: Term) -> bool:
    """Return True if a term is friction that teeth transmit: damping, a curve over speed, additions to the level."""
    if term.name in LAW_AND_SAMPLING:
        return term.name == "viscous"
    return is_level(term) or effect_definition(term.name).any_curve


def transmitted_force(rows: Recording, terms: Sequence[Term], coefficients: Array) -> Array:
    """Torque behind friction (m) [N m], of fitted terms: inertia times acceleration, and the loads.

    Args:
        rows: of the records.
        terms: fitted.
        coefficients: of all their columns (c).
    """
    total = rows.machine.plant.moved * rows.acceleration
    for term, sizes in _by_term(terms, coefficients):
        if term.name == "mass" or (term.name not in LAW_AND_SAMPLING and effect_definition(term.name).loads):
            total = total + term.columns @ sizes
    return total


def _by_term(terms: Sequence[Term], coefficients: Array) -> Iterator[tuple[Term, Array]]:
    """Terms, each with the coefficients of its columns out of those of all (c)."""
    first = 0
    for term in terms:
        width = term.columns.shape[1]
        yield term, coefficients[first : first + width]
        first += width


def _companions(rows: Recording) -> Iterator[tuple[EffectDefinition, Columns]]:
    for name in effect_names(rows.machine.plant.kind):
        definition = effect_definition(name)
        if definition.companion and isinstance(definition.search, Columns):
            yield definition, definition.search


def _motion(rows: Recording, force: Array, velocity: Array) -> MotionRecord:
    """Motion of the rows with nothing of a model's friction in `force` (m) [N]."""
    nothing = np.zeros(len(rows.time))
    return MotionRecord(
        time=rows.time,
        position=rows.position,
        velocity=velocity,
        acceleration=rows.acceleration,
        force=force,
        friction=nothing,
        level=nothing,
        damping=0.0,
        mass=rows.machine.plant.moved,
        deflection=0.0,
        extents=rows.extents,
    )
