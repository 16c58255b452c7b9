"""Tables of the displacement flow: the linearising function psi of the slip law and its inverse.

For dr/dxi = g(r) with the fixed point r*, d(ln|psi|)/dr = -k / g(r), k = -g'(r*), psi ~ r* - r. psi is analytic and
monotone through r*, so one piecewise polynomial serves loading and relaxation. Computed in decimal numbers of more
digits than a double holds, so that every machine emits the same bytes.
"""

import math
from bisect import bisect_left
from dataclasses import dataclass
from decimal import MAX_EMAX, MIN_EMIN, Context, Decimal, localcontext
from functools import lru_cache

from mpmath import mp, mpf
from numpy.polynomial.chebyshev import cheb2poly

from sgms_mhe.support.errors import InputError

TAIL = 1e-10
"""The gate counts as saturated where its tail changes g by less than this."""
# The elastic range ends where slip changes g by this much: sensitivities are then right to 1e-10, or to rounding.
_ELASTIC = {"double": 1e-12, "single": 1e-8}
_DIGITS = 22
_GUARD = 3  # further ones of nodes and weights
_CONTEXT = Context(prec=_DIGITS + _GUARD, Emax=MAX_EMAX, Emin=MIN_EMIN)
_QUADRATURE = 12
_SEGMENT = 0.5  # width over 1/lambda: the poles of g lie pi/2 away
_DEGREE = {"double": 12, "single": 6}
_CELLS = 128
_NEAR = 0.14  # half-width over 1/lambda of the short polynomials about the fixed point
_NEAR_DEGREE = {"double": 7, "single": 5}  # odd: no Chebyshev node falls on the fixed point

_LARGEST = 999  # hundredths of v_s: the highest speed looked at


@dataclass(frozen=True)
class FlowTable:
    """One universal curve; see sgms_flow.h for the meaning of the fields. `bend` is -g''(r*) / g'(r*)."""

    start: float
    end: float
    k: float
    r_star: float
    segments: int
    cells_per_s: float
    degree: int
    edge: tuple[float, ...]
    forward: tuple[tuple[float, ...], ...]
    inverse: tuple[tuple[float, ...], ...]
    cell: tuple[int, ...]
    near: float
    near_degree: int
    near_forward: tuple[float, ...]
    near_inverse: tuple[float, ...]
    bend: float


@lru_cache(maxsize=16)
def gate_ratio(zeta: float, lambda_: float, gamma: float, tail: float = TAIL) -> float:
    """Smallest |v| / v_s, in steps of 0.01, at which the gate etaB is saturated.

    Saturated: max over r of |r| etaA(r) (1 - etaB(|r|)) is below `tail`, so that leaving it out changes g by less.
    """
    if not gate_saturates(zeta, lambda_, gamma, tail):
        return math.inf
    steps = range(1, _LARGEST + 1)
    return steps[bisect_left(steps, True, key=lambda c: _gate_tail(zeta, lambda_, gamma, c / 100.0) < tail)] / 100.0


def gate_saturates(zeta: float, lambda_: float, gamma: float, tail: float = TAIL) -> bool:
    """Return True if there is a speed at which `gate_ratio` calls the gate saturated."""
    return _gate_tail(zeta, lambda_, gamma, _LARGEST / 100.0) < tail  # the tail falls with speed


@lru_cache(maxsize=1024)
def _gate_tail(zeta: float, lambda_: float, gamma: float, ratio: float) -> float:
    return max(
        r
        / (1.0 + math.exp(min(700.0, -2.0 * lambda_ * (r - zeta))))
        / (1.0 + math.exp(min(700.0, 2.0 * gamma * ratio * r)))
        for r in (k / 1000.0 for k in range(1, 3001))
    )


def flow_applies(zeta: float, lambda_: float, precision: str) -> bool:
    """Return True if the smoothing is sharp enough for an elastic range above r = 0."""
    return _reach(lambda_, precision) < zeta


def _reach(lambda_: float, precision: str) -> float:
    """How far from r = zeta the slip range extends."""
    return math.log(1.0 / _ELASTIC[precision]) / (2.0 * lambda_)


def flow_table(zeta: float, lambda_: float, precision: str, source: str = "machine") -> FlowTable:
    """Build the tables for one smoothing.

    Raises:
        InputError: the smoothing is too soft for the elastic range to end above r = 0.
    """
    if not flow_applies(zeta, lambda_, precision):
        least = _reach(lambda_, precision) * lambda_
        allowed = f"scheme flow needs lambda * zeta > {least:.1f}; use rk4"
        raise InputError(source, "friction.smoothing", lambda_, allowed)
    return _table(zeta, lambda_, precision)


