"""From the elements chosen to the numbers that are reported: only numbers the records show stay in."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from sgms_mhe.identification.companions import (
    add_companions,
    bend,
    best_trials,
    carry_load,
    fit_level_terms,
    is_possible,
    renew_columns,
    spread_level_terms,
)
from sgms_mhe.identification.elements import Law
from sgms_mhe.identification.fits import (
    AxisFit,
    NumberEstimate,
    RecordView,
    Shape,
    coordinates,
    covariance,
    encoder_forces,
    fit_axis,
    hold_shape,
    largest_noise_bias,
    measure_wrong,
    noise_share,
    quantities,
)
from sgms_mhe.identification.plain import measure_unseen
from sgms_mhe.identification.record_numbers import add_spread, fit_record_terms
from sgms_mhe.identification.search import (
    CHOICE_ITERATIONS,
    ChosenModel,
    Progress,
    Views,
    align,
    fit_aligned,
    is_better,
    join_nearest,
    search_rise_speed,
)
from sgms_mhe.identification.spectrum import LARGEST
from sgms_mhe.identification.terms import (
    LATE,
    LAW_AND_SAMPLING,
    LEVEL_OF_RECORD,
    SAMPLING,
    Term,
    is_level,
    is_within_limits,
)
from sgms_mhe.model.effects import effect_definition
from sgms_mhe.recordings.evidence import largest_force
from sgms_mhe.support.arrays import Array, Mask
from sgms_mhe.support.decisions import log_decision
from sgms_mhe.support.numbers import SIGMAS

CERTAIN: Final = 3.0
"""Standard deviations by which a number is another one than was given."""
MASS_OFF: Final = 0.02
"""Of the mass that was given: less is what an actuator's lag makes of it."""
FAST: Final = 0.5
"""Speed over its RMS from which on a row is away from reversals."""
MOST: Final = 0.5
"""Share of a delay that such rows alone must show."""
MASS_SEEN: Final = 0.2
"""Deviation over value up to which a mass is known."""
MASS_NOISE: Final = 0.25
"""Share of noise, in what an acceleration has alone, up to which it shows a mass: beyond, its number is the noise's."""
MASS_SURE: Final = 1.5e-4
"""Deviation of any mass over its value: how a drive makes its force between two samples is known to second order."""
TRACE: Final = 0.02
"""Share of the level below which an element is a trace of something else, where it is not sure either."""
UNSURE: Final = 0.25
"""Deviation of such a level over its value."""
FINAL_ITERATIONS: Final = 8
RENEWALS: Final = 6
SETTLED: Final = 1e-4
"""Fits by which what a level grows with follows from friction that it makes itself, and the change that ends them."""


@dataclass(frozen=True, eq=False)
class FinalIdentification:
    """Reported fit.

    Attributes:
        fit: at the full rate, of all used rows, with the numbers the records show alone.
        cov: covariance of its numbers (p, p).
        numbers: of the law, with deviations; those of numbers fixed at a default are not among them.
        mass: that the motion shows [kg]; None: it shows none.
        held_out_rms: residual of a fit of two thirds on the last third of the blocks [N].
        stated_rms: the same without errors of timing, as the file has none [N].
        view: the records as they were fitted.
        rivals: effects that explain the records as well as one that was chosen, or that its motion does not tell from
            it, by its name.
        beside_mass: effects whose deviations are those beside a free mass: the one given is all that speaks for them.
    """

    fit: AxisFit
    cov: Array
    numbers: dict[str, NumberEstimate]
    mass: NumberEstimate | None
    held_out_rms: float
    stated_rms: float
    view: RecordView
    rivals: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    beside_mass: tuple[str, ...] = ()

    @property
    def unresolved(self) -> Mask:
        """Elements (k) that break away before the records tell that they do."""
        return np.asarray(self.fit.shape.distances < self.view.limits[0])


@dataclass(frozen=True)
class Known:
    """Numbers of a user, which stay unless the motion contradicts them: the mass, the number of elements."""

    mass: bool
    count: bool


