"""Hidden causes: their parameters, drawn and brought to the size that a draw asks for.

The size of a cause is the force it adds to the measured friction along the motion, exceeded in a fiftieth of the log,
over the Coulomb level: for a ripple its amplitude, for what acts after reversals only what it reaches there.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from sgms_bench.diagnosis.specimens import SPECIMENS, WRONG_NUMBERS, Scene, log_uniform
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import BASE_CAUSES, effect_definition
from sgms_mhe.model.scales import scales_of
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import Trajectory
from sgms_mhe.signals.chain import Signals, signals_from_log

Array = NDArray[np.float64]
Values = dict[str, float]
LEAST_SIZE: Final = 0.05
"""Sizes from here on count in the rates; smaller ones show where finding ends."""


@dataclass(frozen=True)
class Hidden:
    """One hidden cause: `parameters` of an effect, or `factors` on base parameters; its size, the share to be seen."""

    name: str
    parameters: Mapping[str, float] = field(default_factory=dict)
    factors: Mapping[str, float] = field(default_factory=dict)
    size: float = math.nan
    visible: float = math.nan


_SATURATION: Final = 40.0  # how far x may go from its start


def sized_cause(
    machine: Machine, motion: Trajectory, plain: Signals, name: str, size: float, random: Generator
) -> tuple[Hidden, Array] | None:
    """A cause whose force has that size, and the force; None where it cannot be had."""
    friction = machine.friction
    numbers: Values = {}
    for number in (number for base in BASE_CAUSES.values() for number in base.numbers):
        values = getattr(friction, number.name)
        columns = number.columns(friction.n_z)
        numbers |= dict(zip(columns, values if number.array else (values,), strict=True))
    scene = Scene(
        scales=scales_of(machine),
        numbers=numbers,
        cutoff=machine.sampling.velocity_cutoff,
        travel=float(np.ptp(motion.position_m)),
        speed=float(np.abs(motion.velocity_m_s).max()),
        seconds=motion.duration_s,
        random=random,
    )
    if name in BASE_CAUSES:
        return _wrong_number(machine, motion, plain, name, scene, size)
    specimen = SPECIMENS.get(name)
    if specimen is None:
        return None
    parameters, x = specimen.draw(scene), 1.0
    goal = size * friction.coulomb
    hidden, force, peak = Hidden(name), plain.friction, 0.0
    for _ in range(5):
        hidden = Hidden(name, _is_allowed_size(name, parameters(x)))
        force = prescribed_signals(machine, motion, hidden).friction - plain.friction
        peak = peak_force(force)
        if peak > 0.0 and abs(peak / goal - 1.0) < 0.1:
            break
        x = min(_SATURATION, x * min(10.0, max(0.1, goal / max(peak, 1e-12))))
    if not 0.5 < peak / goal < 2.0:
        return None
    return replace(hidden, size=peak / machine.friction.coulomb), force


def _is_allowed_size(name: str, values: Mapping[str, float]) -> Values:
    known = {key: effect_definition(name).parameter(key) for key in values}
    return {key: min(max(value, known[key].lower), known[key].upper) for key, value in values.items()}


def _wrong_number(
    machine: Machine, motion: Trajectory, plain: Signals, name: str, scene: Scene, size: float
) -> tuple[Hidden, Array] | None:
    """A wrong number that changes the force by that size, and the change; None where the machine has none."""
    drawn = WRONG_NUMBERS[name](scene, size)
    if drawn is None:
        return None
    factors, elements = Values(), len(machine.friction.stiffness)
    for number in BASE_CAUSES[name].numbers:
        columns = number.columns(elements)
        if number.name in drawn:
            factors |= dict.fromkeys(columns, drawn[number.name])
        factors |= {column: drawn[column] for column in columns if column in drawn}
    hidden = Hidden(name, factors=factors)
    force = prescribed_signals(machine, motion, hidden).friction - plain.friction
    return replace(hidden, size=peak_force(force) / machine.friction.coulomb), force


def prescribed_signals(machine: Machine, motion: Trajectory, hidden: Hidden) -> Signals:
    """Signals of an axis that follows the motion exactly, without noise."""
    specimen = SPECIMENS.get(hidden.name)
    logged = specimen.logged if specimen is not None else None
    effects = [(hidden.name, hidden.parameters)] if hidden.parameters and logged is None else []
    config = AxisConfig(control="prescribed", encoder_resolution_m=0.0, force_noise_N=0.0, substeps=2)
    log = simulate_axis(machine, motion, config, hidden_effects=effects, scale=hidden.factors, truth=False).log
    if logged is not None:
        log = replace(log, force_N=logged(log.force_N, machine.sampling.step, hidden.parameters))
    return signals_from_log(log, machine)


def peak_force(force: Array) -> float:
    """Return the force that is exceeded in a fiftieth of the log, the start left out."""
    return float(np.quantile(np.abs(force[len(force) // 50 :]), 0.98))


def draw_size(random: Generator, least: float = 0.02) -> float:
    """Over the Coulomb level: a quarter of the draws below `LEAST_SIZE`, unless all have to be larger."""
    if least < LEAST_SIZE and random.uniform() < 0.2:
        return log_uniform(random, least, LEAST_SIZE)
    return log_uniform(random, max(least, 1.15 * LEAST_SIZE), 0.5)
