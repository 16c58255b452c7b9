"""Plausibility of a log's columns on the machine they are read for.

A log with its columns mixed up, of the other sign, or in a unit that nobody stated, still holds numbers: an estimator
would follow them and say nothing. Implausible measurements are refused here, with the values seen and the key to write.
The limits are far from anything that a real axis, a wrong number of the machine or a coarse encoder would come to.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from sgms_mhe.logfiles.newton import find_inertia, find_sign, since_reversal
from sgms_mhe.machine import QUANTITIES, Kind, Machine, log_line
from sgms_mhe.signals.chain import readings
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.arrays import Array, Mask
from sgms_mhe.support.errors import ImplausibleError, InputError

TOO_FAST: Final = 5.0
"""Of max_velocity: a speed that a twentieth of a record exceeds is no speed of this axis."""
TOO_WEAK: Final = 4.0
"""RMS force that the motion needs over the one that was measured, friction added to it."""
TOO_STRONG: Final = 100.0
"""RMS force that was measured over the one that the motion needs, friction added to it; and the other way round."""
WRONG_SCALE: Final = 20.0
"""Force over acceleration, over the machine's mass: beyond it, or below its inverse, a unit is wrong, not the mass."""
WITHIN_FRICTION: Final = 3.0
"""Of the force that friction takes: no larger forces make a mass that is too large only seem so."""
NEAR: Final = 3.0
"""Within this factor of the machine's mass a unit is a remedy."""
ALIKE: Final = 0.9
"""Correlation with what position says from which a recorded velocity or acceleration is that of this motion."""
APART: Final = 2.0
"""Factor between the two from which its unit or sign is wrong."""
SCALED: Final = 1.1
"""Factor between the two from which it is said: no filter makes as much."""
STRAIGHT: Final = 1e-9
"""Deviation from a line, over the range: less than any measured signal has."""
USUAL: Final = 0.98
"""Share of the nodes that count, those with the smallest accelerations: a few jumps of position are no unit."""
UNSIGNED: Final = 0.02
"""Share of the largest force below which the smallest is nothing: a number without its sign has none to turn."""
INTERVAL: Final = 0.01
"""Seconds over which means are taken where no machine says."""
_TRAVEL: Final = 0.01
"""Of the travel: how far behind a reversal friction has its new direction at the least."""

_MAPPING = "[log] (machine file, --log) says which variable a column is and in what unit"
_SMALL: Final[Mapping[Kind, tuple[str, ...]]] = {"linear": ("mm", "um", "nm"), "rotary": ("deg", "mrad", "urad")}
"""Units that people leave out, the usual one first."""


def check_plausible(log: Log, machine: Machine | None, *, has_mass: bool = True) -> None:
    """Refuse a log this machine's axis, or without one no axis, can have left.

    `has_mass`: whether the machine's mass is known; one found in the log itself says nothing of its force.

    Raises:
        InputError: a column that never changes, or is time or another column.
        ImplausibleError: columns that are swapped, a motion that has nothing to do with the force, a force or a
            recorded velocity of the other sign, a unit that is off by orders of magnitude.
    """
    samples = _samples(log, machine)
    if len(log) <= samples:
        return  # too short to tell, and for most else
    log = readings(log)
    _check_constant(log)
    _check_copies(log)
    motion = _IntervalMeans(log, samples)
    if machine is not None:
        _check_speed(log, machine, motion)
    _check_derivatives(log, samples)
    if len(motion) == 0 or log.is_friction_alone:
        return  # a friction that stands for the force says nothing of what moves the axis
    known = machine if has_mass else None
    _check_balance(log, known, motion)
    if known is not None:
        _check_swapped(log, known, motion)
        _check_force(log, known, motion)


def check_has_force(log: Log) -> None:
    """Refuse a log of commands alone."""
    if log.is_commanded:
        push = log.units.named("force_N")
        allowed = f"{push}, which [log] (machine file, --log) maps; of a command alone predict and identify make use"
        allowed += ", with a [drive] also estimate, compare and tune"
        raise _refusal(log, f"column {push}", None, allowed)


