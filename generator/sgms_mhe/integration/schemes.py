"""Explicit Runge-Kutta schemes whose every stage uses the slope before it alone."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise


@dataclass(frozen=True)
class Stage:
    """One stage: evaluated at y + a h k_previous and time t + c h, its slope weighted by b."""

    a: float
    b: float
    c: float


@dataclass(frozen=True)
class WeightedStage(Stage):
    """A stage whose state counts with weight w in the result."""

    w: float


@dataclass(frozen=True)
class Scheme:
    """A Runge-Kutta scheme and its order of convergence."""

    text: str
    order: int
    stages: tuple[Stage, ...]

    @property
    def weighted_stages(self) -> tuple[WeightedStage, ...]:
        """The stages with the weights of their states Y_i = y + a_i h k_(i-1) instead of those of the slopes.

        k_(i-1) = (Y_i - y) / (a_i h), so y_1 = rest y + sum_i w_i Y_i + b h k_last, w_i = b_(i-1) / a_i.
        """
        weights = [0.0, *(before.b / stage.a for before, stage in pairwise(self.stages))]
        return tuple(WeightedStage(s.a, s.b, s.c, w) for s, w in zip(self.stages, weights, strict=True))

    @property
    def rest(self) -> float:
        """Weight of y itself beside the weighted stages."""
        return 1.0 - sum(stage.w for stage in self.weighted_stages)

    @property
    def summed(self) -> bool:
        """Whether a stage before the last has a weight of its own."""
        return any(stage.b for stage in self.stages[:-1])


SCHEMES: dict[str, Scheme] = {
    "rk4": Scheme(
        "classical Runge-Kutta, fourth order",
        4,
        (
            Stage(0.0, 1.0 / 6.0, 0.0),
            Stage(0.5, 1.0 / 3.0, 0.5),
            Stage(0.5, 1.0 / 3.0, 0.5),
            Stage(1.0, 1.0 / 6.0, 1.0),
        ),
    ),
    "rk2": Scheme("midpoint rule, second order", 2, (Stage(0.0, 0.0, 0.0), Stage(0.5, 1.0, 0.5))),
    "bs23": Scheme(
        "third-order weights of Bogacki and Shampine",
        3,
        (Stage(0.0, 2.0 / 9.0, 0.0), Stage(0.5, 1.0 / 3.0, 0.5), Stage(0.75, 4.0 / 9.0, 0.75)),
    ),
    "euler": Scheme("explicit Euler, first order", 1, (Stage(0.0, 1.0, 0.0),)),
}
