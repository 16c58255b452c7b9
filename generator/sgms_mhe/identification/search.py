"""Choice of law, number of elements and effects by the gain on held-out samples.

Choices are made at the rate of the rows. The error of the longer steps there is taken out by lining the measured
friction up with the fine model at a fit: the residual is then the fine one's, but for the change away from that fit.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from sgms_mhe.identification.elements import NO_RISE, Law, Stribeck, run_elements
from sgms_mhe.identification.fits import AxisFit, RecordView, Shape, fit_axis
from sgms_mhe.identification.records import Records, filter_motion
from sgms_mhe.identification.spectrum import Spectrum, cluster, distance_grid, find_spectrum
from sgms_mhe.identification.terms import Term, companion_terms, mass_term, sampling_terms, viscous_term
from sgms_mhe.recordings.evidence import EQUAL_T, difference_statistic
from sgms_mhe.recordings.recording import Recording
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.decisions import log_decision

Progress = Callable[[str], None]

LAWS: Final[tuple[Law, ...]] = ("switching", "sgms")
MOST_ELEMENTS: Final = 10
FIRST_COUNT: Final = 5
"""Elements at which laws are compared: enough to bend as any virgin curve does."""
MATERIAL: Final = 0.01
"""Share of the residual's RMS by which a richer model must leave less on rows that it has not seen."""
LIKELY: Final = 1.05
"""Residual of the other law over the chosen one's up to which its own number of elements is looked for."""
CHOICE_ITERATIONS: Final = 12
LOOK_ITERATIONS: Final = 3
FOLLOWED: Final = 2
"""Starts that are followed to their minimum, of those that a few iterations have been spent on."""
NEXT: Final = 0.3
"""Break-away distance of an element below all others, over the smallest of theirs."""
RISE: Final = 0.1
"""Stribeck ratio that a fit starts from where the spectrum shows none."""
SMALL_RISE: Final = 0.02
RISE_SPEEDS: Final = (1e-3, 4e-3, 1.6e-2, 6.4e-2)
"""Stribeck ratio, and speeds over the fastest, that it starts from once more when the elements are found."""
LEAST_SHARE: Final = 1e-3
"""Of all levels: what an element starts from that the fit has no use for."""


@dataclass(frozen=True, eq=False)
class Views:
    """The records at the rate of the rows, and at the logs' own."""

    coarse: RecordView
    fine: RecordView


@dataclass(frozen=True, eq=False)
class ChosenModel:
    """Chosen model.

    Attributes:
        fit: at the records' full rate, of all used rows.
        other: the best fit under the other law.
        decided: whether the records tell the laws apart.
        counts: cross-validated RMS [N] by number of elements tried, under the chosen law.
    """

    fit: AxisFit
    other: AxisFit
    decided: bool
    counts: dict[int, float]

    @property
    def quickest(self) -> AxisFit:
        """Fit that further choices are made beside: of laws the records do not tell apart, elements that switch.

        A run of these takes a step a sample, of smooth ones up to a hundred.
        """
        return self.fit if self.decided or self.fit.shape.law == "switching" else self.other


def fit_aligned(views: Views, terms: Sequence[Term], start: Shape, rounds: int = 2) -> AxisFit:
    """Fit at the rate of the rows, in line with the fine model; the fit that is returned is the fine model's."""
    shape = start
    anchor = fit_axis(views.fine, terms, shape, iterations=0)
    for _ in range(rounds):
        lined = align(views, anchor)
        shape = fit_axis(lined, terms, anchor.shape, iterations=CHOICE_ITERATIONS).shape
        there = fit_axis(views.fine, terms, shape, iterations=0)
        if there.rms >= anchor.rms:
            break
        anchor = there
    return anchor


def align(views: Views, anchor: AxisFit) -> RecordView:
    """The coarse view whose friction leaves the residual of the fine one at a fit."""
    rows, shape = views.coarse.rows, anchor.shape
    rise = shape.rise or NO_RISE
    coarse = run_elements(views.coarse.motions, shape.law, shape.distances, rise, jacobian=False)
    change = anchor.elements @ anchor.levels - coarse.chi @ anchor.levels
    return replace(views.coarse, rows=replace(rows, friction=rows.friction - change))