@lru_cache(maxsize=16)
def _table(zeta: float, lambda_: float, precision: str) -> FlowTable:
    """Tables of a smoothing they are for, whichever machine has it."""
    reach = _reach(lambda_, precision)
    degree = _DEGREE[precision]
    with localcontext(_CONTEXT):
        curve = _Curve(zeta, lambda_)
        start = zeta - reach
        end = max(zeta + reach, float(curve.r_star) + 2.0 * _NEAR / lambda_)  # what comes from below settles inside
        segments = math.ceil((end - start) / (_SEGMENT / lambda_))
        width = (Decimal(end) - Decimal(start)) / segments
        edges = [Decimal(start) + width * j for j in range(segments + 1)]
        integrals = curve.integrals(edges)
        angles, to_monomials = _interpolation(degree)
        forward, inverse = [], []
        psi = [curve.psi(r, value) for r, value in zip(edges, integrals, strict=True)]
        for j in range(segments):
            low, half = edges[j], width / 2
            values = [
                curve.psi(low + half * (t + 1), integrals[j] + curve.integral(low, low + half * (t + 1)))
                for t in angles
            ]
            forward.append(_times(to_monomials, values))
            s_low, s_half = psi[j], (psi[j + 1] - psi[j]) / 2
            roots = []
            r = low
            for t in reversed(angles):  # from the segment's low edge on, each root from the one before
                target = s_low + s_half * (t + 1)
                r = _polynomial_root(forward[-1], target, (r - low) / half - 1, low, half)
                r = curve.root(target, r, low, integrals[j])
                roots.append(r)
            inverse.append(_times(to_monomials, roots[::-1]))
        near = Decimal(_NEAR / lambda_)
        near_degree = _NEAR_DEGREE[precision]
        near_angles, near_to_monomials = _interpolation(near_degree)
        near_forward = _times(
            near_to_monomials,
            [
                curve.psi(curve.r_star + near * t, curve.integral(curve.r_star, curve.r_star + near * t)) / near
                for t in near_angles
            ],
        )
        near_roots = [
            (curve.root(near * t, curve.r_star - near * t, curve.r_star, Decimal(0)) - curve.r_star) / near
            for t in near_angles
        ]
        cells_per_s = _CELLS / float(psi[0] - psi[-1])
        cell = []
        for c in range(_CELLS):
            upper = psi[0] - Decimal(c) / Decimal(cells_per_s)
            cell.append(next((j for j in range(segments) if upper > psi[j + 1]), segments - 1))
        return FlowTable(
            start=float(start),
            end=float(end),
            k=float(curve.k),
            r_star=float(curve.r_star),
            segments=segments,
            cells_per_s=cells_per_s,
            degree=degree,
            edge=tuple(float(p) for p in psi),
            forward=tuple(tuple(float(c) for c in row) for row in forward),
            inverse=tuple(tuple(float(c) for c in row) for row in inverse),
            cell=tuple(cell),
            near=float(near),
            near_degree=near_degree,
            near_forward=tuple(float(c) for c in near_forward),
            near_inverse=tuple(float(c) for c in _times(near_to_monomials, near_roots)),
            bend=float(curve.curvature(curve.r_star) / curve.k),
        )


