"""A periodic function as a table: a cubic B-spline through equally spaced points, in a bounded number of operations.

    f(u) = sum_i b_i(t) c[(j + i - 1) mod n],  j = floor(n (u - floor(u))),  t = n (u - floor(u)) - j,  i = 0..3

with the four pieces b_i of the cubic B-spline: f has two continuous derivatives, so that it does not matter which side
of a point rounding puts a position on. A look-up is written as sum_k (x = k) c_k, which CasADi differentiates and
evaluates as it stands; the emitted C has an array of its own for it.
"""

import math
from collections.abc import Sequence
from typing import Final

import casadi as ca
import numpy as np

from sgms_mhe.model.effects.spline_table import TAPS, spline_pieces
from sgms_mhe.support.arrays import Array

POINTS: Final = 32
"""Points per shortest period: a sine of that period is right to 4e-6 of its amplitude, (2 pi / POINTS)^4 / 384."""


def spline_coefficients(orders: Sequence[int], sine: Sequence[float], cosine: Sequence[float]) -> Array:
    """Coefficients c (n) of the spline through sum_h sine_h sin(2 pi order_h u) + cosine_h cos(...) at u = k / n.

    A sine's samples stay a sine in c, (2 + cos(2 pi order / n)) / 3 times smaller than in f.
    """
    count = POINTS * max(orders)
    angle = 2.0 * math.pi * np.outer(np.arange(count), orders) / count
    passed = (2.0 + np.cos(2.0 * math.pi * np.asarray(orders) / count)) / 3.0
    return np.asarray((np.sin(angle) * np.asarray(sine) + np.cos(angle) * np.asarray(cosine)) @ (1.0 / passed))


def periodic_spline(coefficients: Array, periods: ca.SX) -> ca.SX:
    """f at so many periods from zero."""
    count = len(coefficients)
    place = count * (periods - ca.floor(periods))
    point = ca.floor(place)
    t = place - point
    # j = n where u rounds to 1: as many entries more as taps and that reach beyond.
    table = ca.SX(ca.DM(coefficients[(np.arange(count + TAPS) - 1) % count]))
    places = ca.SX(ca.DM(np.arange(count + TAPS)))
    taps = (ca.dot(table, places == point + float(i)) for i in range(TAPS))
    force = ca.SX(0.0)
    for piece, tap in zip(spline_pieces(t), taps, strict=True):
        force = force + piece * tap
    return force / 6.0
