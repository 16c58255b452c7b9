"""Explicit Runge-Kutta schemes whose every stage uses the slope before it alone."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Stage:
    """One stage: evaluated at y + a h k_previous and time t + c h, its slope weighted by b."""

    a: float
    b: float
    c: float


@dataclass(frozen=True)
class Scheme:
    """A Runge-Kutta scheme and its order of convergence."""

    text: str
    order: int
    stages: tuple[Stage, ...]

    def with_text(self, text: str) -> Scheme:
        """The same scheme described otherwise."""
        return replace(self, text=text)


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
