"""Motion and commands of a drive's self-test, in whole numbers, and the force that the reference makes of them."""

from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Any

import numpy as np

from sgms_mhe.emission.selftest_motion import round_values
from sgms_mhe.machine import Machine
from sgms_mhe.signals.drive import find_force
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.arrays import Array

FIRST, LENGTH = 16, 48
"""Samples that are compared: before a command has come through, at most, and from then on."""
_FARTHEST = 1e3
"""Of the motion [m, rad], at most."""
_SWING = 4096
"""Counts of the motion's amplitude, at which the loop asks for 1.5 times what it may have."""
_DRAWN = 128
"""A drawn number is at least minus this, and less than this."""


@dataclass(frozen=True)
class DriveVectors:
    """Vectors of the self-test of a drive.

    Attributes:
        forces: at the compared samples [N]; 1e30: none.
        largest: of those that are some [N].
        per_force: command of a force of 1 N [m, V].
        place: count of the motion [pm].
        command: count of the commands, [pm] of goals, [V].
    """

    forces: tuple[float, ...]
    largest: float
    per_force: float
    place: int
    command: float


def drive_vectors(machine: Machine) -> DriveVectors | None:
    """Make the vectors: goals or voltages that differ from sample to sample, beyond the clamp too, with gaps of both.

    None of a machine whose command is a force.
    """
    drive, rate, clamp = machine.drive, machine.sampling.rate, machine.drive.clamp or 1.0
    if drive.kind == "force":
        return None
    bare = drive.model_copy(update={"start": 0.0, "clamp": None, "speed_limit": None, "delay": 0.0})
    still, k = np.zeros(3), drive.torque_constant or 0.0
    slope = _find_forces(replace(machine, drive=bare), still, np.array([0.0, 1.0, 1.0]), still + 1.0)[2]
    if drive.kind == "voltage":
        volts = 1.5 * clamp * (drive.supply or k * machine.sampling.max_velocity)
        # With a back-EMF of a quarter of it: an eighth of the amplitude to a sample.
        far, command, unit = min(2.0 * volts / (k * rate), _FARTHEST), volts / _DRAWN, 1.0
    else:
        far = min(1.5 * clamp / ((drive.gain or 0.0) * (drive.gain_unit or 0.0)), _FARTHEST)
        most = 1.5 * drive.speed_limit / rate if drive.speed_limit else 0.25 * far
        command, unit = max(1, round(1e12 * most / _DRAWN)), 1e-12
    late, place = round(drive.delay * rate), max(1, round(1e12 * far / _SWING))
    sample = np.arange(late + LENGTH)
    states = accumulate(range(2 * len(sample)), lambda state, _: (1664525 * state + 1013904223) % 2**32, initial=1)
    moved, drawn = np.array([(state >> 24) - _DRAWN for state in states])[1:].reshape(-1, 2).T
    position = (4 * _DRAWN * (abs(sample % 48 - 24) - 12) + moved) * place * 1e-12
    commands, on = drawn * command * unit, np.ones(len(sample))
    position[late + np.array([5, 20, 21, 22])], commands[[10, 30, 31]], on[late + 40 : late + 42] = np.nan, np.nan, 0.0
    forces = _find_forces(machine, position, commands, on)
    compared = round_values(np.nan_to_num(np.append(forces[: min(late, FIRST)], forces[late:]), nan=1e30))
    return DriveVectors(compared, float(np.nanmax(np.abs(forces))), 1.0 / slope, place, command)


def _find_forces(machine: Machine, position: Array, commands: Array, on: Array) -> Array:
    """Return the force (n) [N] of commands, from the first one on."""
    rate, none = machine.sampling.rate, np.full(len(on), np.nan)
    columns: dict[str, Any] = {machine.drive.columns[0]: commands, "enabled": on}
    log = Log(np.arange(len(on)) / rate, position, none, rate, kind=machine.plant.kind, **columns)
    return find_force(log, machine).force_N