def _units(log: Log, name: str) -> Mapping[str, tuple[float, float]]:
    """Units in which a column may be, with their factors; the column by its name on a linear axis."""
    own = log.units.named(name)
    return next(quantity.units for quantity in QUANTITIES[log.kind] if quantity.column == own)


def _refusal(log: Log, where: str, seen: object, allowed: str) -> InputError:
    return InputError(log.source or "log", where, seen, allowed)


def _implausible(log: Log, where: str, seen: object, allowed: str) -> ImplausibleError:
    return ImplausibleError(log.source or "log", where, seen, allowed)


def _check_constant(log: Log) -> None:
    for name, what in _CHANGING.items():
        values = log.columns[name]
        finite = values[np.isfinite(values)]
        if len(finite) and finite.min() == finite.max():
            raise _refusal(log, f"column {log.units.named(name)}, every row", float(finite[0]), f"{what}; {_MAPPING}")


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
            raise _refusal(log, f"column {log.units.named(name)}", seen, f"no time and no row number; {_MAPPING}")
    if _slope(log.position_m, log.force_N) is not None:
        raise _refusal(log, _both(log), "the same signal", f"two signals; {_MAPPING}")


def _both(log: Log) -> str:
    return f"columns {log.units.named('position_m')} and {log.units.named('force_N')}"


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


def _check_speed(log: Log, machine: Machine, motion: "_IntervalMeans") -> None:
    """Refuse a motion that is too fast for the axis.

    Columns that are swapped have friction that drives the motion: where it does not, the unit is wrong.
    """
    samples, highest, units = machine.sampling.samples_per_update, machine.sampling.max_velocity, machine.plant.units
    position = units.named("position_m")
    fastest = _fastest(log.position_m, samples, log.rate)
    if not fastest > TOO_FAST * highest:
        return
    seen = f"beyond {fastest:.3g} {units.velocity} in a twentieth of the record"
    known = f"sampling.max_velocity of {machine.name} is {highest:g} {units.velocity}"
    inertia, braking = _inertia(motion, machine), _braking(log, motion)
    is_friction = braking > 0 or (braking == 0 and inertia > 0.0)
    if not is_friction and _fastest(log.force_N, samples, log.rate) <= TOO_FAST * highest:
        remedy = _swap(log)
    else:
        # Millimetres and degrees are what people have; the others where only they make the axis slow enough, or its
        # mass the machine's.
        usual, ratio = _SMALL[machine.plant.kind], inertia / machine.plant.moved
        factors = {unit: _units(log, "position_m")[unit][0] for unit in usual}
        slow = [unit for unit in usual if fastest * factors[unit] <= highest] or [usual[0]]
        unit = next((unit for unit in slow if 1 / NEAR <= ratio / factors[unit] <= NEAR), slow[0])
        remedy = f"another column or unit? [log] has {log_line(position, variable='...', unit=unit)}"
    raise _implausible(log, f"column {position}", seen, f"a position in {units.metres}; {known}; {remedy}")


def _swap(log: Log) -> str:
    position, force = log.units.named("position_m"), log.units.named("force_N")
    return f'swapped with {force}? Then [log] has {position} = "{force}" and {force} = "{position}"'


def _check_swapped(log: Log, machine: Machine, motion: "_IntervalMeans") -> None:
    """Refuse columns that say nothing of mass and friction, and are this axis's where each stands for the other."""
    if _inertia(motion, machine) != 0.0 or _braking(log, motion) != 0:
        return
    other = replace(log, position_m=log.force_N, force_N=log.position_m)
    there = _IntervalMeans(other, machine.sampling.samples_per_update)
    inertia, units, moved = _inertia(there, machine), log.units, machine.plant.moved
    if 1.0 / NEAR <= inertia / moved <= NEAR and _braking(other, there) > 0:
        seen = f"no mass and no friction; turned round {inertia:.3g} {units.mass} and friction that brakes"
        allowed = f"a motion and the {units.push} that makes it; {units.named('position_m')} {_swap(log)}"
        raise _implausible(log, _both(log), seen, allowed)


