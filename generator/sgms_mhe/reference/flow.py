"""Displacement flow of one saturated element: the exact solution of dr/dxi = g(r) (docs/integration.md).

The reference solves it by its own route. With k = -g'(r*) and d = r - r*, the function psi that linearises the flow
obeys psi'/psi = -k/g, so that

    log|psi| = log|d| + L(d),    L'(d) = -k/g - 1/d,    L(0) = 0

with an analytic L. L is integrated once by Chebyshev panels; a flow over xi is then the root of
log|d| + L(d) = log|d0| + L(d0) - k xi, found by a safeguarded Newton iteration in log|d|, which keeps the relative
accuracy of d however close the state is to r*.
"""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray
from scipy.optimize import brentq

from sgms_mhe.machine import Smoothing

TAIL = 1e-10
GRID = 0.01
LARGEST_RATIO = 1e6
DEGREE = 15
# Half-width of a panel in units of 1/lambda; the poles of tanh lie pi/2 of them off the real axis.
PANEL = 0.2
# Beyond zeta + 20/lambda etaA is 1 within double precision, and the flow is an exponential.
SATURATED = 20.0
# Distance from r* within which an element slides, times lambda: there merged samples may be one step.
NEAR = 0.14
# Below it relaxation() sums a series, TERMS of which leave nothing within double precision.
SMALL = 0.5
TERMS = 14


def window(r: NDArray[np.float64] | float, smoothing: Smoothing) -> NDArray[np.float64]:
    """etaA of equation (3)."""
    lambda_, zeta = smoothing.lambda_, smoothing.zeta
    return np.asarray(1.0 - 0.5 * np.tanh(lambda_ * (r + zeta)) + 0.5 * np.tanh(lambda_ * (r - zeta)))


def gate_ratio(smoothing: Smoothing) -> float:
    """Smallest |v|/v_s, on a grid of 0.01, at which the gate's tail changes g by less than 1e-10; inf if there is none.

    The tail of etaB at relative deflection r is 1/(1 + exp(2 gamma c |r|)), on either side of r = 0; etaA is even in r.
    """
    # The largest change sits where the window opens, or near r = 0 if it never closes there.
    r = np.concatenate([np.linspace(0.0, 3.0, 30001), np.geomspace(1e-12, 1e-3, 2001)])
    weight = r * window(r, smoothing)

    def change(step: int) -> float:
        exponent = np.minimum(2.0 * smoothing.gamma * (GRID * step) * r, 700.0)
        return float(np.max(weight / (1.0 + np.exp(exponent))))

    # The change falls with c: bisection on the grid.
    low, high = 0, 1
    while change(high) >= TAIL:
        low, high = high, 2 * high
        if GRID * high > LARGEST_RATIO:
            return math.inf
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if change(middle) < TAIL else (middle, high)
    return high / 100.0


