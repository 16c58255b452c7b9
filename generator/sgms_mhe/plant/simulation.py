"""Simulated axis: a machine's plant in a closed position loop, written apart from the symbolic model.

`runtime_c/axis.c` integrates the equations of motion and both friction laws with the effects of `axis_effects.c`; they
share nothing with the model that estimators are generated from. Forces that oppose the drive count positive, as
friction does:

    mass * acceleration = drive force - friction - sum of the effects' forces
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import Value
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.native import LOG_COLUMNS, TRUTH_COLUMNS, Compensation, NativeAxis
from sgms_mhe.plant.trajectories import Trajectory
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.notebooks import Presentation, Shown

Drift = Callable[[float], float]
"""Multiplier of a true parameter over time [s]; see `linear_drift`."""

_EMPTY: Final[Mapping[str, Any]] = MappingProxyType({})


@dataclass(frozen=True)
class Truth:
    """True signals no sensor sees, at the log's samples.

    position [m], velocity [m/s], acceleration [m/s^2], force on the mass [N], friction of the law [N], sum of the
    effects' forces [N]: (n); deflection z [m]: (n, n_z). mass a = force - friction - effect_force with the mass that
    moves (a structural resonance hangs part of it on a spring). Under prescribed motion the velocity is that of the
    sample that ends at each instant.
    """

    time_s: Array
    position_m: Array
    velocity_m_s: Array
    acceleration_m_s2: Array
    force_N: Array
    friction_N: Array
    effect_force_N: Array
    deflection_m: Array


@dataclass(frozen=True, repr=False)
class SimulatedRun(Shown):
    """A simulated log, the mass [kg] of the machine file, the truth behind the log (None where not asked for)."""

    log: Log
    mass: float
    truth: Truth | None = None

    def _shown(self) -> Presentation:
        return self.log._shown()[0], (), ()


def linear_drift(relative: float, duration_s: float) -> Drift:
    """Multiplier that goes from 1 to 1 + `relative` over `duration_s` and stays there."""
    return lambda t: 1.0 + relative * min(max(t / duration_s, 0.0), 1.0)


def simulate_axis(
    machine: Machine,
    trajectory: Trajectory,
    config: AxisConfig | None = None,
    *,
    parameters: Mapping[str, float | Sequence[float]] = _EMPTY,
    scale: Mapping[str, float | Sequence[float]] = _EMPTY,
    drift: Mapping[str, Drift] = _EMPTY,
    drift_block_s: float = 0.01,
    hidden_effects: Sequence[tuple[str, Mapping[str, Value]]] = (),
    compensation: Compensation | None = None,
    truth: bool = True,
) -> SimulatedRun:
    """Move a machine's axis along a trajectory and log its sensors.

    The true parameters are the machine's, then `parameters` replace, then `scale` multiplies them, then `drift`
    multiplies them over time, constant in blocks of `drift_block_s`. Their names: mass, stiffness, stiffness_1, ...,
    fraction, micro_viscous, viscous, coulomb, stribeck_ratio, stribeck_velocity, zeta, lambda, gamma, and
    `effect.parameter` (`effect_2.parameter` for the second of its name). An array's name alone means all its entries.

    Args:
        machine: the axis; its effects are part of the plant.
        trajectory: the reference, at the machine's sample rate.
        config: the rest; default AxisConfig().
        parameters: true values in SI units.
        scale: true over nominal.
        drift: multipliers over time.
        drift_block_s: how long a drifting parameter stays constant [s].
        hidden_effects: (name, parameters) of effects the plant has and the machine file does not know.
        compensation: called each sample with measured position [m] and force [N]; its force [N] adds to the
            controller's. A `NativeCompensation` is called without the interpreter in between.
        truth: record it; a long run without takes a third of the memory.

    Returns:
        The log from time 0 on, one row per sample of the trajectory, and the truth.

    Raises:
        InputError: a name, a rate or a number that does not fit, or an axis its controller cannot hold.
    """
    if not math.isclose(trajectory.rate, machine.sampling.rate, rel_tol=1e-9):
        allowed = f"the machine's sampling.rate, {machine.sampling.rate:g} Hz"
        raise InputError(trajectory.name, "rate", trajectory.rate, allowed)
    config, loop = config or AxisConfig(), machine.drive.kind
    if loop != "force" and config.control == "position":  # its own loop, whose goal the reference is
        if loop == "voltage":
            allowed = "force or position_loop: a reference is a motion, which no voltage says"
            raise InputError("simulation", "[drive] kind", loop, allowed)
        config = replace(config, control="command", current_loop_Hz=math.inf)
    axis = NativeAxis(machine, config, hidden_effects)
    for name, value in parameters.items():
        axis.replace(name, value)
    for name, value in scale.items():
        axis.scale(name, value)
    axis.compensate(compensation)

    reference = np.ascontiguousarray(trajectory.position_m, dtype=np.float64)
    n, n_z = len(reference), len(machine.friction.stiffness)
    columns = {name: np.empty(n) for name in LOG_COLUMNS}
    if truth:
        columns |= {name: np.empty(n) for name in TRUTH_COLUMNS} | {"true_deflection_m": np.empty(n * n_z)}

    # Even without drift the interpreter is back every second of the axis, so that a long run can be interrupted.
    block = max(1, round((drift_block_s if drift else 1.0) * trajectory.rate))
    axis.place(reference[0])
    for start in range(0, n, block):
        if drift:
            axis.drift({name: multiplier(start / trajectory.rate) for name, multiplier in drift.items()})
        axis.run(reference, start, min(block, n - start), columns)

    time = np.arange(n) / trajectory.rate
    log = Log(
        time_s=time,
        position_m=columns["position_m"],
        force_N=columns["force_N"],
        goal_m=reference if machine.drive.kind == "position_loop" else None,
        rate=trajectory.rate,
        source=f"simulated {machine.name}, {trajectory.name}",
        kind=machine.plant.kind,
    )
    if not truth:
        return SimulatedRun(log, machine.plant.moved)
    known = {name.removeprefix("true_"): columns[name] for name in TRUTH_COLUMNS}
    deflection = columns["true_deflection_m"].reshape(n, n_z)
    return SimulatedRun(log, machine.plant.moved, Truth(time_s=time, deflection_m=deflection, **known))
