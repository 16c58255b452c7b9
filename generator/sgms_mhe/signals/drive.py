"""Commands of a log, as a machine's drive takes them."""

from __future__ import annotations

import numpy as np

from sgms_mhe.machine import Machine
from sgms_mhe.signals.chain import hold_last
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.errors import InputError


def command_of(log: Log, machine: Machine) -> Array | None:
    """Return the command (n) that a machine's drive takes, [m] or [V], held where it is missing; None: the force is it.

    Raises:
        InputError: no force was recorded, and nothing says what the command does.
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


def switched_on(log: Log) -> Array | None:
    """Return (n) which says by numbers above 0.5 that a drive is on; None: always."""
    return None if log.enabled is None else np.ascontiguousarray(hold_last(log.enabled))
