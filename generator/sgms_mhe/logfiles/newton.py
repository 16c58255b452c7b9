"""Force over acceleration along a log: how much of the force is inertia, how much friction, and of which sign.

    force = c a + F_c sign(v) + F_v v + k x + o

Where an axis has just turned round its friction still has the old direction, which looks like a force against the
acceleration. So only what lies a distance behind the last reversal counts for the inertia. Friction takes power whether
it slides or not: for its sign the whole record counts.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

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
_LARGE: Final = 0.3
"""Share of the force's standard deviation that a part has to have, to be no accident of what is not modelled."""


@dataclass(frozen=True)
class ForceBalance:
    """Regression of a log's force on its motion.

    Attributes:
        inertia: c [kg, or kg m^2]; 0 where it cannot be told from nothing.
        dissipates: 1 where the force works against the motion as friction does, -1 where it drives it, 0 untold.
    """

    inertia: float
    dissipates: int

    @property
    def has_wrong_sign(self) -> bool:
        """Return True if the force accelerates against itself, or friction drives the motion, and no vote differs."""
        votes = (self.inertia, float(self.dissipates))
        return min(votes) < 0.0 and max(votes) <= 0.0


def force_balance(x: Array, v: Array, a: Array, force: Array, distance: float) -> ForceBalance:
    """Balance the forces of a log.

    Args:
        x, v, a, force: position, velocity, acceleration and force (n,) at the same instants, in order, finite.
        distance: behind a reversal after which friction has its new direction.
    """
    sliding = since_reversal(x, distance) > distance
    inertia, dissipates = 0.0, 0
    if _is_motion(a, sliding, _REAL_ACCELERATION):
        inertia = _inertia(*(values[sliding] for values in (x, v, a, force)))
    if _is_motion(v, np.ones(len(v), dtype=bool), _REAL_VELOCITY):
        dissipates = _dissipation(x, v, a, force)
    return ForceBalance(inertia, dissipates)


def _is_motion(values: Array, counted: Mask, least: float) -> bool:
    """Return True if a derivative of position is motion: as large over intervals twice as long; noise is not.

    A controller answers to the noise of its encoder: a force goes with it that says nothing of mass or friction.
    """
    if np.count_nonzero(counted) < _LEAST_ROWS:
        return False
    longer = np.convolve(values, (0.25, 0.5, 0.25), mode="same")
    return float(np.std(longer[counted])) > least * float(np.std(values[counted]))


def _inertia(x: Array, v: Array, a: Array, force: Array) -> float:
    """c of the sliding part, or 0 where it is not sure or too little of the force."""
    spread = _spread(force)
    if not spread:
        return 0.0
    A, _ = _terms(x, v, a)
    whole, others = _jackknife(A, force)
    # Acceleration that the other terms would take on themselves says nothing: only the rest of it does.
    rest = A[:, 0] - A[:, 1:] @ np.linalg.lstsq(A[:, 1:], A[:, 0], rcond=None)[0]
    # A small part is no accident either where still less is left unexplained.
    least = min(_LARGE * spread, float(np.std(force - A @ whole)))
    told = abs(whole[0]) * float(np.std(rest)) > least and _sure(whole[0], [other[0] for other in others])
    return float(whole[0] / _size(a)) if told else 0.0


def _dissipation(x: Array, v: Array, a: Array, force: Array) -> int:
    """Sign of the power that friction's terms take, of the whole record; 0 where it is not sure or too little."""
    spread = _spread(force)
    if not spread:
        return 0
    A, friction = _terms(x, v, a)
    if len(friction) < 2:
        return 0
    whole, others = _jackknife(A, force)
    power = [float(np.mean(A[:, friction] @ solution[friction] * v)) for solution in (whole, *others)]
    told = float(np.std(A[:, friction] @ whole[friction])) > _LARGE * spread and _sure(power[0], power[1:])
    return int(np.sign(power[0])) if told else 0


def _spread(force: Array) -> float:
    return float(np.std(force)) if len(force) >= _LEAST_ROWS else 0.0


def _size(column: Array) -> float:
    return float(np.sqrt(np.mean(column**2))) or 1.0


def _terms(x: Array, v: Array, a: Array) -> tuple[Array, list[int]]:
    """(terms of the force (n, k), each of size 1, the acceleration first; which of them are friction's).

    In one direction alone a friction is an offset: there v is a term, and none is friction's.
    """
    forward = float(np.mean(v > 0.0))
    both = forward >= _BOTH_WAYS and float(np.mean(v < 0.0)) >= _BOTH_WAYS
    columns = [a, x - x.mean(), np.ones_like(a), v, *([np.sign(v)] if both else [])]
    return np.column_stack([column / _size(column) for column in columns]), [3, 4] if both else []


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