def _fastest(position: Array, samples: int, rate: float) -> float:
    """Mean speed in an interval a twentieth of them exceeds; NaN where there is none without a gap."""
    speed = np.abs(np.diff(position[::samples])) * rate / samples
    speed = speed[np.isfinite(speed)]
    return float(np.quantile(speed, 0.95)) if len(speed) else math.nan


class _IntervalMeans:
    """Means of a log over two intervals around each node, without gaps: position, velocity, acceleration, force (n,).

    The second difference of position over an interval is a mean of the acceleration with triangular weights; so is the
    force here. Over an interval neither noise nor quantisation count for much.
    """

    def __init__(self, log: Log, samples: int) -> None:
        nodes, per_second = log.position_m[::samples], log.rate / samples
        acceleration = np.diff(nodes, n=2) * per_second**2
        mean = triangular_mean(log.force_N, samples)
        sound = np.isfinite(acceleration) & np.isfinite(mean)
        sound[sound] = _is_usual(acceleration[sound])
        self.position, self.velocity = nodes[1:-1][sound], (nodes[2:] - nodes[:-2])[sound] * per_second / 2.0
        self.acceleration, self.force = acceleration[sound], mean[sound]

    @property
    def series(self) -> tuple[Array, Array, Array, Array]:
        """Position, velocity, acceleration, force."""
        return self.position, self.velocity, self.acceleration, self.force

    def __len__(self) -> int:
        return len(self.force)


def _is_usual(values: Array) -> Mask:
    """Mask (n,) of the values that are not among the largest, either way; all where they are equal."""
    sizes = np.abs(values)
    return sizes <= (np.quantile(sizes, USUAL) if len(sizes) else 0.0)


def triangular_mean(values: Array, samples: int) -> Array:
    """Means over two intervals with weights that rise to the node between them, and fall again (nodes - 2,)."""
    count = (len(values) - 1) // samples
    rows = values[: count * samples].reshape(count, samples)
    rise = (np.arange(samples) + 0.5) / samples**2
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(rows[:-1] @ rise + rows[1:] @ rise[::-1])


def _samples(log: Log, machine: Machine | None) -> int:
    return machine.sampling.samples_per_update if machine is not None else max(1, round(INTERVAL * log.rate))


@np.errstate(over="ignore", invalid="ignore")
def _derivative_sizes(log: Log, samples: int) -> dict[str, float]:
    """Sizes of the recorded velocity and acceleration, each over that of the position, where the two are alike."""
    sizes = {}
    per_second, nodes = log.rate / samples, log.position_m[::samples]
    count = (len(log) - 1) // samples
    moved = np.diff(nodes)[:count] * per_second
    for name, expected in (("velocity_m_s", moved), ("acceleration_m_s2", np.diff(nodes, n=2) * per_second**2)):
        recorded = log.columns.get(name)
        if recorded is None:
            continue
        if name == "velocity_m_s":
            mean = recorded[: count * samples].reshape(count, samples).mean(axis=1)
        else:
            mean = triangular_mean(recorded, samples)
        ratio = _size_over(mean, expected)
        if ratio is not None:
            sizes[name] = ratio
    return sizes


def _check_derivatives(log: Log, samples: int) -> None:
    """Refuse a recorded velocity or acceleration whose sign or unit is not that of the recorded position."""
    for name, ratio in _derivative_sizes(log, samples).items():
        if 1.0 / APART <= ratio <= APART:
            continue
        units = [f'unit = "{unit}"' for unit in _units_near(log, name, ratio)]
        remedy = "scale = -1.0" if -APART <= ratio <= -1.0 / APART else next(iter(units), "scale = ...")
        own, position = log.units.named(name), log.units.named("position_m")
        allowed = f'{own} as {position} has it: [log] (machine file, --log) {own} = {{ variable = "...", {remedy} }}'
        raise _implausible(log, f"column {own}", f"{ratio:.3g} times the rate of change of {position}", allowed)


