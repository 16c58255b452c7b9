"""Self-test vectors of a package: a short motion and what the reference solver estimates from it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sgms_mhe.model import Model
from sgms_mhe.reference import estimate_model
from sgms_mhe.signals.chain import settle_samples, signals_from_log
from sgms_mhe.signals.logs import Log

_PERIODS = 2.5


@dataclass(frozen=True)
class Vectors:
    """Numbers, rounded so that every machine prints the same.

    Attributes:
        updates: of the motion.
        position: of its samples [pm].
        force: of its samples [N].
        friction: estimated at each update [N]. largest: of them.
        parameters: estimated at each update [SI].
    """

    updates: int
    position: tuple[int, ...]
    force: tuple[float, ...]
    friction: tuple[float, ...]
    largest: float
    parameters: tuple[tuple[float, ...], ...]


def selftest_vectors(model: Model) -> Vectors:
    """Make the vectors: loops of growing size through presliding, over at least three updates.

    The axis moves through some deflection scales of its softest element; the force is that of a plain Coulomb law, so
    that the estimator has something to disagree with.
    """
    machine = model.machine
    friction, sampling = machine.friction, machine.sampling
    samples = sampling.samples_per_update
    updates = math.ceil((settle_samples(machine) + 1) / samples) + 3
    n = updates * samples + 1
    size = max(nu * friction.coulomb / kappa for nu, kappa in zip(friction.fraction, friction.stiffness, strict=True))
    phase = np.linspace(0.0, 2.0 * math.pi * _PERIODS, n)
    growth = np.linspace(0.0, 1.0, n) ** 2
    position = 0.8 * size * growth * np.sin(phase)
    # Faster than it may be the axis would show nothing but parameters at their bounds.
    fastest = float(np.abs(np.gradient(position)).max()) * sampling.rate
    position *= min(1.0, 0.9 * sampling.max_velocity / fastest)
    # Picometres are whole numbers in a single-precision package's input too.
    position = np.round(position, 12)
    velocity = np.gradient(position) * sampling.rate
    acceleration = np.gradient(velocity) * sampling.rate
    force = np.round(
        machine.plant.moved * acceleration + friction.coulomb * np.tanh(velocity / (0.2 * np.abs(velocity).max())), 9
    )
    log = Log(np.arange(n) / sampling.rate, position, force, sampling.rate, kind=machine.plant.kind)
    kind = machine.estimator.kind
    found = estimate_model(model, signals_from_log(log, machine), kind, compiled=False)
    friction_N = tuple(_round(f) for f in found.friction_N)
    return Vectors(
        updates=updates,
        position=tuple(round(1e12 * float(p)) for p in position),
        force=tuple(float(f) for f in force),
        friction=friction_N,
        largest=max(map(abs, friction_N)),
        parameters=tuple(tuple(_round(p) for p in row) for row in found.parameters),
    )


def _round(value: float) -> float:
    """Eight significant digits: far from the last ones, which depend on the machine."""
    return float(f"{value:.8g}")