def search(
    views: Views, terms: Sequence[Term], spectrum: Spectrum, elements: int | None, report: Progress
) -> ChosenModel:
    """The law and the elements the records show.

    Args:
        views: the records.
        terms: all that may stand beside elements.
        spectrum: the convex start.
        elements: how many; None: as many as held-out rows gain by.
        report: called with each step.
    """
    rise = spectrum.rise or Stribeck(RISE, NO_RISE.velocity)
    count = min(elements or FIRST_COUNT, MOST_ELEMENTS)
    first = {}
    for law in LAWS:
        report(f"{law}: {count} elements")
        first[law] = fit_aligned(views, terms, Shape(law, split_distances(spectrum, count), rise))
    law, other = sorted(LAWS, key=lambda law: first[law].cross_rms)
    fits: dict[Law, dict[int, AxisFit]] = {law: {len(fit.levels): fit} for law, fit in first.items()}
    chosen = _search_count(views, terms, spectrum, fits[law], elements, report)
    # With too few elements the wrong law may bend better: asked again where there are enough.
    report(f"{other}: {len(chosen.levels)} elements")
    again = fit_aligned(views, terms, Shape(other, chosen.shape.distances, chosen.shape.rise))
    fits[other][len(again.levels)] = min(again, fits[other].get(len(again.levels), again), key=lambda fit: fit.rms)
    rival = min(fits[other].values(), key=lambda fit: fit.cross_rms)
    if rival.cross_rms < LIKELY * chosen.cross_rms:
        rival = _search_count(views, terms, spectrum, fits[other], elements, report)
        if rival.cross_rms < chosen.cross_rms:
            law, other, chosen, rival = other, law, rival, chosen
    decided = is_better(chosen, rival)
    if not decided and law == "switching":
        law, other, chosen, rival = other, law, rival, chosen
    if not decided and len(rival.levels) > len(chosen.levels):  # of two laws alike the fewer elements are enough
        rival = fit_aligned(views, terms, Shape(other, chosen.shape.distances, chosen.shape.rise))
    counts = {k: fits[law][k].cross_rms for k in sorted(fits[law])}
    log_decision(
        "elements",
        "law that leaves clearly less on unseen rows, else sgms; the fewest elements than which no more gain",
        law=law,
        residual_N=chosen.cross_rms,
        residual_other_N=rival.cross_rms,
        decided=decided,
        residual_by_count_N=counts,
        residual_by_count_other_N={k: fits[other][k].cross_rms for k in sorted(fits[other])},
        chosen=len(chosen.levels),
        break_away_m=chosen.shape.distances.tolist(),
        levels_N=chosen.levels.tolist(),
    )
    return ChosenModel(chosen, rival, decided, counts)


def _search_count(
    views: Views,
    terms: Sequence[Term],
    spectrum: Spectrum,
    fits: dict[int, AxisFit],
    elements: int | None,
    report: Progress,
) -> AxisFit:
    """The fit with as many elements as the records show under the law of the fits so far, which grow.

    More while they gain, then fewer until one more gains.
    """
    if elements is not None:
        return fits[elements]
    first = max(fits)
    law = fits[first].shape.law
    for count in range(first + 1, MOST_ELEMENTS + 1):
        report(f"{law}: {count} elements")
        fits[count] = _best(views, terms, spectrum, fits[count - 1], count)
        if not is_better(fits[count], fits[count - 1]):
            break
    for count in range(first - 1, 0, -1):
        if count not in fits:
            report(f"{law}: {count} elements")
            fits[count] = _best(views, terms, spectrum, fits[count + 1], count)
        if any(is_better(fits[more], fits[count]) for more in fits if more > count):
            break
    return fits[choose_count(fits)]


def is_better(richer: AxisFit, simpler: AxisFit) -> bool:
    """Return True if one fit is better than another on unseen samples, by an amount that matters and beyond chance."""
    if richer.cross_rms >= (1.0 - MATERIAL) * simpler.cross_rms:
        return False
    return difference_statistic(richer.cross, simpler.cross) > EQUAL_T


def choose_count(fits: dict[int, AxisFit]) -> int:
    """The fewest elements than which no larger number gains."""
    for count in sorted(fits):
        if not any(is_better(fits[more], fits[count]) for more in fits if more > count):
            return count
    return max(fits)


def _best(views: Views, terms: Sequence[Term], spectrum: Spectrum, near: AxisFit, count: int) -> AxisFit:
    """The best of several fits: from the clusters of the spectrum, and from a fit with one element more or less."""
    starts = [split_distances(spectrum, count), *_change_count(near, count)]
    lined = align(views, near)
    looks = [
        fit_axis(lined, terms, Shape(near.shape.law, start, near.shape.rise), iterations=LOOK_ITERATIONS)
        for start in starts
    ]
    promising = sorted(looks, key=lambda fit: fit.rms)[:FOLLOWED]
    tried = [fit_axis(lined, terms, fit.shape, iterations=CHOICE_ITERATIONS) for fit in promising]
    return fit_aligned(views, terms, min(tried, key=lambda fit: fit.rms).shape)