def _size_over(recorded: Array, expected: Array) -> float | None:
    """Return the size of a recorded series over that of the expected one; None where they are not alike."""
    both = np.isfinite(recorded) & np.isfinite(expected)
    both[both] = _is_usual(expected[both])
    recorded, expected = recorded[both], expected[both]
    if len(recorded) < 3 or not np.std(recorded) > 0.0 or not np.std(expected) > 0.0:
        return None
    if not abs(float(np.corrcoef(recorded, expected)[0, 1])) >= ALIKE:
        return None  # noise, a delay, or too large to square: nothing to judge a unit by
    return float(recorded @ expected / (expected @ expected))


def note_speed_scale(log: Log) -> str:
    """Return the sentence on a velocity of another scale than its position's, too close to refuse; or ''."""
    ratio = _derivative_sizes(log, _samples(log, None)).get("velocity_m_s", 1.0)
    if not 1.0 / APART <= ratio <= APART or 1.0 / SCALED <= ratio <= SCALED:
        return ""
    own, position = log.units.named("velocity_m_s"), log.units.named("position_m")
    return f"{own} is {ratio:.3g} times the rate of change of {position}: one of them, or the time, has another scale"


def _units_near(log: Log, name: str, ratio: float) -> list[str]:
    """The units in which a column would be right that is `ratio` times its true value."""
    units = _units(log, name).items()
    return [unit for unit, (factor, _) in units if factor != 1.0 and 1 / NEAR <= ratio * factor <= NEAR]


def _inertia(motion: _IntervalMeans, machine: Machine | None) -> float:
    """Force over acceleration [kg, kg m^2]; of no motion it tells nothing."""
    if len(motion) == 0:
        return 0.0
    distance = _TRAVEL * float(np.ptp(motion.position))
    if machine is not None:
        distance = max(distance, _breakaway(machine))
    return find_inertia(*motion.series, distance)


def _braking(log: Log, motion: _IntervalMeans) -> int:
    """Sign with which friction brakes and the force is explained; 0 where neither is, or the force has no sign."""
    finite = log.force_N[np.isfinite(log.force_N)]
    if len(motion) == 0 or 0.0 <= finite.min() < UNSIGNED * finite.max():
        return 0
    return find_sign(*motion.series)


def _check_balance(log: Log, machine: Machine | None, motion: _IntervalMeans) -> None:
    """Refuse a force of the other sign, or whose ratio to the acceleration is no mass of this axis."""
    inertia = _inertia(motion, machine)
    units = log.units
    position, force = units.named("position_m"), units.named("force_N")
    share = f"{inertia:.3g} {units.force} per {units.acceleration}"
    if inertia <= 0.0 and _braking(log, motion) < 0:
        seen = share if inertia < 0.0 else "drives the motion as no friction does"
        allowed = (
            f"a {units.push} that accelerates the axis the way that {position} counts; of the other sign "
            f"[log] (machine file, --log) has {_scale_force(log, -1.0)}, or the same for {position}"
        )
        raise _implausible(log, f"column {force}", seen, allowed)
    if machine is None or inertia == 0.0:
        return
    ratio = inertia / machine.plant.moved
    if 1.0 / WRONG_SCALE <= ratio <= WRONG_SCALE:
        return
    # On a crawl the controller answers to a disturbance as a spring does, whose force goes with the acceleration too:
    # no wrong unit where friction alone could have taken all of it.
    if ratio > 1.0 and float(np.std(motion.force)) <= WITHIN_FRICTION * _resisting(log, machine):
        return
    moved = f"{machine.plant.moved:g} {units.mass}"
    allowed = f"about plant.{units.inert} of {machine.name}, {moved}; {_remedy(log, machine, ratio)}"
    raise _implausible(log, _both(log), share, allowed)


def _scale_force(log: Log, factor: float) -> str:
    """The line of [log] for a force of `factor` times the scale it was read by."""
    keys = {"variable": "...", "scale": 1.0, **log.force_keys}
    scaled = {key: factor * keys[key] for key in ("scale", "offset") if key in keys}
    return log_line(log.units.named("force_N"), **keys | scaled)


