"""A function of one or two coordinates as a table: cubic B-splines on even grids, zero beyond them.

    f(a, b) = sum_ij c_ij B(a + 3 - i) B(b + 3 - j),   i = 0 .. cells + 2

with a, b counted in cells from the grids' lower ends and B the cubic B-spline on the knots 0, 1, 2, 3, 4: f and two of
its derivatives are continuous, and f falls to zero within three cells of the grid. Four splines are not zero in a cell,
so that a value takes 4 look-ups, of two coordinates 16, whatever the table's length. The place is limited to where f is
not zero before it is made an index, and the table has zeros there.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final, Self

import casadi as ca
import numpy as np

from sgms_mhe.support.arrays import Array

DEGREE: Final = 3
TAPS: Final = DEGREE + 1
"""Splines that are not zero in a cell."""


@dataclass(frozen=True)
class GridPlace:
    """A coordinate's place on its grid.

    Attributes:
        place: cells from three below the lower end, where the first spline begins.
        cells: of the grid.
    """

    place: ca.SX
    cells: int

    @classmethod
    def of(cls, value: ca.SX, low: ca.SX, high: ca.SX, cells: int) -> Self:
        """Place of a value on a grid between two ends."""
        return cls((value - low) * (cells / (high - low)) + float(DEGREE), cells)

    @property
    def splines(self) -> int:
        """Number of splines that are not zero on the grid."""
        return self.cells + DEGREE

    @property
    def end(self) -> int:
        """Place from which on all splines are zero."""
        return self.splines + DEGREE


def spline_table(coefficients: Array, places: Sequence[GridPlace]) -> ca.SX:
    """Return f from a table, of coefficients (splines of each coordinate); of no coordinate its only number."""
    if not places:
        return ca.SX(float(coefficients))
    padded = np.pad(coefficients, (DEGREE, TAPS))
    table, numbers = ca.SX(ca.DM(padded.ravel())), ca.SX(ca.DM(np.arange(padded.size)))
    first, weights = ca.SX(0.0), []
    for place, length in zip(places, padded.shape, strict=True):
        held = ca.fmin(ca.fmax(place.place, 0.0), float(place.end))
        cell = ca.floor(held)
        first = float(length) * first + cell
        weights.append(spline_pieces(held - cell))
    strides = np.cumprod((1, *padded.shape[:0:-1]))[::-1]
    force = ca.SX(0.0)
    for taps in product(range(TAPS), repeat=len(places)):
        entry = ca.dot(table, numbers == first + float(np.dot(strides, taps)))
        for weight, tap in zip(weights, taps, strict=True):
            entry = weight[tap] * entry
        force = force + entry
    return force / 6.0 ** len(places)


def spline_sum(coefficients: Sequence[ca.SX], places: Sequence[GridPlace]) -> ca.SX:
    """Return f spline by spline, for coefficients that are no constants, row by row."""
    splines = [[cubic(place.place - float(k)) for k in range(place.splines)] for place in places]
    force = ca.SX(0.0)
    for coefficient, factors in zip(coefficients, product(*splines), strict=True):
        entry = coefficient
        for factor in factors:
            entry = entry * factor
        force = force + entry
    return force


def cubic(u: ca.SX) -> ca.SX:
    """Return the cubic B-spline on the knots 0, 1, 2, 3, 4 at u; zero elsewhere."""
    outer, inner = (ca.fmax(width - ca.fabs(u - 2.0), 0.0) for width in (2.0, 1.0))
    return (outer * outer * outer - 4.0 * (inner * inner * inner)) / 6.0


def spline_pieces(t: ca.SX) -> tuple[ca.SX, ...]:
    """Six times the four splines that are not zero at t of a cell, 0 to 1."""
    rest = 1.0 - t
    return (rest * rest * rest, (3.0 * t - 6.0) * t * t + 4.0, (3.0 * rest - 6.0) * rest * rest + 4.0, t * t * t)
