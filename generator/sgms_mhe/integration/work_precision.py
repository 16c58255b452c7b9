"""Integrators by accuracy: what each leaves of an element's end state and sensitivities, its cost, which to take.

With signals held through a sample and the displacement xi = rho |v| t as the variable, every element obeys one
equation,

    dr/dxi = +-1 - eta(r, c) r,    eta = etaA(r) (1/2 + 1/2 tanh(+-gamma c r)),    c = |v| / v_s

so the error of a scheme depends on its step in xi, the smoothing and c, and not on the axis. It is measured here on
strokes that reverse into each other, from many deflections and at speeds below and beyond the gate: r and its
derivatives in r at the start and in rho, against a converged solution. Substeps of an element then follow from its own
rho: |v| h rho / displacement, rounded up, so samples and the change of sign of v always lie on nodes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.integration.flow_table import flow_applies, gate_ratio
from sgms_mhe.integration.schemes import SCHEMES, Scheme
from sgms_mhe.machine import Friction, Machine, Sampling, runge_kutta_scheme

Array = NDArray[np.float64]

CANDIDATES: Final = (
    *(("flow", displacement) for displacement in (0.02, 0.01, 0.005, 0.0025)),
    *(("rk4", displacement) for displacement in (0.1, 0.03, 0.01, 0.005, 0.0025)),
    *(("bs23", displacement) for displacement in (0.1, 0.02, 0.005)),
    *(("rk2", displacement) for displacement in (0.05, 0.01)),
    ("euler", 0.01),
)
"""(scheme, largest displacement of a step over the deflection scale; of the flow: below its gate's speed)."""
CONVERGED: Final = 0.002
"""Displacement of the Runge-Kutta steps (rk4) that errors are measured against, extrapolated from them and twice it."""
ROUNDING: Final = {"double": 5e-8, "single": 3e-3}
"""What rounding and the approximations of the emitted C leave in the sensitivities whatever the steps."""

SAMPLE: Final = 0.3
STROKES: Final = (8, 7, 5, 4, 3, 2)
"""Strokes that reverse into each other, in samples of SAMPLE deflection scales: through the transition and back, then
less."""
STARTS: Final = (-1.0, -0.85, -0.35, 0.0, 0.45, 0.9)
SPEEDS: Final = (0.1, 0.3, 0.6, 1.0, 100.0)
"""c over that of the gate; the last is far beyond it."""
FLOOR: Final = 1e-9
"""Errors below it are not told apart from those of the converged steps."""

FLOW_EVALUATIONS: Final = 2
"""A jump of the flow costs about as much as two evaluations of the right side with its sensitivities."""
DISPLACEMENT_BESIDE_FLOW: Final = 0.03
"""Of the blocks that a chosen flow leaves to rk4."""
DECADES: Final = 4
"""The mean work is over speeds spread evenly over this many decades up to max_velocity."""


class Errors(NamedTuple):
    """Largest errors of the end state, of d/dchi and of rho d/drho, all over the deflection scale."""

    state: float
    by_state: float
    by_rate: float

    @property
    def largest(self) -> float:
        """The one that a tolerance is compared with."""
        return max(self)


@dataclass(frozen=True)
class Candidate:
    """One integrator of one machine.

    Attributes:
        scheme: its name.
        displacement: largest step over the deflection scale; of the flow, below its gate's speed.
        errors: of an element.
        substeps: of each element's sample at max_velocity; of the flow, of a sample at the gate's speed.
        mean_work, largest_work: right-side evaluations of an interval, all elements, over speeds up to max_velocity and
            at the speed where they are most.
    """

    scheme: str
    displacement: float
    errors: Errors
    substeps: tuple[int, ...]
    mean_work: float
    largest_work: int

    @property
    def settings(self) -> dict[str, str | float]:
        """The integrator's keys in the machine file."""
        return settings(self.scheme, self.displacement)


def settings(scheme: str, displacement: float) -> dict[str, str | float]:
    """The integrator's keys in the machine file for one of `CANDIDATES`."""
    if scheme == "flow":
        return {"scheme": scheme, "displacement": DISPLACEMENT_BESIDE_FLOW, "slow_displacement": displacement}
    return {"scheme": scheme, "displacement": displacement}


def candidates(friction: Friction, sampling: Sampling, precision: str) -> tuple[Candidate, ...]:
    """Every integrator that a machine can have, in the order of `CANDIDATES`."""
    smoothing = friction.smoothed
    zeta, lambda_, gamma = smoothing.zeta, smoothing.lambda_, smoothing.gamma
    gate = gate_ratio(zeta, lambda_, gamma) * friction.stribeck_velocity
    flows = flow_applies(zeta, lambda_, precision) and gate < sampling.max_velocity
    return tuple(
        _candidate(friction, sampling, scheme, displacement, gate)
        for scheme, displacement in CANDIDATES
        if scheme != "flow" or flows
    )


def choose(found: Sequence[Candidate], tolerance: float, precision: str) -> Candidate | None:
    """The candidate of least mean work that keeps the tolerance, the more exact of equals; None where none does."""
    if tolerance < ROUNDING[precision]:
        return None
    fitting = [candidate for candidate in found if candidate.errors.largest <= tolerance]
    return min(fitting, key=lambda candidate: (candidate.mean_work, candidate.errors.largest), default=None)


def table_text(machine: Machine) -> str:
    """The work-precision table of a machine with a tolerance, as its package brings it; the same on every host."""
    integrator = machine.sampling.integrator
    found = candidates(machine.friction, machine.sampling, machine.code.precision)
    lines = [
        f"Work and precision of {machine.name}: tolerance {integrator.tolerance:g}, the chosen integrator marked *",
        "",
        "  scheme  displacement  end state  d/dchi   d/drho   work mean  work at most  substeps of each element",
    ]
    for candidate in found:
        own = integrator.slow_displacement if candidate.scheme == "flow" else integrator.displacement
        mark = "*" if (candidate.scheme, candidate.displacement) == (integrator.scheme, own) else " "
        state, by_state, by_rate = (f"{e:.1e}" if e >= FLOOR else f"<{FLOOR:.0e}" for e in candidate.errors)
        lines.append(
            f"{mark} {candidate.scheme:<6}  {candidate.displacement:>12g}  {state:>9}  {by_state:<7}  {by_rate:<7}  "
            f"{candidate.mean_work:>9.0f}  {candidate.largest_work:>12}  {', '.join(map(str, candidate.substeps))}"
        )
    lines += [
        "",
        "displacement  largest move of a step over the deflection scale; of the flow, below the speed at which its",
        "              gate saturates: beyond it any move is one step in closed form",
        "errors        largest over strokes that reverse into each other, in deflection scales; d/drho times rho;",
        "              those of the steps: arithmetic adds up to "
        f"{ROUNDING['double']:g} in double and {ROUNDING['single']:g} in single precision",
        "work          right-side evaluations of an interval, all elements (a jump of the flow counts as "
        f"{FLOW_EVALUATIONS}): mean",
        f"              over speeds spread over {DECADES} decades up to max_velocity, and where they are most",
        "substeps      of a sample at max_velocity; of the flow, of a sample below its gate's speed",
        "",
    ]
    return "\n".join(lines)


def _candidate(friction: Friction, sampling: Sampling, scheme: str, displacement: float, gate: float) -> Candidate:
    """Count the work of a scheme; `gate` is the speed [m/s] from which the flow takes one jump per sample."""
    rates = [kappa / (nu * friction.coulomb) for kappa, nu in zip(friction.stiffness, friction.fraction, strict=True)]
    stages = len(SCHEMES[runge_kutta_scheme(scheme)].stages)

    def substeps(speed: float) -> tuple[int, ...]:
        fastest = gate if scheme == "flow" else speed
        return tuple(max(1, math.ceil(fastest * sampling.step * rate / displacement)) for rate in rates)

    def work(speed: float) -> int:
        if scheme == "flow" and speed > gate:
            return sampling.samples_per_update * len(rates) * FLOW_EVALUATIONS
        return sampling.samples_per_update * stages * sum(substeps(speed))

    works = [work(sampling.max_velocity * 10.0 ** (-DECADES * k / 60)) for k in range(61)]
    smoothing = friction.smoothed
    return Candidate(
        scheme=scheme,
        displacement=displacement,
        errors=element_errors(smoothing.zeta, smoothing.lambda_, smoothing.gamma, scheme, displacement),
        substeps=substeps(sampling.max_velocity),
        mean_work=sum(works) / len(works),
        largest_work=max(works),
    )


# --- measurement -----------------------------------------------------------------------------------------------------


def element_errors(zeta: float, lambda_: float, gamma: float, scheme: str, displacement: float) -> Errors:
    """Largest errors of one scheme over the strokes, at every sample of them."""
    with np.errstate(over="ignore", invalid="ignore"):  # a step too long for the law diverges
        moved = _strokes(zeta, lambda_, gamma, runge_kutta_scheme(scheme), displacement)
    fine, coarse = (_strokes(zeta, lambda_, gamma, "rk4", factor * CONVERGED) for factor in (1, 2))
    difference = np.abs(moved - (fine + (fine - coarse) / 15.0))
    if scheme == "flow":
        # Beyond the gate it is in closed form.
        difference = difference[:, :, [k for k, share in enumerate(SPEEDS) if share <= 1.0]]
    worst = np.where(np.isfinite(difference), difference, np.inf).max(axis=(0, 2, 3))
    return Errors(*(float(error) for error in worst))


@lru_cache(maxsize=64)
def _strokes(zeta: float, lambda_: float, gamma: float, scheme: str, displacement: float) -> Array:
    """r, dr/dr0 and rho dr/drho at the end of every sample (samples, 3, speeds, starts), in equal steps per sample."""
    gate = gate_ratio(zeta, lambda_, gamma)
    # Where no speed saturates the gate, it turns within 1e-3 of r at the speed that stands for it.
    ratio = np.array(SPEEDS)[:, None] * (gate if math.isfinite(gate) else 1e3 / gamma)
    steps = math.ceil(SAMPLE / displacement)
    h = SAMPLE / steps
    y = np.zeros((3, len(SPEEDS), len(STARTS)))
    y[0], y[1] = STARTS, 1.0
    ends = []
    for stroke, samples in enumerate(STROKES):
        direction = 1.0 if stroke % 2 == 0 else -1.0
        law = _Law(zeta, lambda_, gamma, ratio, direction)
        for _ in range(samples):
            for _ in range(steps):
                y = law.step(SCHEMES[scheme], h, y)
            ends.append(y)
    return np.array(ends)


@dataclass(frozen=True)
class _Law:
    """The slip law of an element in its displacement, moving at c = `ratio` in one direction."""

    zeta: float
    lambda_: float
    gamma: float
    ratio: Array
    direction: float

    def step(self, scheme: Scheme, h: float, y: Array) -> Array:
        """One Runge-Kutta step of (r, dr/dr0, rho dr/drho)."""
        slope, total = np.zeros_like(y), np.zeros_like(y)
        for stage in scheme.stages:
            slope = self.slope(y + stage.a * h * slope)
            total += stage.b * slope
        return y + h * total

    def slope(self, y: Array) -> Array:
        """d/dxi of (r, dr/dr0, rho dr/drho): the time of a step is fixed, so rho enters as a factor of the rate."""
        r = y[0]
        sharpness = self.gamma * self.ratio * self.direction
        low, high = np.tanh(self.lambda_ * (r + self.zeta)), np.tanh(self.lambda_ * (r - self.zeta))
        turn = np.tanh(sharpness * r)
        window, gate = 1.0 - 0.5 * low + 0.5 * high, 0.5 + 0.5 * turn
        d_window = 0.5 * self.lambda_ * (low * low - high * high)
        d_gate = 0.5 * sharpness * (1.0 - turn * turn)
        rate = self.direction - window * gate * r
        d_rate = -window * gate - (d_window * gate + window * d_gate) * r
        return np.array([rate, d_rate * y[1], d_rate * y[2] + rate])