class _Curve:
    """g, its fixed point and the integral that defines psi, in extended precision."""

    def __init__(self, zeta: float, lambda_: float) -> None:
        self.zeta, self.lambda_ = Decimal(zeta), Decimal(lambda_)
        r = Decimal(1)
        for _ in range(60):
            step = self.g(r) / self.slope(r)
            r -= step
            if abs(step) < Decimal(10) ** (2 - _DIGITS):
                break
        self.r_star = r
        self.k = -self.slope(r)
        self.rule = _gauss_legendre(_QUADRATURE)

    def logistic(self, r: Decimal) -> Decimal:
        return 1 / (1 + (-2 * self.lambda_ * (r - self.zeta)).exp())

    def g(self, r: Decimal) -> Decimal:
        return 1 - self.logistic(r) * r

    def slope(self, r: Decimal) -> Decimal:
        a = self.logistic(r)
        return -(a + 2 * self.lambda_ * a * (1 - a) * r)

    def curvature(self, r: Decimal) -> Decimal:
        a = self.logistic(r)
        slope = 2 * self.lambda_ * a * (1 - a)
        return -2 * slope * (1 + self.lambda_ * (1 - 2 * a) * r)

    def regular(self, r: Decimal) -> Decimal:
        """-k / g(r) - 1 / (r - r*), the part of d ln|psi| / dr without the pole."""
        return -self.k / self.g(r) - 1 / (r - self.r_star)

    def integral(self, low: Decimal, high: Decimal) -> Decimal:
        half, middle = (high - low) / 2, (high + low) / 2
        return half * sum(w * self.regular(middle + half * t) for t, w in self.rule)

    def integrals(self, edges: list[Decimal]) -> list[Decimal]:
        """Integral of the regular part from r* to every edge."""
        below = max(j for j, r in enumerate(edges) if r < self.r_star)
        values = [Decimal(0)] * len(edges)
        values[below] = -self.integral(edges[below], self.r_star)
        for j in range(below, len(edges) - 1):
            values[j + 1] = values[j] + self.integral(edges[j], edges[j + 1])
        for j in range(below, 0, -1):
            values[j - 1] = values[j] - self.integral(edges[j - 1], edges[j])
        return values

    def root(self, target: Decimal, r: Decimal, edge: Decimal, integral: Decimal) -> Decimal:
        """Solve psi(r) = target by Newton's method from r; `integral` is that from r* to `edge`."""
        for _ in range(12):  # the caller's guess is good: mostly one step
            value = self.psi(r, integral + self.integral(edge, r))
            # psi' = -k psi / g, which tends to -1 at the fixed point
            at_fixed_point = abs(r - self.r_star) <= Decimal(10) ** (-_DIGITS // 2)
            slope = Decimal(-1) if at_fixed_point else -self.k * value / self.g(r)
            step = (target - value) / slope
            r += step
            if abs(step) < Decimal(10) ** (-_DIGITS // 2 + 2):
                break
        return r

    def psi(self, r: Decimal, integral: Decimal) -> Decimal:
        return (self.r_star - r) * integral.exp()


@lru_cache(maxsize=2)
def _gauss_legendre(n: int) -> tuple[tuple[Decimal, Decimal], ...]:
    rule = []
    with mp.workdps(_DIGITS + _GUARD):
        for i in range(n):
            x = mp.cos(mp.pi * (i + mpf(3) / 4) / (n + mpf(1) / 2))
            for _ in range(20):
                p0, p1 = mpf(1), x
                for m in range(2, n + 1):
                    p0, p1 = p1, ((2 * m - 1) * x * p1 - (m - 1) * p0) / m
                derivative = n * (x * p1 - p0) / (x * x - 1)
                step = p1 / derivative
                x -= step
                if abs(step) < mpf(10) ** (2 - _DIGITS):
                    break
            rule.append((_decimal(x), _decimal(2 / ((1 - x * x) * derivative**2))))
    return tuple(rule)


@lru_cache(maxsize=4)
def _interpolation(degree: int) -> tuple[list[Decimal], list[list[Decimal]]]:
    """Chebyshev nodes of a polynomial, and the matrix from values there to its monomial coefficients on [-1, 1]."""
    n = degree + 1
    with mp.workdps(_DIGITS + _GUARD):
        angles = [mp.pi * (2 * i + 1) / (2 * n) for i in range(n)]
        chebyshev = [cheb2poly([0] * m + [1]).tolist() for m in range(n)]  # whole numbers
        matrix = [[mpf(0)] * n for _ in range(n)]
        for m in range(n):
            scale = mpf(1 if m == 0 else 2) / n
            for i, angle in enumerate(angles):
                weight = scale * mp.cos(m * angle)
                for power, c in enumerate(chebyshev[m]):
                    matrix[power][i] += weight * c
        return [_decimal(mp.cos(angle)) for angle in angles], [[_decimal(entry) for entry in row] for row in matrix]


def _decimal(x: mpf) -> Decimal:
    return Decimal(mp.nstr(x, _DIGITS + _GUARD))


def _times(matrix: list[list[Decimal]], values: list[Decimal]) -> list[Decimal]:
    return [sum((a * v for a, v in zip(row, values, strict=True)), Decimal(0)) for row in matrix]


def _polynomial_root(coefficients: list[Decimal], target: Decimal, t: Decimal, low: Decimal, half: Decimal) -> Decimal:
    """Solve p(t) = target by Newton's method and return r = low + half (t + 1); as good as p is."""
    for _ in range(20):
        value, slope = coefficients[-1], Decimal(0)
        for c in coefficients[-2::-1]:
            slope = slope * t + value
            value = value * t + c
        step = (target - value) / slope
        t += step
        if abs(step) < Decimal(10) ** (-_DIGITS // 2 + 2):
            break
    return low + half * (t + 1)
