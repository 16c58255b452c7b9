"""The floor of an identification: least squares of the same rows, with no shape to search for and nothing to choose."""

import math
from collections.abc import Mapping, Sequence
from itertools import chain, combinations
from typing import Final

import numpy as np

from sgms_mhe.identification.fits import AxisFit, RecordView, Shape, fit_axis
from sgms_mhe.identification.search import is_better
from sgms_mhe.identification.terms import SAMPLING, Term, companion_terms
from sgms_mhe.model.effects import effect_definition, separating_moves
from sgms_mhe.support.arrays import Array

RANK: Final = 1e-6
"""Of the largest singular value of scaled columns: with a smaller one they say the same."""


def fit_plain(
    view: RecordView, base: Sequence[Term], distances: Array | None = None
) -> tuple[AxisFit, Mapping[str, tuple[str, ...]]]:
    """Fit the level, base terms and the fewest forces whatever the direction than which others leave no less.

    Args:
        view: records at the full rate.
        base: terms beside the level and those forces.
        distances: of the elements that share the level [m]; None: one element, which breaks away within a count.

    Returns:
        The fit, and by the names of its effects those that explain the rows as well in their place.
    """
    shape = Shape("switching", np.array([view.limits[0]]) if distances is None else distances, None)
    forces = [term for term in companion_terms(view.rows) if effect_definition(term.name).loads]
    sets = chain.from_iterable(combinations(forces, count) for count in range(len(forces) + 1))
    fits = [fit_axis(view, (*base, *some), shape, iterations=0) for some in sets if _are_independent(view, some)]
    best = min(fits, key=lambda one: one.cross_rms)
    enough = [one for one in fits if not is_better(best, one)]
    fit = min(enough, key=lambda one: (len(one.coefficients), one.cross_rms))
    own = _effects(fit, base)
    alike = [
        _effects(other, base)
        for other in fits
        if len(other.coefficients) == len(fit.coefficients) and not is_better(fit, other)
    ]
    rivals: dict[str, tuple[str, ...]] = {}
    for name in own:
        others = {new for names in alike if name not in names for new in names - own}
        rivals[name] = tuple(sorted(other for other in others if separating_moves(name, other)))
    return fit, {name: others for name, others in rivals.items() if others}


def _effects(fit: AxisFit, base: Sequence[Term]) -> set[str]:
    return {term.name for term in fit.terms} - {term.name for term in base}


def _are_independent(view: RecordView, terms: Sequence[Term]) -> bool:
    """Return True if no column of some terms is a sum of the others."""
    if not terms:
        return True
    columns = np.column_stack([term.columns for term in terms])[view.rows.used]
    scaled = columns / np.maximum(np.sqrt(np.sum(columns**2, axis=0)), np.finfo(float).tiny)
    values = np.linalg.svd(scaled, compute_uv=False)
    return bool(values[-1] > RANK * values[0])


def measure_unseen(view: RecordView, fit: AxisFit) -> tuple[float, float]:
    """Return the RMS [N] that a fit of two thirds of the blocks leaves on the others; and without errors of timing.

    The second is that of a machine file, which states none.
    """
    rows = view.rows
    held_out = rows.rows_held_out()
    judge = fit_axis(view, fit.terms, fit.shape, rows.used & ~held_out, iterations=2)
    timing = [judge.jacobian[:, judge.place(name)] @ judge.coefficient(name) for name in SAMPLING]
    stated = judge.residual + np.sum(timing, axis=0)
    left, without = (math.sqrt(float(np.mean(series[held_out] ** 2))) for series in (judge.residual, stated))
    return left, without
