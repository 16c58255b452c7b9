"""A level of friction that settles at another value over time."""

from collections.abc import Callable
from typing import Final

import casadi as ca
import numpy as np

from sgms_mhe.model.axis import Expressions, SymbolicAxis
from sgms_mhe.model.effects.causes import Simpler
from sgms_mhe.model.effects.motion import MotionRecord
from sgms_mhe.model.effects.parameters import EffectParameter, shape
from sgms_mhe.model.effects.search import Columns, Values, one_size
from sgms_mhe.support.arrays import Array

SLOWEST: Final = 20.0
"""Largest time constant that a record tells, over its length: a slower drift is a line in time."""


def drift_parameters(level: str) -> tuple[EffectParameter, ...]:
    """Parameters of a drift of `level`."""
    return (
        EffectParameter("ratio", 0.0, 0.1, f"final change over the initial {level}", lower=-0.95),
        shape(
            "time_constant_s", 10.0, 1.0, "time to 63 % of the change", 1e-3, most=lambda extents: SLOWEST * extents.end
        ),
    )


def drift_factor(axis: SymbolicAxis, p: Expressions) -> ca.SX:
    """1 + ratio (1 - exp(-t / time constant))."""
    return 1.0 + p["ratio"] * (1.0 - ca.exp(-axis.time / p["time_constant_s"]))


def drift_search(force: Callable[[MotionRecord], Array]) -> Columns:
    """Search of a drift of the quantity behind `force` (m) [N]: linear in ratio at a given time constant."""

    def columns(motion: MotionRecord, given: Values) -> Array:
        settled = 1.0 - np.exp(-motion.time / given["time_constant_s"])
        return np.asarray((force(motion) * settled)[:, None])

    return Columns(columns, one_size("ratio"), _time_constants, tests=3.0)


def drift_limit(base: str) -> Simpler:
    """A drift that is over at once is a wrong number, `base`."""
    return Simpler((base,), lambda p, extents: p["time_constant_s"] < 0.01 * extents.end)


def _time_constants(motion: MotionRecord) -> list[Values]:
    return [{"time_constant_s": share * motion.extents.end} for share in (0.03, 0.08, 0.2, 0.4, 0.8, 2.0)]
