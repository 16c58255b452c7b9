"""Result of an integrator: intervals and outputs, with their sensitivities."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sgms_mhe.support.arrays import Array


class Outputs(NamedTuple):
    """Outputs and their sensitivities: y [N] (n,), C (n, n_x), D (n, n_p)."""

    y: Array
    C: Array
    D: Array

    def part(self, which: slice) -> Outputs:
        """Some of them."""
        return Outputs(self.y[which], self.C[which], self.D[which])

    @classmethod
    def join_parts(cls, parts: Sequence[Outputs]) -> Outputs:
        """One behind the other."""
        return cls(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


class Linearised(NamedTuple):
    """n intervals and their sensitivities to the node state where they start and to theta.

    Attributes:
        x1: where they end (n, n_x).
        A: its sensitivity to the node state (n, n_x, n_x).
        B: its sensitivity to theta (n, n_x, n_p).
        inner: outputs at the R - 1 measurements inside of each: y (n, R - 1), C (n, R - 1, n_x), D (n, R - 1, n_p).
    """

    x1: Array
    A: Array
    B: Array
    inner: Outputs

    def part(self, which: slice) -> Linearised:
        """Some of the intervals."""
        return Linearised(self.x1[which], self.A[which], self.B[which], self.inner.part(which))

    @classmethod
    def join_parts(cls, parts: Sequence[Linearised]) -> Linearised:
        """Intervals one behind the other."""
        x1, A, B = (np.concatenate([getattr(part, name) for part in parts]) for name in ("x1", "A", "B"))
        return cls(x1, A, B, Outputs.join_parts([part.inner for part in parts]))
