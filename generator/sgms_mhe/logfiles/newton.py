"""Force over acceleration along a log: how much of the force is inertia, how much friction, and of which sign.

    force = c a + F_c sign(v) + F_v v + k x + o                                  least squares over the sliding part

Where an axis has just turned round its friction still has the old direction, which looks like a force against the
acceleration. So only what lies a distance behind the last reversal counts.
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
_SURE: Final = 5.0
"""Standard errors that a sign is away from zero."""
_LARGE: Final = 0.3
"""Share of the force's standard deviation that a part has to have, to be no accident of what is not modelled."""


@dataclass(frozen=True)
class ForceBalance:
    """What a log's force goes with.

    Attributes:
        inertia: c [kg, or kg m^2]; 0 where it cannot be told from nothing.
        dissipates: 1 where the force works against the motion as friction does, -1 where it drives it, 0 untold.
    """

    inertia: float
    dissipates: int

    @property
    def reversed(self) -> bool:
        """Whether the force accelerates against itself, or friction drives the motion, and nothing speaks for it."""
        votes = (self.inertia, float(self.dissipates))
        return min(votes) < 0.0 and max(votes) <= 0.0


def force_balance(x: Array, v: Array, a: Array, force: Array, distance: float) -> ForceBalance:
    """Balance the forces of a log.

    Args:
        x, v, a, force: position, velocity, acceleration and force (n,) at the same instants, in order, finite.
        distance: behind a reversal after which friction has its new direction.
    """
    sliding = since_reversal(x, distance) > distance
    if np.count_nonzero(sliding) < _LEAST_ROWS:
        return ForceBalance(0.0, 0)
    x, v, a, force = (values[sliding] for values in (x, v, a, force))
    forward = float(np.mean(v > 0.0))
    both = _BOTH_WAYS <= forward <= 1.0 - _BOTH_WAYS
    columns = [a, x - x.mean(), np.ones_like(a), *((np.sign(v), v) if both else (v,))]
    A = np.column_stack([column / (np.sqrt(np.mean(column**2)) or 1.0) for column in columns])
    spread = float(np.std(force))
    if spread == 0.0:
        return ForceBalance(0.0, 0)
    normal = [(part.T @ part, part.T @ y) for part, y in zip(_parts(A), _parts(force), strict=True)]
    whole = _solved(normal)
    others = [_solved([*normal[:k], *normal[k + 1 :]]) for k in range(len(normal))]
    # Acceleration that the other terms would take on themselves says nothing: only the rest of it does.
    rest = A[:, 0] - A[:, 1:] @ np.linalg.lstsq(A[:, 1:], A[:, 0], rcond=None)[0]
    scale = float(np.sqrt(np.mean(a**2))) or 1.0
    size = abs(whole[0]) * float(np.std(rest)) / spread
    inertia = whole[0] / scale if size > _LARGE and _sure(whole[0], [other[0] for other in others]) else 0.0
    if not both:
        return ForceBalance(float(inertia), 0)
    friction = A[:, 3:] @ whole[3:]
    power = [float(np.mean(A[:, 3:] @ solution[3:] * v)) for solution in (whole, *others)]
    told = float(np.std(friction)) > _LARGE * spread and _sure(power[0], power[1:])
    return ForceBalance(float(inertia), int(np.sign(power[0])) if told else 0)


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


def _parts(values: Array) -> list[Array]:
    return np.array_split(values, BLOCKS)


def _solved(normal: list[tuple[Array, Array]]) -> Array:
    return np.asarray(np.linalg.lstsq(sum(n for n, _ in normal), sum(b for _, b in normal), rcond=1e-10)[0])


def _sure(value: float, others: list[float]) -> bool:
    """Whether a number is far from zero by the jackknife's standard error."""
    n = len(others)
    error = float(np.sqrt((n - 1) / n * np.sum((np.array(others) - np.mean(others)) ** 2)))
    return abs(value) > _SURE * error
