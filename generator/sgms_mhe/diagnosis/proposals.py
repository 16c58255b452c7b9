"""Criteria a search for causes compares a gain with."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from sgms_mhe.model.effects import EffectDefinition, MotionRecord
from sgms_mhe.recordings.evidence import Nuisance, score_test
from sgms_mhe.recordings.recording import Recording
from sgms_mhe.support.arrays import Array

NARROWED: Final = (1.0, 1.0, 0.3, 0.1)  # of the first width: those of the parabolas about a peak


@dataclass(frozen=True)
class Proposal:
    """Proposal of an effect.

    Attributes:
        name: effect.
        parameters: to start its refit from.
        columns: force per unit of its linear sizes on used rows, nuisance projected out (rows used, k).
        coefficients: the sizes (k).
        energy: sum of squares it explains [N^2].
        tests: how many independent trials the search amounts to.
        p_value: robust score test, times `tests`.
        feasible: whether the sizes are physically possible.
    """

    name: str
    parameters: Mapping[str, float]
    columns: Array
    coefficients: Array
    energy: float
    tests: float
    p_value: float
    feasible: bool


@dataclass(frozen=True)
class Residual:
    """Input of a search.

    Attributes:
        recording: the record.
        motion: its signals and the model's friction.
        free: directions of the fit's parameters on used rows.
        e: the fit's residual there, these directions projected out (rows used) [N].
    """

    recording: Recording
    motion: MotionRecord
    free: Nuisance
    e: Array

    def columns(self, whole: Array) -> Array:
        """Columns (m, k) on used rows, the free directions projected out."""
        return self.free.project(whole[self.recording.used])


def energy(Z: Array, e: Array) -> float:
    """Sum of squares of e (rows used) that columns Z (rows used, k) explain."""
    return _explained(Z.T @ Z, Z.T @ e)


def _explained(H: Array, b: Array) -> float:
    """The same from products of the columns with each other (k, k) and with e (k)."""
    if not np.all(np.isfinite(H)) or float(np.trace(H)) <= 0.0:
        return 0.0
    return float(b @ np.linalg.lstsq(H, b, rcond=1e-10)[0])


def nearest_peak(seen: Residual, columns: Callable[[float], Array], start: float, width: float, most: float) -> float:
    """The argument from 0 to `most` near `start` whose columns (rows used, k) explain most beside the free directions.

    By parabolas through three points, the first ones `width` apart.
    """
    Q = seen.free.basis

    def explained(at: float) -> float:
        Z = columns(at)
        inside = Q.T @ Z
        return _explained(Z.T @ Z - inside.T @ inside, Z.T @ seen.e)  # e has no part along the basis

    best = start
    for share in NARROWED:
        h = min(share * width, 0.5 * best)
        low, middle, high = (explained(min(at, most)) for at in (best - h, best, best + h))
        bend = low - 2.0 * middle + high
        if bend < 0.0 and middle >= max(low, high):
            best += 0.5 * h * (low - high) / bend
        else:
            best = min(best - h if low > high else best + h, most)
    return best


def propose(
    definition: EffectDefinition,
    seen: Residual,
    Z: Array,
    tests: float,
    parameters: Callable[[Array], Mapping[str, float]],
) -> Proposal:
    """The proposal that projected columns Z (rows used, k) amount to; `parameters`: of the sizes found (k)."""
    p, size = score_test(seen.recording, Z, seen.e)
    values = parameters(size)
    feasible = True
    known = {}
    for name in definition.names(values):
        parameter = definition.parameter(name)
        value = values.get(name, parameter.default)
        feasible &= bool(parameter.lower <= value <= parameter.upper) and math.isfinite(value)
        known[name] = value
    return Proposal(definition.name, known, Z, size, energy(Z, seen.e), tests, min(1.0, p * tests), feasible)
