"""Force over acceleration along a log: how much of the force is inertia, how much friction, and of which sign.

    force = c a + F_c sign(v) + F_v v + k x + o

Where an axis has just turned round its friction still has the old direction, which looks like a force against the
acceleration. So only samples a distance behind the last reversal count for the inertia.

For the sign both are tried, that which was recorded and the other, with any force g of the place in place of k x + o:

    +- force = c a + sum_i F_i z_i(x) + F_v v + g(x),   c >= 0, F_i >= 0

Gravity, springs and contacts are forces of the place, of either sign. A drive that holds against a push is a
spring and a damper: F_v is free, so that it tells no sign. z_i are elements of dry friction, springs that slip.
"""

from typing import Final

import numpy as np
from scipy.optimize import nnls

from sgms_mhe.support.arrays import Array

BLOCKS: Final = 10
"""Parts of the record, each left out once: the spread of what is left is the standard error."""
_LEAST_ROWS: Final = 40
_BOTH_WAYS: Final = 0.1
"""Share of the sliding part in the rarer direction, below which a friction is not told from an offset."""
_SURE: Final = 4.0
"""Standard errors that a sign is away from zero."""
_REAL_ACCELERATION: Final = 0.6
_REAL_VELOCITY: Final = 0.8
"""What is left of a derivative over intervals twice as long; of white noise in position 0.25 and 0.56 are left."""
_WAVES: Final = (0.5, 1.0, 1.5, 2.0)
"""Periods in the travel of the sines of a force of the place."""
_ALIKE: Final = 1e-6
"""Size of a direction of the free terms, over the largest, below which it is one of the others."""
_LENGTHS: Final = (1e-4, 1e-3, 1e-2, 0.1)
"""Of the travel: after which the elements of a friction slip."""
_LESS: Final = 0.8
"""Share of the squares that the better sign leaves at most."""
_MOST: Final = 0.75
"""Share of what the free terms leave that the better sign explains,"""
_PART: Final = 0.12
"""or of the whole force."""
_AGAINST: Final = 0.25
"""Share of the gain that parts of the record may lose by it."""
_LARGE: Final = 0.3
"""Share of the force's standard deviation that a part has to have, to be no accident of what is not modelled."""


def find_inertia(x: Array, v: Array, a: Array, force: Array, distance: float) -> float:
    """Force over acceleration of a log [kg, kg m^2]; 0 where it cannot be told from nothing.

    Args:
        x, v, a, force: position, velocity, acceleration and force (n,) at the same instants, in order, finite.
        distance: behind a reversal after which friction has its new direction.
    """
    sliding = since_reversal(x, distance) > distance
    x, v, a, force = (values[sliding] for values in (x, v, a, force))
    if not _is_motion(a, _REAL_ACCELERATION):
        return 0.0
    A = _terms(x, v, a)
    whole, others = _jackknife(A, force)
    # Acceleration that the other terms would take on themselves says nothing: only the rest of it does.
    rest = A[:, 0] - A[:, 1:] @ np.linalg.lstsq(A[:, 1:], A[:, 0], rcond=None)[0]
    # A small part is no accident either where still less is left unexplained.
    least = min(_LARGE * float(np.std(force)), float(np.std(force - A @ whole)))
    told = abs(whole[0]) * float(np.std(rest)) > least and _sure(whole[0], [other[0] for other in others])
    return float(whole[0] / _size(a)) if told else 0.0


def _is_motion(values: Array, least: float) -> bool:
    """Return True if a derivative of position is motion: as large over intervals twice as long; noise is not.

    A controller answers to the noise of its encoder: a force goes with it that says nothing of mass or friction.
    """
    if len(values) < _LEAST_ROWS:
        return False
    longer = np.convolve(values, (0.25, 0.5, 0.25), mode="same")
    return float(np.std(longer)) > least * float(np.std(values))