def make_final_fit(
    views: Views,
    found: ChosenModel,
    base: Sequence[Term],
    companions: Sequence[Term],
    curves: Sequence[Term],
    excited: Collection[str],
    wanted: Known,
    report: Progress,
) -> FinalIdentification:
    """Choose the terms beside the elements and fit all of it at the full rate.

    Args:
        views: the records.
        found: chosen elements, with every term.
        base: viscous, inertial and sampling terms.
        companions: effects that may stand beside the elements, but for those of their level.
        curves: curves over speed of any shape, few numbers first.
        excited: names of the effects the motion excites, those of the level too.
        wanted: by the caller.
        report: called with each step.
    """
    report("what stands beside the elements")
    fit, rivals = add_companions(views, found.quickest, base, companions, excited)
    views = Views(carry_load(views.coarse, fit), carry_load(views.fine, fit))
    fit = _test_level_rise(views, fit if fit.shape.rise is None else _search_rise(views, fit))
    fit = _test_curves(views, fit, [term for term in curves if term.name in excited])
    report("numbers at the full rate")
    views, fit = _fit_finely(views, fit, found.fit.shape.law)
    if not wanted.count:
        count = len(fit.levels)
        fit = drop_traces(views, fit)
        if len(fit.levels) < count:
            fit = drop_idle_springs(views, fit)
    fit = drop_empty(views.fine, fit)
    if not (wanted.count or found.decided):  # how many there are was asked under either law alone
        fit = join_alike(views.fine, fit)
    return state_numbers(views.fine, fit, rivals, wanted, law_decided=found.decided)


def state_numbers(
    view: RecordView,
    fit: AxisFit,
    rivals: Mapping[str, tuple[str, ...]],
    wanted: Known,
    *,
    law_decided: bool = True,
    is_plain: bool = False,
) -> FinalIdentification:
    """Return a fit without the terms its records do not show, and its numbers.

    Args:
        view: the records at the full rate.
        fit: of them.
        rivals: of its effects, by their names.
        wanted: by the caller.
        law_decided: whether the records tell the law of the elements.
        is_plain: whether nothing was chosen in the fit: then it is left as it is, but for a mass that was given.
    """
    cov = covariance(view, fit)
    if is_apart(fit, cov, view) is None:
        log_decision(
            "numbers",
            "an error of timing that is none stands for friction that no file has: it is left out",
            late_s=float(fit.coefficient(LATE)[0]),
            residual_N=fit.rms,
        )
        fit = _fit_without(view, fit, SAMPLING)
        cov = covariance(view, fit)
    wide = quantities(fit, cov)
    meshes = _mesh_covariance(view, fit)
    mass = _mass(view, fit, wide["mass"], meshes)
    dropped = _find_unseen(fit, cov)
    if wanted.mass and (mass is None or not contradicts_mass(view.rows.machine.plant.moved, mass)):
        dropped.add("mass")  # the one that was given is written, whatever the fit would have
    dropped = dropped & {"mass"} if is_plain else dropped
    log_decision(
        "numbers",
        "numbers that the records do not show, and a mass that agrees with the one given, are not free",
        numbers={name: (number.value, number.std) for name, number in wide.items()},
        dropped=sorted(dropped),
    )
    beside: tuple[str, ...] = ()
    if dropped:
        free, cov_free = fit, cov
        fit = _fit_without(view, fit, dropped, 0 if is_plain else FINAL_ITERATIONS)
        cov, meshes = covariance(view, fit), _mesh_covariance(view, fit)
        if mass is None and wanted.mass and view.rows.inertia > 0.0:
            cov, beside = _widen_beside_mass(free, cov_free, fit, cov)
    cov = cov + (meshes if law_decided else meshes + _law_covariance(view, fit))
    if noise_share(view, fit) > MASS_NOISE:
        mass = None
    numbers = add_spread(view, fit, quantities(fit, cov))
    if mass is not None and "mass" in numbers:
        mass = replace(mass, std=max(mass.std, numbers["mass"].std), spread=numbers["mass"].spread)
    if "viscous" in dropped:  # fixed at 0 it would make the level look surer than it is
        numbers["coulomb"] = replace(numbers["coulomb"], std=wide["coulomb"].std)
    left, stated = measure_unseen(view, fit)
    rivals = {name: others for name, others in rivals.items() if fit.place(name).stop}
    return FinalIdentification(fit, cov, numbers, mass, left, stated, view, rivals, beside)


def _mesh_covariance(view: RecordView, fit: AxisFit) -> Array:
    """Return the squared effect of a level that grows at all places at once, as of a gear of several meshes."""
    meshes = fit
    for _ in range(RENEWALS if any(map(is_level, fit.terms)) else 0):
        meshes = fit_axis(view, spread_level_terms(view.rows, meshes, fit.terms), fit.shape, iterations=0)
    return _square_change(view, fit, meshes)


