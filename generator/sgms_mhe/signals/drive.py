"""Commands of a log, as a machine's drive takes them, and the force it makes of them."""

from dataclasses import replace
from itertools import accumulate

import numpy as np

from sgms_mhe.machine import Machine
from sgms_mhe.signals.chain import hold_last
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.errors import InputError


def command_of(log: Log, machine: Machine) -> Array | None:
    """Return the command (n) that a machine's drive takes, [m] or [V], held where it is missing; None: the force is it.

    Raises:
        InputError: no force was recorded, and nothing describes the command.
    """
    drive, units = machine.drive, log.units
    name = next((name for name in drive.columns if getattr(log, name) is not None), None)
    if name is None and np.isnan(log.force_N).all():
        columns = units.keyed(dict.fromkeys(drive.columns or ("force_N",)))
        allowed = f'{" or ".join(columns)}, which [drive] kind = "{drive.kind}" of {machine.name} takes'
        raise InputError(log.source or "log", f"column {units.named('force_N')}", None, allowed)
    if name is None:
        return None
    values = np.ascontiguousarray(hold_last(getattr(log, name)))
    if name == "duty":
        if drive.supply is None:
            raise InputError(log.source or "log", "duty", None, "[drive] supply [V], of which a duty is a share")
        values = values * drive.supply
    return values


def find_force(log: Log, machine: Machine) -> Log:
    """Return a commanded log with the force the machine's drive made, as its package's `drive_force()` finds it.

    The back-EMF goes by the difference of positions, extrapolated by half a sample; commands are held, and late by
    whole samples. The force of a drive that is off is 0. A log with a force is returned as it is.

    Raises:
        InputError: nothing describes the command.
    """
    command, drive = command_of(log, machine), machine.drive
    if command is None or not np.isnan(log.force_N).all():
        return log
    k, resistance = drive.torque_constant or 0.0, drive.resistance or 1.0
    # At a sample the command that it sends has not acted yet.
    late = np.maximum(np.arange(len(log)) - 1 - round(drive.delay * log.rate), 0)
    position, acting = log.position_m, command[late]
    if drive.kind == "position_loop":
        step = (drive.speed_limit or np.inf) / log.rate
        acting = np.array(list(accumulate(acting, lambda at, goal: at + min(max(goal - at, -step), step))))
        share = (drive.gain or 0.0) * (drive.gain_unit or 0.0) * (acting - position)
        acting = (drive.supply or 0.0) * (share + np.clip(drive.STEEP * share, -drive.start, drive.start))
    most = np.inf if drive.clamp is None else drive.clamp * (drive.supply or 0.0)
    known, velocity = np.flatnonzero(np.isfinite(position)), np.zeros(len(log))
    steps = np.diff(known, prepend=known[:1])
    mean = np.diff(position[known], prepend=position[known[:1]]) / np.maximum(steps, 1) * log.rate
    velocity[known] = mean + np.where(steps == 1, 0.5 * np.diff(mean, prepend=0.0), 0.0)  # it is half a sample old
    force = (np.clip(acting, -most, most) - k * velocity) * k / resistance
    on = switched_on(log)
    force = force if on is None else np.where(on > 0.5, force, 0.0)
    return replace(log, force_N=np.where(np.isnan(position), np.nan, force))


def switched_on(log: Log) -> Array | None:
    """Return (n) which says by numbers above 0.5 that a drive is on; None: always."""
    return None if log.enabled is None else np.ascontiguousarray(hold_last(log.enabled))
