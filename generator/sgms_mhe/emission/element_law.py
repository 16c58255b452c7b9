"""Constants of the emitted form of the S-GMS law: window and gate as two logistic functions."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sgms_mhe.machine import Machine
from sgms_mhe.model.friction import SATURATED

FARTHEST = 5.0
"""Relative deflection that no element comes near: a level is reached at 1."""


@dataclass(frozen=True)
class ElementLaw:
    """Constants of an element's right side; exponents are powers of two of |r| and r v (docs/emission.md).

    Exponents must stay in range. Either r is held within `farthest`, where the range reaches far beyond every
    deflection there is, and the gate's velocity within `fastest`, beyond which the gate is saturated wherever the
    window is not shut; the two clamps come doubled. Or (`farthest` is 0) both exponents are held within `deepest`,
    where the logistic functions have reached 0 or 1 to rounding.

    Attributes:
        farthest: clamp of |r| [1]; 0: none.
        deepest: largest exponent that matters.
        fastest: clamp of the gate's velocity [m/s].
        window: exponent of the window per |r|, doubled or not.
        offset: exponent of the window at r = 0.
        gate: exponent of the gate per r v [s/m], v doubled or not.
        ln2: d(2^x)/dx at 0.
    """

    farthest: float
    deepest: float
    fastest: float
    window: float
    offset: float
    gate: float
    ln2: float


def element_law(machine: Machine) -> ElementLaw | None:
    """The law's constants; None where the window's own exponent leaves the range of the package's numbers.

    The window depends on |r| alone where its two sides do not overlap (`SATURATED`).
    """
    smoothing, friction = machine.friction.smoothed, machine.friction
    single = machine.code.precision == "single"
    fastest = max(1.0, smoothing.lambda_ / smoothing.gamma)
    per_power = 1.0 / math.log(2.0)
    deepest, largest = (30.0, 125.0) if single else (60.0, 1000.0)
    offset = 2.0 * smoothing.lambda_ * smoothing.zeta * per_power
    farthest = largest / (2.0 * max(smoothing.lambda_, smoothing.gamma * fastest) * per_power)
    if smoothing.lambda_ * smoothing.zeta < SATURATED or offset + deepest > largest:
        return None
    shared = farthest >= FARTHEST
    return ElementLaw(
        farthest=farthest if shared else 0.0,
        deepest=deepest,
        fastest=fastest * friction.stribeck_velocity,
        window=(1.0 if shared else 2.0) * smoothing.lambda_ * per_power,
        offset=offset,
        gate=-(0.5 if shared else 2.0) * smoothing.gamma / friction.stribeck_velocity * per_power,
        ln2=math.log(2.0),
    )