def _law_covariance(view: RecordView, fit: AxisFit) -> Array:
    """Return the squared shift of the numbers by the other law, where the records do not distinguish the laws."""
    law: Law = "sgms" if fit.shape.law == "switching" else "switching"
    other = fit_axis(view, fit.terms, replace(fit.shape, law=law), iterations=FINAL_ITERATIONS)
    return _square_change(view, fit, other)


def _square_change(view: RecordView, fit: AxisFit, rival: AxisFit) -> Array:
    """Return the squared shift of the numbers (p, p) by a rival form of the friction; 0: it is worse unseen.

    The residual beyond noise of a clearly better form may move numbers as far as its explained part: per
    force alike.
    """
    change = np.zeros_like(own := coordinates(fit, fit.terms))
    if not is_better(fit, rival):
        change = coordinates(rival, fit.terms) - own
        if is_better(rival, fit):
            change *= max(1.0, measure_wrong(view, fit) / rival.gain_over(fit))
    return np.outer(change, change)


def _fit_finely(views: Views, fit: AxisFit, law: Law) -> tuple[Views, AxisFit]:
    """The fit at the full rate under a law, the load of the level taken from it until that does not change.

    And the views it is of: elements carry the level added by a load.
    """
    fit = fit_axis(views.fine, fit.terms, replace(fit.shape, law=law), iterations=FINAL_ITERATIONS)
    renewed = any(is_level(term) or term.name == LEVEL_OF_RECORD for term in fit.terms)
    for _ in range(RENEWALS if renewed else 0):
        before = fit.rms
        views = replace(views, fine=carry_load(views.fine, fit))
        fit = fit_axis(views.fine, _renew_levels(views, fit), fit.shape, iterations=FINAL_ITERATIONS)
        if abs(fit.rms - before) <= SETTLED * before:
            break
    return views, fit


def _renew_levels(views: Views, fit: AxisFit) -> tuple[Term, ...]:
    """The terms of a fit, those of the level along the transmitted torque, or along its elements."""
    return renew_columns(fit.terms, (*fit_level_terms(views.fine.rows, fit), *fit_record_terms(views, fit)))


def drop_traces(views: Views, fit: AxisFit) -> AxisFit:
    """The fit without elements of next to no level it is not sure of, and without springs that may be none.

    An element beyond the travel is a spring to the record: its level is open, and would make the Coulomb level so.
    """
    travel = views.fine.rows.extents.travel
    while len(fit.levels) > 1:
        count = len(fit.levels)
        cov = covariance(views.fine, fit)
        deviation = np.sqrt(np.diag(cov)[count : 2 * count])
        found = [quantities(fit, cov)[f"stiffness_{k + 1}"] for k in range(count)]
        none = np.array([number.value <= SIGMAS * number.std for number in found])
        unsure = (fit.levels < TRACE * fit.coulomb) & (deviation >= UNSURE * fit.levels)
        unsure |= (fit.shape.distances > LARGEST * travel) & none
        if not unsure.any():
            break
        if unsure.all():  # where no friction shows, that is for a refusal to say
            unsure[np.argmax(fit.levels)] = False
        fit = _keep_elements(views.fine, fit, ~unsure)
    return fit


def drop_empty(view: RecordView, fit: AxisFit) -> AxisFit:
    """The fit without elements of no level, however many were asked for: a machine file cannot state one."""
    while not fit.levels.all() and fit.levels.any():
        fit = _keep_elements(view, fit, fit.levels > 0.0)
    return fit


def _keep_elements(view: RecordView, fit: AxisFit, kept: Mask) -> AxisFit:
    """Return the fit with some of its elements (k) alone."""
    shape = replace(fit.shape, distances=fit.shape.distances[kept])
    return fit_axis(view, fit.terms, shape, iterations=FINAL_ITERATIONS)


def join_alike(view: RecordView, fit: AxisFit) -> AxisFit:
    """The fit with as few elements as leave no more on unseen rows, unless all of them are known."""
    while len(fit.levels) > 1:
        numbers, count = quantities(fit, covariance(view, fit)), len(fit.levels)
        own = [numbers[f"{name}_{k}"].relative for name in ("stiffness", "fraction") for k in range(1, count + 1)]
        if max(own) <= UNSURE:
            break
        shape = replace(fit.shape, distances=join_nearest(fit, count - 1))
        fewer = fit_axis(view, fit.terms, shape, iterations=FINAL_ITERATIONS)
        if is_better(hold_shape(view, fit), hold_shape(view, fewer)):
            break
        fit = drop_empty(view, fewer)
    return fit


