"""Whether a log's columns can be what they are called, on the machine that they are read for.

A log with its columns mixed up, or in a unit that nobody stated, still holds numbers: an estimator would follow them
and say nothing. What no axis can have measured is refused here, with what was seen and what to write. The limits are
far from anything that a real axis, a wrong number of the machine or a coarse encoder would come to.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.machine import Machine
from sgms_mhe.signals.chain import readings
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import InputError

Array = NDArray[np.float64]

TOO_FAST: Final = 5.0
"""Of max_velocity: a speed that a twentieth of a record exceeds is no speed of this axis."""
TOO_WEAK: Final = 4.0
"""RMS force that the motion needs over the one that was measured, friction added to it."""
TOO_STRONG: Final = 100.0
"""RMS force that was measured over the one that the motion needs, friction added to it."""
STRAIGHT: Final = 1e-9
"""Deviation from a line, over the range: less than any measured signal has."""

_MAPPING = "[log] of the machine file says which variable a column is and in what unit"


def check_plausible(log: Log, machine: Machine) -> None:
    """Refuse a log that this machine's axis cannot have left.

    Raises:
        InputError: a column that never changes, a column that is time or another column, columns that are swapped, or a
            motion that has nothing to do with the force.
    """
    if len(log) <= machine.sampling.samples_per_update:
        return  # too short to tell, and for most else
    log = readings(log)
    _check_constant(log)
    _check_copies(log)
    _check_motion(log, machine)


def _check_constant(log: Log) -> None:
    for name, what in _CHANGING.items():
        values = log.columns[name]
        finite = values[np.isfinite(values)]
        if len(finite) and finite.min() == finite.max():
            raise InputError(log.source or "log", f"column {name}, every row", float(finite[0]), f"{what}; {_MAPPING}")


_CHANGING: Final = {
    "position_m": "a position that changes: without motion there is nothing to learn",
    "force_N": "a force that changes: what moves an axis does",
}
"""What is wanted of columns that no motion leaves constant."""


def _check_copies(log: Log) -> None:
    """Refuse columns that are time, a row number, or one another."""
    for name, values in (("position_m", log.position_m), ("force_N", log.force_N)):
        slope = _slope(log.time_s, values)
        # A motion at constant speed is straight too; but not at just one metre per second, or per row.
        steps = (1.0, 1e3, 1e6, 1e9, log.rate)
        if slope is not None and (name == "force_N" or any(math.isclose(slope, s, rel_tol=1e-6) for s in steps)):
            seen = f"grows by {slope:.6g} every second"
            raise InputError(log.source or "log", f"column {name}", seen, f"no time and no row number; {_MAPPING}")
    if _slope(log.position_m, log.force_N) is not None:
        raise InputError(
            log.source or "log", "columns position_m and force_N", "the same signal", f"two signals; {_MAPPING}"
        )


def _slope(x: Array, y: Array) -> float | None:
    """Slope of y over x where y is a line in x; None where it is not."""
    both = np.isfinite(x) & np.isfinite(y)
    if both.sum() < 3:
        return None
    x, y = x[both] - x[both][0], y[both] - y[both][0]
    last = int(np.argmax(np.abs(x)))
    if x[last] == 0.0:
        return None
    slope = float(y[last] / x[last])
    return slope if float(np.max(np.abs(y - slope * x))) <= STRAIGHT * float(np.ptp(y)) else None


def _check_motion(log: Log, machine: Machine) -> None:
    """Refuse a motion that is too fast for the axis, or that this force cannot have made."""
    speed = _speed(log.position_m, machine)
    limit = TOO_FAST * machine.sampling.max_velocity
    if not len(speed):
        return
    fastest = float(np.quantile(speed, 0.95))
    if fastest > limit:
        seen = f"beyond {fastest:.3g} m/s in a twentieth of the record"
        known = f"sampling.max_velocity of {machine.name} is {machine.sampling.max_velocity:g} m/s"
        other = _speed(log.force_N, machine)
        if len(other) and float(np.quantile(other, 0.95)) <= limit:
            remedy = 'swapped with force_N? Then [log] has position_m = "force_N" and force_N = "position_m"'
        else:
            remedy = 'another column or unit? [log] has position_m = { variable = "...", unit = "mm" }'
        raise InputError(log.source or "log", "column position_m", seen, f"a position in metres; {known}; {remedy}")
    inertia, force = _newton(log, machine)
    if not len(inertia):
        return
    friction = machine.friction
    resisting = friction.coulomb * (1.0 + friction.stribeck_ratio) + friction.viscous * fastest
    needed, measured = float(np.sqrt(np.mean(inertia**2))), float(np.std(force))
    if needed > TOO_WEAK * (measured + resisting) or measured > TOO_STRONG * (needed + resisting):
        raise InputError(
            log.source or "log",
            "columns position_m and force_N",
            f"{needed:.3g} N rms for plant.mass = {machine.plant.mass:g} kg to move so, {measured:.3g} N rms measured",
            f"a motion and the force that makes it; {_MAPPING}",
        )


def _nodes(values: Array, machine: Machine) -> Array:
    """Values once per interval of the estimator: over one, neither noise nor quantisation count for much."""
    return values[:: machine.sampling.samples_per_update]


def _speed(position: Array, machine: Machine) -> Array:
    """Mean speed in every interval without a gap [m/s]."""
    speed = np.abs(np.diff(_nodes(position, machine))) * machine.sampling.update_rate
    return np.asarray(speed[np.isfinite(speed)])


def _newton(log: Log, machine: Machine) -> tuple[Array, Array]:
    """Mass times acceleration and measured force [N], both as the same mean over two intervals; without gaps.

    The second difference of position over an interval is a mean of the acceleration with triangular weights.
    """
    samples = machine.sampling.samples_per_update
    count = (len(log) - 1) // samples
    second = np.diff(_nodes(log.position_m, machine), n=2) * machine.sampling.update_rate**2
    rows = log.force_N[: count * samples].reshape(count, samples)
    rise = (np.arange(samples) + 0.5) / samples**2
    force = rows[:-1] @ rise + rows[1:] @ rise[::-1]
    both = np.isfinite(second) & np.isfinite(force)
    return machine.plant.mass * second[both], np.asarray(force[both])