@dataclass(frozen=True)
class Flow:
    """Tables of the flow of one smoothing.

    Attributes:
        smoothing: zeta, lambda, gamma.
        r_star: root of g, where sliding settles.
        k: -g'(r*), the rate of settling per unit of xi.
        curvature: g''(r*).
        r_max: beyond it etaA is 1.
        below: Chebyshev coefficients of L on equal panels of [0, r*], shape (panels, DEGREE + 1), nearest to r* last.
        above: the same on [r*, r_max], nearest to r* first.
    """

    smoothing: Smoothing
    r_star: float
    k: float
    curvature: float
    r_max: float
    below: NDArray[np.float64]
    above: NDArray[np.float64]

    @classmethod
    def of(cls, smoothing: Smoothing) -> Self:
        """Tabulate L for one smoothing."""
        lambda_, zeta = smoothing.lambda_, smoothing.zeta
        r_star = float(brentq(lambda r: r * float(window(r, smoothing)) - 1.0, 0.0, 2.0 + 20.0 / lambda_, xtol=1e-15))
        slope = bend = 0.0  # of etaA
        for sign, edge in ((1.0, zeta), (-1.0, -zeta)):
            angle = lambda_ * (r_star - edge)
            part = sign * 0.5 * lambda_ * math.cosh(_clip(angle)) ** -2.0
            slope += part
            bend -= 2.0 * lambda_ * math.tanh(angle) * part
        k = float(window(r_star, smoothing)) + r_star * slope
        curvature = -(2.0 * slope + r_star * bend)
        r_max = max(zeta, r_star) + SATURATED / lambda_
        bare = cls(smoothing, r_star, k, curvature, r_max, np.zeros((0, 0)), np.zeros((0, 0)))
        below = bare._panels(-r_star)
        above = bare._panels(r_max - r_star)
        return cls(smoothing, r_star, k, curvature, r_max, below[::-1], above)

    def g(self, d: float) -> float:
        """Rate at r = r* + d >= 0, with full relative accuracy near d = 0."""
        lambda_, zeta = self.smoothing.lambda_, self.smoothing.zeta
        eta = float(window(self.r_star + d, self.smoothing))
        if abs(lambda_ * d) > 1.0:
            return 1.0 - eta * (self.r_star + d)

        def half_tanh_difference(a: float) -> float:
            return 0.5 * math.sinh(lambda_ * d) / (math.cosh(_clip(a + lambda_ * d)) * math.cosh(_clip(a)))

        change = half_tanh_difference(lambda_ * (self.r_star - zeta))
        change -= half_tanh_difference(lambda_ * (self.r_star + zeta))
        return -(d * eta + self.r_star * change)

    def advance(self, r0: float, xi: float) -> tuple[float, float, float]:
        """Follow the flow over xi >= 0: (r1, dr1/dr0, dr1/dxi)."""
        if r0 < 0.0:
            if r0 + xi <= 0.0:
                return r0 + xi, 1.0, 1.0
            r1, _, g1 = self.advance(0.0, r0 + xi)
            return r1, g1, g1  # g(r0) = 1
        if r0 > self.r_max:
            until = math.log((r0 - 1.0) / (self.r_max - 1.0))
            if xi <= until:
                r1 = 1.0 + (r0 - 1.0) * math.exp(-xi)
                return r1, math.exp(-xi), 1.0 - r1
            r1, _, g1 = self.advance(self.r_max, xi - until)
            return r1, g1 / (1.0 - r0), g1
        d0 = r0 - self.r_star
        if d0 == 0.0:
            return self.r_star, math.exp(-self.k * xi), 0.0
        d1 = self._solve(d0, xi)
        g1 = self.g(d1) if d1 != 0.0 else 0.0
        return self.r_star + d1, g1 / self.g(d0), g1

    def pack(self) -> NDArray[np.float64]:
        """All numbers in one array, in the order that intervals.c reads."""
        head = [self.r_star, self.k, self.curvature, self.r_max, self.smoothing.lambda_, self.smoothing.zeta]
        return np.concatenate([head, [len(self.below), len(self.above)], self.below.ravel(), self.above.ravel()])

    def _level(self, d: float) -> tuple[float, float]:
        """(L(d), dL/dd) by its table."""
        table, start, end = (self.below, -self.r_star, 0.0) if d < 0.0 else (self.above, 0.0, self.r_max - self.r_star)
        width = (end - start) / len(table)
        index = min(max(int((d - start) / width), 0), len(table) - 1)
        t = 2.0 * (d - start - index * width) / width - 1.0
        value = float(chebyshev.chebval(t, table[index]))
        return value, -self.k / self.g(d) - 1.0 / d

    def _solve(self, d0: float, xi: float) -> float:
        sign = math.copysign(1.0, d0)
        upper = math.log(abs(d0))
        target = upper + self._level(d0)[0] - self.k * xi
        if target < -600.0:
            return 0.0
        edge = self._level(-self.r_star if d0 < 0.0 else self.r_max - self.r_star)[0]
        lower = target - max(edge, 0.0) - 1.0
        lower = min(lower, upper - 1e-3)
        # A short flow is nearly a straight line, a long one has only its tail left.
        line = sign * (d0 + self.g(d0) * xi)
        x = min(max(math.log(line) if line > 0.5 * abs(d0) else target, lower), upper)
        for _ in range(200):
            d = sign * math.exp(x)
            level, slope = self._level(d)
            residual = x + level - target
            if residual > 0.0:
                upper = min(upper, x)
            else:
                lower = max(lower, x)
            step = residual / (1.0 + slope * d)
            new = x - step
            if not lower <= new <= upper:
                new = 0.5 * (lower + upper)
            moved, x = abs(new - x), new
            if moved <= 1e-10:  # quadratic: the next step would be rounding
                break
        return sign * math.exp(x)

    def _panels(self, end: float) -> NDArray[np.float64]:
        """Chebyshev coefficients of L on equal panels from d = 0 to `end`, each in the direction of rising d."""
        count = max(1, math.ceil(abs(end) * self.smoothing.lambda_ / (2.0 * PANEL)))
        width = end / count
        nodes = np.cos(math.pi * (np.arange(DEGREE) + 0.5) / DEGREE)
        start, panels = 0.0, []
        for index in range(count):
            centre, half = (index + 0.5) * width, 0.5 * abs(width)
            d = centre + half * nodes
            slope = np.array([-self.k / self.g(s) - 1.0 / s for s in d])
            integral = half * chebyshev.chebint(chebyshev.chebfit(nodes, slope, DEGREE - 1))
            inner = -1.0 if width > 0.0 else 1.0
            integral[0] += start - chebyshev.chebval(inner, integral)
            start = float(chebyshev.chebval(-inner, integral))
            panels.append(integral)
        return np.array(panels)


def relaxation(x: float) -> tuple[float, float]:
    """(phi(x), phi'(x)), answer of a sliding element to a level that is a line over displacement, for x = k xi >= 0.

    phi = 1 + e^-x - 2 (1 - e^-x)/x cancels to x^2/6 near 0; its series is sum_n (n - 1)/(n + 1)! (-x)^n, n >= 2.
    """
    if x < SMALL:
        phi = slope = 0.0
        for n in range(TERMS, 1, -1):
            term = (n - 1) / math.factorial(n + 1) * (-1.0) ** n
            phi = phi * x + term
            slope = slope * x + n * term
        return phi * x * x, slope * x
    decay, rise = math.exp(-x), -math.expm1(-x)
    return 1.0 + decay - 2.0 * rise / x, -decay + 2.0 * (rise - x * decay) / (x * x)


def _clip(x: float) -> float:
    # cosh beyond 700 overflows; its reciprocal is zero long before.
    return min(max(x, -350.0), 350.0)