def drop_idle_springs(views: Views, fit: AxisFit) -> AxisFit:
    """The fit without springs that leave no less on unseen rows: some stood against an element that has gone since.

    One that pushes away makes up for an element beyond the travel, which is one that pulls back.
    """
    for term in fit.terms:
        if term.name in LAW_AND_SAMPLING or not effect_definition(term.name).elastic:
            continue
        terms = tuple(other for other in fit.terms if other is not term)
        without = fit_axis(views.fine, terms, fit.shape, iterations=FINAL_ITERATIONS)
        if bend(views.fine, fit) > 1.0 or not is_better(fit, without):
            fit = without
    return fit


def _search_rise(views: Views, fit: AxisFit) -> AxisFit:
    """The fit at the best speed of its rise, or without one where that leaves no more: neither of elements nor load."""
    fit = search_rise_speed(views, fit)
    level = fit_aligned(views, _drop_load_rise(fit.terms), Shape(fit.shape.law, fit.shape.distances, None))
    return fit if is_better(fit, level) else level


def _drop_load_rise(terms: Sequence[Term]) -> tuple[Term, ...]:
    """The terms, those of the level without their growth towards low speed."""
    return tuple(replace(t, columns=t.columns[:, :1]) if is_level(t) else t for t in terms)


def _test_level_rise(views: Views, fit: AxisFit) -> AxisFit:
    """The fit with the best trial of the load its level grows with, and without a rise that explains none."""
    if not any(map(is_level, fit.terms)):
        return fit
    fit = _search_trials(views, fit)
    terms = _renew_levels(views, fit)
    plain = _drop_load_rise(terms)
    if all(a.columns.shape == b.columns.shape for a, b in zip(plain, terms, strict=True)):
        return fit_aligned(views, terms, fit.shape, rounds=1)
    with_rise, without = (fit_aligned(views, some, fit.shape, rounds=1) for some in (terms, plain))
    return with_rise if is_better(with_rise, without) else without


def _test_curves(views: Views, fit: AxisFit, curves: Sequence[Term]) -> AxisFit:
    """The fit with the curve over speed of the fewest numbers than which none leaves less, where one leaves less.

    The elements' own rise is judged anew beside a curve: it hides behind one, or stood for it. Where no more is left
    than the encoder's steps make, the part explained by a curve is theirs.
    """
    if not curves or _leaves_steps_alone(views.fine, fit):
        return fit
    lined, machine = align(views, fit), views.fine.rows.machine
    without = look = fit_axis(lined, fit.terms, fit.shape, iterations=0)
    for curve in curves:
        tried = fit_axis(lined, (*fit.terms, curve), fit.shape, iterations=0)
        gains = is_better(tried, look) and is_possible(machine, tried)
        log_decision(
            "companions",
            "curve over speed of any shape that leaves clearly less on unseen rows",
            columns=curve.columns.shape[1],
            residual_N=look.cross_rms,
            residual_with_N=tried.cross_rms,
            gains=gains,
        )
        if gains:
            look = tried
    if look is without:
        return fit
    best = _search_rise(views, fit_aligned(views, look.terms, fit.shape))
    level = quantities(best, covariance(views.fine, best))["coulomb"]  # if it is known, the curve does not stand for it
    gains = is_better(best, fit) and is_possible(machine, best) and level.relative < UNSURE
    return best if gains else fit


def _leaves_steps_alone(view: RecordView, fit: AxisFit) -> bool:
    """Return True if a fit leaves no more than the force that the encoder's steps make."""
    along = fit_axis(view, fit.terms, fit.shape, iterations=0)
    steps = largest_force(view.rows, encoder_forces(view, along))
    return steps is not None and along.cross_rms <= view.rows.rms(steps)