def search_rise_speed(views: Views, fit: AxisFit) -> AxisFit:
    """The better of a fit and the one from another speed of its rise.

    A fit that begins far from it ends in another minimum, so it is looked for from slow to fast. Elements that go over
    smoothly turn round at that speed, of whatever size the rise is.
    """
    lined, fastest = align(views, fit), views.fine.rows.extents.speed
    starts = [replace(fit.shape, rise=Stribeck(SMALL_RISE, share * fastest)) for share in RISE_SPEEDS]
    tried = [fit_axis(lined, fit.terms, start, iterations=CHOICE_ITERATIONS) for start in starts]
    other = fit_aligned(views, fit.terms, min(tried, key=lambda one: one.rms).shape)
    return min(fit, other, key=lambda one: one.rms)


def split_distances(spectrum: Spectrum, count: int) -> Array:
    """So many break-away distances: clusters of the spectrum, the widest gaps filled where these are few."""
    distances = cluster(spectrum, count)[0]
    while len(distances) < count:
        distances = _fill_gap(distances)
    return distances


def _fill_gap(distances: Array) -> Array:
    """One distance more, in the middle of the widest gap; of a single one, below it."""
    if len(distances) == 1:
        return np.array([NEXT * distances[0], distances[0]])
    ratios = distances[1:] / distances[:-1]
    k = int(np.argmax(ratios))
    return np.insert(distances, k + 1, math.sqrt(distances[k] * distances[k + 1]))


def _change_count(near: AxisFit, count: int) -> list[Array]:
    """Distances of a fit with its closest two elements merged, or with one more: below all, above all, in any gap."""
    distances = near.shape.distances
    if count > len(distances):
        ends = NEXT * distances[0], distances[-1] / NEXT
        between = np.sqrt(distances[1:] * distances[:-1])
        return [np.sort(np.append(distances, one)) for one in (ends[0], *between.tolist(), ends[1])]
    return [join_nearest(near, count)]


def join_nearest(fit: AxisFit, count: int) -> Array:
    """Distances (count) of a fit with its closest elements merged."""
    weights = np.maximum(fit.levels, 1e-9 * (fit.coulomb or 1.0))  # where all are 0, alike
    return cluster(Spectrum(fit.shape.distances, weights, None), count)[0]


def element_numbers(recording: Recording, noise: float) -> dict[str, float]:
    """Numbers of the elements, viscous friction and the rise towards low speed, by their names in results [SI].

    A spectrum of break-away distances by nonnegative least squares, as many clusters of it as the recording's machine
    has elements, and their nonlinear fit, as elements that switch whatever the machine's law: the laws differ by less
    than a start is off. Of the machine's numbers only the order counts in which its elements break away: the one that
    does first keeps its name in the machine.

    Args:
        recording: rows of a log, behind the chain.
        noise: of a row [N].

    Returns:
        Nothing where there is no friction, or where elements never slid: their level is open.
    """
    friction = recording.machine.friction
    records = Records(recording.machine, ("",), recording, (filter_motion(recording),), (), 0.0, ())
    terms = (viscous_term(recording), mass_term(recording), *sampling_terms(recording), *companion_terms(recording))
    grid = distance_grid(records)
    spectrum = find_spectrum(records, terms, noise, grid)
    if not len(spectrum.distances):
        return {}
    view = RecordView(recording, records.coarse, noise, (float(grid[0]), float(grid[-1])))
    start = Shape("switching", split_distances(spectrum, friction.n_z), spectrum.rise)
    found = fit_axis(view, terms, start, iterations=CHOICE_ITERATIONS)
    if not found.coulomb > 0.0:  # the spectrum had a trace of a level, the fit at this rate has no use for it
        return {}
    levels = np.maximum(found.levels, LEAST_SHARE * found.coulomb)
    coulomb = float(levels.sum())
    if coulomb > float(np.max(np.abs(recording.friction[recording.used]))):
        return {}
    numbers = {"coulomb": coulomb, "viscous": float(found.coefficient("viscous")[0])}
    own = np.argsort(np.array(friction.fraction) / np.array(friction.stiffness))
    for place, level, distance in zip(own.tolist(), levels.tolist(), found.shape.distances.tolist(), strict=True):
        numbers[f"stiffness_{place + 1}"] = level / distance
        numbers[f"fraction_{place + 1}"] = level / coulomb
    if found.shape.rise is not None:
        numbers |= {"stribeck_ratio": found.shape.rise.ratio, "stribeck_velocity": found.shape.rise.velocity}
    return numbers