def find_sign(x: Array, v: Array, a: Array, force: Array) -> int:
    """Sign with which a force leaves less, and friction brakes; 0 where they leave as much, or parts of it differ."""
    if not _is_motion(v, _REAL_VELOCITY) or not _goes_both_ways(v):
        return 0
    travel, real = float(np.ptp(x)), _is_motion(a, _REAL_ACCELERATION)
    place = 2.0 * np.pi * (x - x.min()) / travel
    waves = [wave(k * place) for k in _WAVES for wave in (np.sin, np.cos)]
    # An acceleration that is noise explains what it can, and tells no sign.
    free = np.column_stack(
        [np.ones_like(x), v / _size(v), place, np.sin(x), np.cos(x), *waves, (not real) * a / _size(a)]
    )
    bound = np.column_stack([real * a / _size(a), *(_stretch(x, length * travel) for length in _LENGTHS)])
    U, sizes, _ = np.linalg.svd(free, full_matrices=False)
    U = U[:, sizes > _ALIKE * sizes[0]]
    A, y = bound - U @ (U.T @ bound), force - U @ (U.T @ force)
    residuals, friction = {}, {}
    for sign in (1, -1):
        solution, _ = nnls(A, sign * y)
        friction[sign] = float(solution[1:].sum())
        residuals[sign] = np.array([np.sum(part**2) for part in np.array_split(sign * y - A @ solution, BLOCKS)])
    better = min(residuals, key=lambda sign: float(residuals[sign].sum()))
    gains = residuals[-better] - residuals[better]
    # Of a motion that repeats itself the place explains nearly all, and little is told by what is left.
    told = y @ y - residuals[better].sum()
    is_told = told > min(_MOST * (y @ y), _PART * np.sum((force - force.mean()) ** 2))
    is_clear = residuals[better].sum() < _LESS * residuals[-better].sum()
    is_clear = is_clear and is_told and -gains[gains < 0].sum() < _AGAINST * gains.sum()
    return better if is_clear and friction[better] > 0.0 else 0


def _stretch(x: Array, length: float) -> Array:
    """Stretch of a spring that slips at a length, over that, along a motion (n)."""
    stretch, stretches = 0.0, []
    for step in (np.diff(x, prepend=x[0]) / length).tolist():
        stretch = min(max(stretch + step, -1.0), 1.0)
        stretches.append(stretch)
    return np.array(stretches)


def _size(column: Array) -> float:
    return float(np.sqrt(np.mean(column**2))) or 1.0


def _terms(x: Array, v: Array, a: Array) -> Array:
    """Terms of the force (n, k), each of size 1, the acceleration first; in one direction friction is an offset."""
    columns = [a, x - x.mean(), np.ones_like(a), v, *([np.sign(v)] if _goes_both_ways(v) else [])]
    return np.column_stack([column / _size(column) for column in columns])


def _goes_both_ways(v: Array) -> bool:
    return min(float(np.mean(v > 0.0)), float(np.mean(v < 0.0))) >= _BOTH_WAYS


def _jackknife(A: Array, force: Array) -> tuple[Array, list[Array]]:
    """(solution of the whole, solutions without each block in turn)."""
    parts = zip(np.array_split(A, BLOCKS), np.array_split(force, BLOCKS), strict=True)
    normal = [(part.T @ part, part.T @ y) for part, y in parts]
    return _solve(normal), [_solve([*normal[:k], *normal[k + 1 :]]) for k in range(BLOCKS)]


def since_reversal(x: Array, distance: float) -> Array:
    """How far position is from where it last turned round, after it had gone `distance` in that direction (n,)."""
    travelled = np.empty(len(x))
    turned, farthest, direction = float(x[0]), float(x[0]), 0.0
    for k, here in enumerate(x.tolist()):
        if direction == 0.0 and abs(here - turned) > distance:
            direction, farthest = float(np.sign(here - turned)), here
        elif (here - farthest) * direction > 0.0:
            farthest = here
        elif (farthest - here) * direction > distance:
            turned, farthest, direction = farthest, here, -direction
        # On the way back, before it counts as a reversal, nothing is known of friction.
        travelled[k] = abs(here - turned) if here == farthest else 0.0
    return travelled


def _solve(normal: list[tuple[Array, Array]]) -> Array:
    return np.asarray(np.linalg.lstsq(sum(n for n, _ in normal), sum(b for _, b in normal), rcond=1e-10)[0])


def _sure(value: float, others: list[float]) -> bool:
    """Return True if a number is significantly different from zero by the jackknife's standard error."""
    n = len(others)
    error = float(np.sqrt((n - 1) / n * np.sum((np.array(others) - np.mean(others)) ** 2)))
    return abs(value) > _SURE * error
