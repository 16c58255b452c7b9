"""Time of a model that is periodic in it: kept within one period, it has its digits however long an axis runs."""

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Final

import casadi as ca

from sgms_mhe.emission.graph import Graph, Node, frontier, to_sx, walk
from sgms_mhe.emission.structure import Structure

MOST_TURNS: Final = {"single": 10_000, "double": 100}
"""Of the fastest sine in the period that all have in common. Of more, single precision loses the phase; in double
precision the increment's rounding then costs more after a year, 9e-9 periods, than that of time that goes on."""
PHASE_ERROR: Final = 1e-6
"""Of a sine in single precision, per turn in the period [rad]: time and argument are rounded, 2 pi 2^-24 each."""
DENOMINATOR: Final = 1_000_000
"""Frequencies are fractions of hertz with at most such a denominator."""


@dataclass(frozen=True)
class Clock:
    """Time within one period, from the count of samples.

    Attributes:
        period: that all sines of the model have in common [s].
        increment: of a sample, in 2^-64 periods, modulo 2^64.
        shift: bits of the 64 that the number type cannot hold.
        unit: of the rest [s].
        phase_error: largest error of a sine's phase in single precision [rad].
    """

    period: float
    increment: int
    shift: int
    unit: float
    phase_error: float


def clock_of(structure: Structure) -> Clock | None:
    """The clock of a model that reads the time in sines of fixed frequency alone; None of any other."""
    machine = structure.model.machine
    frequencies = _frequencies(structure)
    if not frequencies:
        return None
    common = Fraction(math.gcd(*(f.numerator for f in frequencies)), math.lcm(*(f.denominator for f in frequencies)))
    if max(frequencies) / common > MOST_TURNS[machine.code.precision]:
        return None
    bits = 24 if machine.code.precision == "single" else 53
    turns = common / Fraction(machine.sampling.rate)
    return Clock(
        period=float(1 / common),
        increment=round(turns * 2**64) % 2**64,
        shift=64 - bits,
        unit=float(1 / (common * 2**bits)),
        phase_error=PHASE_ERROR * float(max(frequencies) / common),
    )


def _frequencies(structure: Structure) -> list[Fraction] | None:
    """Frequencies [Hz] of all sines in time; None where time is read otherwise."""
    model = structure.model
    vectors = {"chi": model.chi, "x": model.x, "w": model.w, "theta": model.theta}
    labels = {name: [f"{name}{k}" for k in range(vector.numel())] for name, vector in vectors.items()}
    labels["w"] = list(model.signal_names)
    graph = Graph()
    nodes = graph.read(ca.vertcat(model.rhs, model.output, model.feed_forward), vectors, labels)
    time = graph.input("w", "time")
    found = frontier(nodes, lambda node: node is time or _frequency(node, time) is not None)
    return None if time in found else [f for node in found if (f := _frequency(node, time)) is not None]


def _frequency(node: Node, time: Node) -> Fraction | None:
    """Frequency of a sine whose argument is affine in time; None where it is not, or is none of a few digits."""
    inputs = [n for n in walk([node]) if n.op == "input"]
    if node.op not in ("sin", "cos") or time not in inputs:
        return None
    symbols = {n: ca.SX.sym(n.label) for n in inputs}
    slope = ca.simplify(ca.gradient(to_sx(node.args, symbols)[0], symbols[time]))
    if not slope.is_constant():
        return None
    exact = abs(float(slope)) / (2.0 * math.pi)
    frequency = Fraction(exact).limit_denominator(DENOMINATOR)
    return frequency if frequency > 0 and abs(float(frequency) - exact) <= 1e-15 * exact * 4 else None
