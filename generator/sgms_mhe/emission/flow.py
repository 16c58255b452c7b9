"""The displacement flow as templates see it: its table, and what merged samples ask of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sgms_mhe.machine import Machine
from sgms_mhe.model import FlowTable, flow_table, gate_ratio

LEVEL_CHANGE = 0.0175
"""Change of the level over merged samples, times lambda, up to which an element slides through them at once."""


@dataclass(frozen=True)
class Flow:
    """Constants of the displacement flow of one machine.

    Attributes:
        zeta, lambda_: smoothing that the curve belongs to.
        table: psi and its inverse.
        gate: |v| / v_s above which the gate is saturated.
        gate_velocity: the same speed [m/s].
        level_change: of the level over merged samples, over the level, up to which an element slides through at once.
        farthest: xi from which on exp(-k xi) counts as zero; it is still a normal number.
        phi, d_phi: coefficients of the alternating series of phi(x) and x phi'(x) (docs/integration.md), from x^2 on.
    """

    zeta: float
    lambda_: float
    table: FlowTable
    gate: float
    gate_velocity: float
    level_change: float
    farthest: float
    phi: tuple[float, ...]
    d_phi: tuple[float, ...]


def flow_of(machine: Machine) -> Flow:
    """Constants of a machine whose elements follow the flow.

    Raises:
        InputError: the smoothing is too soft for it.
    """
    smoothing, precision = machine.friction.smoothed, machine.code.precision
    gate = gate_ratio(smoothing.zeta, smoothing.lambda_, smoothing.gamma)
    table = flow_table(smoothing.zeta, smoothing.lambda_, precision, str(machine.source))
    exponent, relaxation = (60.0, 64.0) if precision == "single" else (600.0, 640.0)
    orders = range(2, 9)
    return Flow(
        zeta=smoothing.zeta,
        lambda_=smoothing.lambda_,
        table=table,
        gate=gate,
        gate_velocity=gate * machine.friction.stribeck_velocity,
        level_change=LEVEL_CHANGE / smoothing.lambda_,
        farthest=min(exponent, relaxation / table.k),
        phi=tuple((n - 1.0) / math.factorial(n + 1) for n in orders),
        d_phi=tuple(n * (n - 1.0) / math.factorial(n + 1) for n in orders),
    )