def _breakaway(machine: Machine) -> float:
    """Twice the distance after which the last element slips [m]: the machine's numbers may be wrong."""
    friction = machine.friction
    level = friction.coulomb * (1.0 + friction.stribeck_ratio)
    return 2.0 * max(nu * level / kappa for nu, kappa in zip(friction.fraction, friction.stiffness, strict=True))


def _resisting(log: Log, machine: Machine) -> float:
    """Return the largest friction at the speeds of this log [N]."""
    friction = machine.friction
    fastest = _fastest(log.position_m, machine.sampling.samples_per_update, log.rate)
    return friction.coulomb * (1.0 + friction.stribeck_ratio) + friction.viscous * fastest


def _remedy(log: Log, machine: Machine, ratio: float) -> str:
    """Return the lines to write where force over acceleration is `ratio` times the mass: units, or the force's scale.

    Mass and scale of the force are one number for a log, the mass over the scale.
    """
    fastest = _fastest(log.position_m, machine.sampling.samples_per_update, log.rate)
    highest, found, units = machine.sampling.max_velocity, [], log.units
    position, force = units.named("position_m"), units.named("force_N")
    for unit in _SMALL[log.kind]:
        factor = _units(log, "position_m")[unit][0]
        if 1 / NEAR <= ratio / factor <= NEAR and fastest * factor <= highest:
            found.append(log_line(position, variable="...", unit=unit))
    found += [log_line(force, variable="...", unit=unit) for unit in _units_near(log, "force_N", ratio)]
    found.append(_scale_force(log, float(f"{1.0 / ratio:.3g}")))
    known = f"the log determines {units.inert} over scale alone, {ratio * machine.plant.moved:.3g} {units.mass}"
    return f"[log] (machine file, --log) has {' or '.join(found)}: {known}"


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _check_force(log: Log, machine: Machine, motion: _IntervalMeans) -> None:
    """Refuse a motion this force cannot have made, or a force beyond all that the motion takes.

    A constant force drives an axis, so its RMS counts for the motion; or a load that stands, so its standard deviation
    counts against it. A loss of speed over a log works against friction without one.
    """
    friction, resisting = machine.friction, _resisting(log, machine)
    direction = np.sign(motion.velocity)
    needed = machine.plant.moved * _rms(motion.acceleration)
    path = max(float(np.sum(np.abs(motion.velocity))), math.ulp(0.0))
    coasting = machine.plant.moved * max(-float(motion.acceleration @ motion.velocity), 0.0) / path
    driving, changing = _rms(motion.force), float(np.std(motion.force))
    sliding = since_reversal(motion.position, _breakaway(machine)) > _breakaway(machine)
    rubbing = friction.coulomb * _rms(direction * sliding)

    def fits(length: float = 1.0, strength: float = 1.0) -> bool:
        inertial, taken = length * needed, strength * driving
        is_stopped = rubbing > TOO_STRONG * taken and rubbing > TOO_WEAK * length * coasting
        is_too_weak = inertial > TOO_WEAK * (taken + resisting) or is_stopped
        return not is_too_weak and strength * changing <= TOO_STRONG * (inertial + resisting)

    if fits():
        return
    units = log.units
    lengths, strengths = _units(log, "position_m"), _units(log, "force_N")
    position, force = units.named("position_m"), units.named("force_N")
    small, strong = _SMALL[log.kind], [unit for unit, (factor, _) in strengths.items() if factor != 1.0]
    remedies = [(position, unit) for unit in small if fits(length=lengths[unit][0])][:1]
    remedies += [(force, unit) for unit in strong if fits(strength=strengths[unit][0])]
    lines = [log_line(name, variable="...", unit=unit) for name, unit in remedies]
    seen = (
        f"{needed:.3g} {units.force} rms for plant.{units.inert} = {machine.plant.moved:g} {units.mass} to move so and "
        f"{rubbing:.3g} {units.force} rms for friction.coulomb, {driving:.3g} {units.force} rms measured"
    )
    remedy = f"[log] (machine file, --log) has {' or '.join(lines)}" if lines else _MAPPING
    raise _implausible(log, _both(log), seen, f"a motion and the {units.push} that makes it; {remedy}")
