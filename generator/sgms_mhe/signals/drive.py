"""Commands of a log, and the force that a drive makes of them along the measured motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.machine import Machine
from sgms_mhe.signals.chain import hold_last
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import InputError

Array = NDArray[np.float64]


def command_of(log: Log, machine: Machine) -> Array | None:
    """Return the command (n) that a machine's drive takes, [m] or [V], held where it is missing; None without one."""
    name = next((name for name in machine.drive.columns if getattr(log, name) is not None), None)
    if name is None:
        return None
    values = np.ascontiguousarray(hold_last(getattr(log, name)))
    if name == "duty":
        if machine.drive.supply is None:
            raise InputError(log.source or "log", "duty", None, "[drive] supply [V], of which a duty is a share")
        values = values * machine.drive.supply
    return values


def switched_on(log: Log) -> Array | None:
    """Return (n) which says by numbers above 0.5 that a drive is on; None: always."""
    return None if log.enabled is None else np.ascontiguousarray(hold_last(log.enabled))


def fill_force(log: Log, machine: Machine) -> Log:
    """Return a log without a force with the one that the drive makes of its command along the measured motion.

    Raises:
        InputError: nothing says what the command does.
    """
    if np.isfinite(log.force_N).any():
        return log
    drive, units, command = machine.drive, log.units, command_of(log, machine)
    if command is None or drive.torque_constant is None or drive.resistance is None:
        columns = units.keyed(dict.fromkeys(drive.columns or ("force_N",)))
        allowed = f'{" or ".join(columns)}, which [drive] kind = "{drive.kind}" of {machine.name} takes'
        raise InputError(log.source or "log", f"column {units.named('force_N')}", None, allowed)
    late = np.clip(np.arange(len(log)) - drive.delay * log.rate, 0.0, None)
    k = late.astype(int)
    if drive.kind == "position_loop" and drive.supply and drive.gain and drive.gain_unit:
        goal = command[k] if drive.speed_limit is None else _limit(command, drive.speed_limit / log.rate, late)
        volts = drive.supply * drive.gain * drive.gain_unit * (goal - log.position_m)
    else:
        volts = command[k]
    if drive.clamp is not None and drive.supply is not None:
        volts = np.clip(volts, -drive.clamp * drive.supply, drive.clamp * drive.supply)
    velocity = np.gradient(log.position_m) * log.rate
    force = (volts - drive.torque_constant * velocity) * drive.torque_constant / drive.resistance
    on = switched_on(log)
    return replace(log, force_N=force if on is None else np.where(on[k] > 0.5, force, 0.0))


def _limit(goal: Array, most: float, late: Array) -> Array:
    """Return a goal (n) held between samples that goes to its place by `most` a sample, at times `late` [samples]."""
    reached = [float(goal[0])]
    for wanted in goal[:-1].tolist():
        reached.append(reached[-1] + min(max(wanted - reached[-1], -most), most))
    k = late.astype(int)
    here = np.array(reached)[k]
    return np.asarray(here + np.clip(goal[k] - here, -most * (late - k), most * (late - k)))