def _search_trials(views: Views, fit: AxisFit) -> AxisFit:
    """The fit at the best trials, tried anew until they stay: friction and load that they hang on are the fit's own."""
    lined = align(views, fit)
    for _ in range(RENEWALS):
        beside = tuple(term for term in fit.terms if not is_level(term))
        names = {term.name for term in fit.terms if is_level(term)}
        trials = [term for term in fit_level_terms(views.fine.rows, fit) if term.name in names]
        bare = replace(fit, terms=beside)
        terms = (*beside, *best_trials(lined, bare, trials))
        before, given = fit.cross_rms, [term.given for term in fit.terms if is_level(term)]
        fit = fit_axis(lined, terms, fit.shape, iterations=CHOICE_ITERATIONS)
        same = given == [term.given for term in terms if is_level(term)]
        if same and abs(fit.cross_rms - before) <= SETTLED * before:
            break
    return fit


def _mass(view: RecordView, fit: AxisFit, extra: NumberEstimate, rival: Array) -> NumberEstimate | None:
    """The mass, as sure as a fit and its rival, by its covariance, have it; None where the fit does not show it."""
    total = view.rows.machine.plant.moved + extra.value
    if total <= 0.0 or extra.std > MASS_SEEN * total:
        return None
    place = fit.place("mass").start
    return NumberEstimate(total, math.hypot(extra.std, MASS_SURE * total, math.sqrt(rival[place, place])))


def _fit_without(view: RecordView, fit: AxisFit, names: Collection[str], iterations: int = FINAL_ITERATIONS) -> AxisFit:
    """Return the fit without some of its terms."""
    terms = tuple(term for term in fit.terms if term.name not in names)
    return drop_empty(view, fit_axis(view, terms, fit.shape, iterations=iterations))


def _widen_beside_mass(free: AxisFit, cov_free: Array, fit: AxisFit, cov: Array) -> tuple[Array, tuple[str, ...]]:
    """Return the covariance with effects as sure as beside a free mass, and the names of those that are less sure so.

    The motion may show their sum alone: at one frequency a spring is the error of the mass.
    """
    wide, names = cov.copy(), []
    for name in (term.name for term in fit.terms if term.name not in LAW_AND_SAMPLING):
        place, own = fit.place(name), free.place(name)
        if cov_free[own, own].trace() > cov[place, place].trace():
            wide[place, place] = cov_free[own, own]
            names.append(name)
    return wide, tuple(names)


def is_apart(fit: AxisFit, cov: Array, view: RecordView) -> bool | None:
    """Return True if force and position are apart in time, beyond the effect of sampling; None: ambiguous.

    It is true of all of the force, so most of it is there away from reversals too: friction that follows the speed
    gradually looks the same about one. An answer of a controller to the steps of an encoder is no delay,
    nor is less than a sample: a drive that holds its force over one has it half a sample late, or early, as
    it is logged.
    """
    rows, place = view.rows, fit.place(LATE)
    if place.start == place.stop:
        return False
    late, std = float(fit.coefficient(LATE)[0]), math.sqrt(float(cov[place.start, place.start]))
    told = rows.machine.sampling.step + largest_noise_bias(view, fit, LATE)
    if abs(late) <= told or late_force(fit, view) <= fit.rms:
        return False
    if abs(late) <= CERTAIN * std + told:
        return None
    fast = rows.used & (np.abs(rows.velocity) >= FAST * np.sqrt(np.mean(rows.velocity[rows.used] ** 2)))
    away = fit_axis(view, fit.terms, fit.shape, fast, iterations=0)
    return True if float(away.coefficient(LATE)[0]) / late >= MOST else None


def late_force(fit: AxisFit, view: RecordView) -> float:
    """Return the RMS [N] of the error in a fit by a shift in time between force and position."""
    place, used = fit.place(LATE), view.rows.used
    return float(np.std(fit.jacobian[used, place.start]) * np.abs(fit.coefficient(LATE)[0]))


def _find_unseen(fit: AxisFit, cov: Array) -> set[str]:
    """Damping, and effects, whose numbers the records do not show."""
    unseen = set()
    for term in fit.terms:
        sizes, place = fit.coefficient(term.name), fit.place(term.name)
        unsure = np.all(np.abs(sizes) <= SIGMAS * np.sqrt(np.diag(cov[place, place])))
        if unsure or not is_within_limits(term, sizes):
            unseen.add(term.name)
    return unseen - (set(LAW_AND_SAMPLING) - {"viscous"})


def contradicts_mass(given: float, shown: NumberEstimate) -> bool:
    """Return True if a motion shows another mass than was given [kg]: by more than chance, or an actuator's lag."""
    return abs(shown.value - given) > max(CERTAIN * shown.std, MASS_OFF * given)
