"""Motions that variants of an estimator are timed and checked on."""

from typing import Final

import numpy as np

from sgms_mhe.machine import Machine
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import Motion, Trajectory, make_trajectory
from sgms_mhe.signals.logs import Log

SWEEP_PERIOD: Final = 10
"""Intervals in one period of the motion that the sweeps run: windows of every length hold the same motion."""
SWEEP_VELOCITY: Final = 2e-3  # m/s, the paper's


def timed_motion(machine: Machine, name: str, updates: int) -> Trajectory:
    """The motion of a name as long as so many updates take. Raises InputError where there is none."""
    sampling = machine.sampling
    duration = (updates * sampling.samples_per_update + 1) / sampling.rate
    speed = 0.95 * sampling.max_velocity  # the controller overshoots
    return make_trajectory(name, sampling.rate, duration_s=duration, max_velocity=speed)


def simulated_log(machine: Machine, trajectory: str, updates: int) -> Log:
    """Log of the machine's axis in closed loop, as long as so many updates take.

    Raises:
        InputError: no trajectory of that name.
    """
    return simulate_axis(machine, timed_motion(machine, trajectory, updates), AxisConfig(seed=1), truth=False).log


def there_and_back(rate: float, velocity: float) -> Trajectory:
    """A move there and one back at a velocity [m/s] that each keeps for 0.1 s."""
    motion = Motion(rate)
    motion.wait(0.05)
    for target in (0.225 * velocity, 0.0):
        motion.move_to(target, velocity, 10.0 * velocity, 400.0 * velocity)
        motion.wait(0.05)
    return motion.trajectory(f"{velocity:g} m/s")


def swing(machine: Machine, updates: int) -> Trajectory:
    """A sine of `SWEEP_PERIOD` intervals with the paper's top speed over so many updates."""
    sampling = machine.sampling
    phase = (
        2.0
        * np.pi
        * np.arange(updates * sampling.samples_per_update + 1)
        / (SWEEP_PERIOD * sampling.samples_per_update)
    )
    amplitude = min(SWEEP_VELOCITY, sampling.max_velocity) * SWEEP_PERIOD / (2.0 * np.pi * sampling.update_rate)
    return Trajectory("swing", sampling.rate, amplitude * np.sin(phase))
