"""The plant's C side: `runtime_c/axis.c`, `axis_effects.c` compiled; one axis, its true parameters by name."""

import ctypes
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import Any, Final

import numpy as np

from sgms_mhe.machine import Drive, Friction, Machine, Plant, Smoothing
from sgms_mhe.model.effects import EffectParameter, Value, effect_definition, effect_names
from sgms_mhe.plant.axis_config import CONTROLS, LAWS, MAX_SUBSTEPS, SUBSTEP_S, AxisConfig, Controller
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.paths import runtime_dir
from sgms_mhe.support.toolchain import load_library, shared_library

SOURCES: Final = ("axis.c", "axis_drive.c", "axis_effects.c")
DRIVES: Final = ("voltage", "position_loop")
"""enum axis_drive of the C, from 1 on."""
DRIVE: Final = {"gain_unit": "loop_gain", "start": "loop_start", "delay": "command_delay"}
"""Settings of the C by keys of [drive], where they have other names."""
_HISTORY: Final = 4096
_RESONANT: Final = 0.5
"""AXIS_HISTORY and RESONANT of the C."""

_NO_MASS, _LONG_DELAY, _FAST_RESONANCE = -2, -3, -4
"""enum axis_refusal; the other one cannot happen to a machine and a config that are valid."""

COMPENSATION = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_void_p, ctypes.c_double, ctypes.c_double)
"""C signature of a compensation: (context, measured position [m], measured force [N]) -> force to add [N]."""


OUTSIDE_FORCE = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_double)
"""C signature of a force that the plant does not know: (context, position [m], velocity [m/s], time [s]) -> [N]."""


@dataclass(frozen=True)
class NativeCompensation:
    """A compensation in C: no interpreter in between, so that the axis runs at full speed and can be interrupted.

    Attributes:
        function: a `COMPENSATION`.
        context: its first argument; its maker keeps the pointed-to data alive.
    """

    function: Any
    context: int


HiddenEffect = tuple[str, Mapping[str, Value]]
"""Name and parameters of an effect that the machine file does not have."""

Compensation = Callable[[float, float], float] | NativeCompensation
"""Called each sample with measured position [m] and force [N]; returns the force [N] to add."""


LOG_COLUMNS = ("position_m", "force_N")
TRUTH_COLUMNS = (
    "true_position_m",
    "true_velocity_m_s",
    "true_acceleration_m_s2",
    "true_force_N",
    "true_friction_N",
    "true_effect_force_N",
)
_DOUBLES = ctypes.POINTER(ctypes.c_double)


class _Record(ctypes.Structure):
    """struct axis_record."""

    _fields_ = tuple((name, ctypes.c_void_p) for name in (*LOG_COLUMNS, *TRUTH_COLUMNS, "true_deflection_m"))


@dataclass(frozen=True)
class Library:
    """The compiled plant and its tables."""

    c: ctypes.CDLL
    settings: Mapping[str, tuple[int, int]]
    effects: Mapping[str, tuple[str, ...]]

    def has_table(self, effect: str) -> bool:
        """Return True if an effect the plant knows takes the list that is its last parameter whole."""
        return bool(self.c.axis_effect_has_table(list(self.effects).index(effect)))


@lru_cache(maxsize=1)
def loaded_library() -> Library:
    """The plant, compiled once and kept. Raises BuildError where the compiler refuses."""
    c = load_library(shared_library([runtime_dir() / name for name in SOURCES], libraries=("m",)))
    size, text, number, axis = ctypes.c_size_t, ctypes.c_char_p, ctypes.c_double, ctypes.c_void_p
    signatures: dict[str, tuple[Any, list[Any]]] = {
        "axis_size": (size, []),
        "axis_setting": (text, [size, ctypes.POINTER(size), ctypes.POINTER(size)]),
        "axis_effect_name": (text, [size]),
        "axis_effect_parameter": (text, [size, size]),
        "axis_effect_has_table": (ctypes.c_int, [size]),
        "axis_init": (None, [axis, ctypes.c_uint64]),
        "axis_set": (None, [axis, size, number]),
        "axis_add_effect": (ctypes.c_int, [axis, size, _DOUBLES]),
        "axis_add_force": (ctypes.c_int, [axis, OUTSIDE_FORCE, ctypes.c_void_p]),
        "axis_set_effect": (None, [axis, size, size, number]),
        "axis_set_table": (None, [axis, size, _DOUBLES, size]),
        "axis_set_compensation": (None, [axis, COMPENSATION, ctypes.c_void_p]),
        "axis_apply": (ctypes.c_int, [axis]),
        "axis_place": (None, [axis, number]),
        "axis_run": (size, [axis, ctypes.c_void_p, size, size, size, ctypes.POINTER(_Record)]),
        "axis_start": (None, [axis, number, number, number]),
        "axis_follow": (None, [axis, ctypes.c_void_p, ctypes.c_void_p, size, size, size, ctypes.c_void_p]),
        "axis_enable": (None, [axis, ctypes.c_void_p]),
    }
    for name, (result, arguments) in signatures.items():
        function = getattr(c, name)
        function.restype, function.argtypes = result, arguments

    settings: dict[str, tuple[int, int]] = {}
    offset, count = size(), size()
    while (name := c.axis_setting(len(settings), ctypes.byref(offset), ctypes.byref(count))) is not None:
        settings[name.decode()] = (offset.value, count.value)
    effects: dict[str, tuple[str, ...]] = {}
    while (name := c.axis_effect_name(len(effects))) is not None:
        own: list[str] = []
        while (parameter := c.axis_effect_parameter(len(effects), len(own))) is not None:
            own.append(parameter.decode())
        effects[name.decode()] = tuple(own)
    return Library(c, settings, effects)


@dataclass(frozen=True)
class Limits:
    """Limits of a number: the machine file's own limits hold for true values too."""

    low: float
    high: float
    allowed: str
    with_low: bool = True
    with_high: bool = True

    def hold(self, value: float) -> bool:
        """Return True if a value lies within."""
        above = value >= self.low if self.with_low else value > self.low
        below = value <= self.high if self.with_high else value < self.high
        return above and below and math.isfinite(value)


def _to_all(senders: Sequence[Callable[[float], None]], value: float) -> None:
    for send in senders:
        send(value)


def _send_product(send: Callable[[float], None], factor: float, value: float) -> None:
    send(factor * value)


def effect_limits(parameter: EffectParameter) -> Limits:
    """Return the limits of an effect's parameter."""
    return Limits(parameter.lower, parameter.upper, parameter.allowed)


@lru_cache(maxsize=1)
def base_limits() -> Mapping[str, Limits]:
    """Limits of mass and friction parameters by their key in the machine file, an array's for each entry."""
    limits = {}
    for table in (Plant, Friction, Smoothing, Drive):
        for name, key in table.model_json_schema()["properties"].items():
            spec = key.get("items", key.get("anyOf", [key])[0])  # what may be left out is a number or nothing
            if spec.get("type") != "number":
                continue
            least, most = spec.get("minimum", -math.inf), spec.get("maximum", math.inf)
            above, below = spec.get("exclusiveMinimum", -math.inf), spec.get("exclusiveMaximum", math.inf)
            allowed = f"{'>' if above >= least else '>='} {max(least, above):g} and "
            allowed += f"{'<' if below <= most else '<='} {min(most, below):g}"
            limits[name] = Limits(max(least, above), min(most, below), allowed, least > above, most < below)
    return limits


@dataclass
class _Parameter:
    """One true number of the plant: its value before drift, its setter, its limits."""

    name: str
    value: float
    send: Callable[[float], None] = field(repr=False)
    limits: Limits

    def assign(self, value: float) -> None:
        """Send a value to the plant, or refuse it."""
        if not self.limits.hold(value):
            raise InputError("simulation", self.name, value, self.limits.allowed)
        self.send(value)


class NativeAxis:
    """One `struct axis` and its true parameters by name."""

    def __init__(self, machine: Machine, config: AxisConfig, hidden_effects: Sequence[HiddenEffect]) -> None:
        self._library = loaded_library()
        self._c = self._library.c
        self._memory = ctypes.create_string_buffer(self._c.axis_size())
        self._c.axis_init(self._memory, config.seed)
        self._numbers: dict[str, _Parameter] = {}
        self._arrays: dict[str, int] = {}
        self._compensation: Any = None
        self._kept: list[Any] = []  # functions that the C side holds
        self._failures: list[str] = []  # of forces in Python, which cannot pass through it
        self._prescribed = config.control == "prescribed"

        friction, limits = machine.friction, base_limits()
        # Of a machine file that says nothing of it: for a plant that obeys the other law.
        smoothing = friction.smoothing or Smoothing()
        plant = {"mass": machine.plant.moved} | smoothing.model_dump(by_alias=True)
        plant |= {
            name: getattr(friction, name) for name in ("viscous", "coulomb", "stribeck_ratio", "stribeck_velocity")
        }
        for name, value in plant.items():
            self._declare(name, value, self._setting(name), limits[name])
        for name in ("stiffness", "fraction", "micro_viscous"):
            values = getattr(friction, name)
            self._arrays[name] = len(values)
            for i, value in enumerate(values):
                self._declare(f"{name}_{i + 1}", value, self._setting(name, i), limits[name])
        fixed = self._fixed_parameters(machine, config)
        for name, value in fixed.items():
            self._setting(name)(value)
        if config.control == "command":
            self._declare_drive(machine.drive, limits)
        self._substep_s = 1.0 / (fixed["rate"] * fixed["substeps"])
        seen: Counter[str] = Counter()
        for effect, values in [*((e.name, e.parameters) for e in machine.effects), *hidden_effects]:
            seen[effect] += 1
            if effect in effect_names() and machine.plant.kind not in (kinds := effect_definition(effect).kinds):
                allowed = f"one for a {machine.plant.kind} axis; this is for {' or '.join(kinds)} ones"
                raise InputError("simulation", "effect", effect, allowed)
            self._add_effect(effect, effect if seen[effect] == 1 else f"{effect}_{seen[effect]}", values)

    def _declare_drive(self, drive: Drive, limits: Mapping[str, Limits]) -> None:
        """Set numbers of the drive; its numbers are `drive.KEY`."""
        self._setting("drive")(DRIVES.index(drive.kind) + 1)
        for key, value in drive.model_dump(exclude={"kind", "gain"}, exclude_none=True).items():
            send = self._setting(DRIVE.get(key, key))
            if key == "gain_unit":
                send = partial(_send_product, send, drive.gain or 0.0)
            self._declare(f"drive.{key}", value, send, limits[key])

    @staticmethod
    def _fixed_parameters(machine: Machine, config: AxisConfig) -> dict[str, float]:
        rate, mass = machine.sampling.rate, machine.plant.moved
        controller = config.controller or Controller.pid(mass, config.bandwidth_Hz or min(80.0, rate / 40.0))
        needed = math.ceil(1.0 / (rate * SUBSTEP_S) - 1e-9)
        own = "maxwell_slip" if machine.friction.switches else "sgms"
        return {
            "law": LAWS.index(config.law or own),
            "control": CONTROLS.index(config.control),
            "rate": rate,
            "substeps": config.substeps or min(needed, MAX_SUBSTEPS),
            "elements": len(machine.friction.stiffness),
            "proportional_gain": controller.proportional,
            "integral_gain": controller.integral,
            "derivative_gain": controller.derivative,
            "derivative_filter": controller.filter_Hz,
            "velocity_feedforward": controller.velocity_feedforward,
            "acceleration_feedforward": controller.acceleration_feedforward_kg,
            "feedforward_lead": controller.feedforward_lead_s,
            "current_loop_lag": 1.0 / (2.0 * math.pi * config.current_loop_Hz),
            "max_force": config.max_force_N if math.isfinite(config.max_force_N) else 0.0,
            "encoder_resolution": config.encoder_resolution_m,
            "encoder_noise": config.encoder_noise_m,
            "force_noise": config.force_noise_N,
        }

    def replace(self, name: str, value: float | Sequence[float]) -> None:
        """Give a parameter its true value."""
        for parameter, number in self._address(name, value):
            parameter.value = number
            parameter.assign(number)

    def scale(self, name: str, factor: float | Sequence[float]) -> None:
        """Multiply a parameter's true value."""
        for parameter, number in self._address(name, factor):
            parameter.value *= number
            parameter.assign(parameter.value)

    def drift(self, multipliers: Mapping[str, float]) -> None:
        """Let parameters be their true value times a multiplier, until the next call."""
        factors: dict[int, tuple[_Parameter, float]] = {}
        for name, multiplier in multipliers.items():
            for parameter, number in self._address(name, multiplier):
                factors[id(parameter)] = (parameter, factors.get(id(parameter), (parameter, 1.0))[1] * number)
        for parameter, factor in factors.values():
            parameter.assign(parameter.value * factor)
        self._apply()

    def compensate(self, compensation: Compensation | None) -> None:
        """Add a force to the controller's at every sample."""
        if compensation is None:
            return
        context = None
        if isinstance(compensation, NativeCompensation):
            self._compensation, context = compensation.function, compensation.context
        elif isinstance(compensation, COMPENSATION):
            self._compensation = compensation
        else:
            self._compensation = COMPENSATION(lambda _, position, force: compensation(position, force))
        self._c.axis_set_compensation(self._memory, self._compensation, context)

    def enable(self, on: Array | None) -> None:
        """Say at which samples of its commands (n) the drive is on: above 0.5; None: always."""
        self._kept.append(on)
        self._c.axis_enable(self._memory, None if on is None else on.ctypes.data)

    def place(self, position: float) -> None:
        """Put the axis at rest."""
        self._apply()
        self._c.axis_place(self._memory, position)

    def run(self, reference: Array, start: int, count: int, columns: Mapping[str, Array]) -> None:
        """Run `count` samples from `start`; fill the rows of the columns (a deflection's row has n_z entries)."""
        n = len(reference)
        rows = {name: column.ctypes.data + start * (column.nbytes // n) for name, column in columns.items()}
        done = self._c.axis_run(self._memory, reference.ctypes.data, n, start, count, ctypes.byref(_Record(**rows)))
        if done < count:
            stable = "parameters with which the position loop is stable; this axis runs away beyond 4e6 m or 1e9 N"
            allowed = f"a `plant_force`; {self._failures[0]}" if self._failures else stable
            raise InputError("simulation", f"sample {start + done}", None, allowed)

    def limits(self, name: str) -> tuple[float, float]:
        """Return the limits of a true number."""
        limits = self._numbers[name].limits
        return limits.low, limits.high

    def number(self, name: str) -> float:
        """Return a true number."""
        return self._numbers[name].value

    def follow(self, position: Array, driving: Array, start: int, end: int) -> Array:
        """Follow a measured motion under a logged force, or a command: all states become those at sample `end`.

        Returns:
            Acceleration the force would make (end - start) [m/s^2], half a sample before each.
        """
        acceleration = np.empty(end - start)
        args = (position.ctypes.data, driving.ctypes.data, len(driving), start, end - start, acceleration.ctypes.data)
        self._c.axis_follow(self._memory, *args)
        return acceleration

    def run_free(self, force: Array, start: int, end: int, position: float, velocity: float, strain: float) -> Array:
        """Return positions a logged force or command makes of samples `start` to `end`, and be as before.

        Args:
            force: logged (n) [N], or the command [m or V] where the axis is commanded.
            start, end: samples.
            position, velocity: at the first of them [m, m/s].
            strain: added to every element's, over its break-away.

        Returns:
            Positions (end - start) [m]; NaN from where the axis ran away.
        """
        before, positions = self._memory.raw, np.full(end - start, math.nan)
        self._c.axis_start(self._memory, position, velocity, strain)
        record = _Record(position_m=positions.ctypes.data)
        args = (force.ctypes.data, len(force), start, end - start, ctypes.byref(record))
        positions[self._c.axis_run(self._memory, *args) :] = math.nan
        ctypes.memmove(self._memory, before, len(before))
        return positions

    def _apply(self) -> None:
        refusal = self._c.axis_apply(self._memory)
        if refusal:
            longest = (_HISTORY - 2) * self._substep_s
            where, allowed = {
                _NO_MASS: ("mass", "a mass of which effects leave a positive part"),
                _LONG_DELAY: (
                    "force_delay.delay_s",
                    f"{0.0 if self._prescribed else -longest:g} to {longest:g} s in all",
                ),
                _FAST_RESONANCE: (
                    "structural_resonance.frequency_Hz",
                    f"at most {_RESONANT / (2.0 * math.pi * self._substep_s):.6g} Hz at this sample rate",
                ),
            }[refusal]
            raise InputError("simulation", where, self._numbers[where].value, allowed)

    def _setting(self, name: str, i: int = 0) -> Callable[[float], None]:
        offset, _ = self._library.settings[name]
        return partial(self._c.axis_set, self._memory, offset + i)

    def _declare(self, name: str, value: float, send: Callable[[float], None], limits: Limits) -> None:
        self._numbers[name] = parameter = _Parameter(name, value, send, limits)
        parameter.assign(value)

    def _add_effect(self, effect: str, label: str, values: Mapping[str, Value]) -> None:
        names = self._library.effects.get(effect)
        if names is None:
            self._add_outside_force(effect, label, values)
            return
        if effect == "actuator_lag" and self._prescribed:
            raise InputError("simulation", "effect", effect, 'control "position": no force makes a prescribed motion')
        definition = effect_definition(effect)
        try:
            numbers = {p.name: p.default for p in definition.parameters if p.is_optional} | definition.entries(values)
        except KeyError:
            numbers = {}
        if set(numbers) != set(definition.names(numbers)):
            raise InputError("simulation", f"parameters of {effect}", sorted(values), f"exactly {', '.join(names)}")
        kind = list(self._library.effects).index(effect)
        # Of most lists the plant knows one entry: as many effects as they have.
        count = max(sum(definition.parameter(name).holds(entry) for entry in numbers) for name in names)
        senders: dict[str, list[Callable[[float], None]]] = {entry: [] for entry in numbers}
        has_table = self._library.has_table(effect)
        for i in range(1, 2 if has_table else count + 1):
            own = [definition.parameter(name).entry(i) for name in names]
            row = (ctypes.c_double * len(own))(*(numbers[entry] for entry in own))
            index = self._c.axis_add_effect(self._memory, kind, row)
            if index < 0:
                raise InputError("simulation", "effect", effect, "no more effects than the plant has room for")
            for j, entry in enumerate(own):
                senders[entry].append(partial(self._c.axis_set_effect, self._memory, index, j))
        if has_table:
            table = (ctypes.c_double * count)()
            self._kept.append(table)
            self._c.axis_set_table(self._memory, index, table, count)
            entries = [definition.parameter(names[-1]).entry(i) for i in range(1, count + 1)]
            senders |= {entry: [partial(table.__setitem__, i)] for i, entry in enumerate(entries)}
        for entry, number in numbers.items():
            limits = effect_limits(definition.parameter(entry))
            self._declare(f"{label}.{entry}", number, partial(_to_all, senders[entry]), limits)

    def _add_outside_force(self, effect: str, label: str, values: Mapping[str, Value]) -> None:
        """An effect the plant does not know, by the force its definition brings for it."""
        definition = effect_definition(effect) if effect in effect_names() else None
        force = definition.plant_force if definition is not None else None
        if definition is None or force is None:
            known = f"one of {', '.join(self._library.effects)}, or one that brings a `plant_force`"
            raise InputError("simulation", "effect", effect, known)
        names = [parameter.name for parameter in definition.parameters]
        if set(values) != set(names):
            raise InputError("simulation", f"parameters of {effect}", sorted(values), f"exactly {', '.join(names)}")
        numbers = definition.entries(values)

        def at(_: int | None, position: float, velocity: float, time: float) -> float:
            try:
                return float(force(position, velocity, time, numbers))
            except Exception as error:  # no exception passes through C; the run ends as with an unstable loop
                self._failures.append(f"{effect}: {type(error).__name__}: {error}")
                return math.nan

        native = OUTSIDE_FORCE(at)
        self._kept.append(native)
        if self._c.axis_add_force(self._memory, native, None) < 0:
            raise InputError("simulation", "effect", effect, "no more effects than the plant has room for")
        for name, number in [*numbers.items()]:
            send = partial(numbers.__setitem__, name)
            self._declare(f"{label}.{name}", number, send, effect_limits(definition.parameter(name)))

    def _address(self, name: str, value: float | Sequence[float]) -> list[tuple[_Parameter, float]]:
        names = [f"{name}_{i + 1}" for i in range(self._arrays[name])] if name in self._arrays else [name]
        if any(entry not in self._numbers for entry in names):
            raise InputError("simulation", "parameter", name, f"one of {', '.join([*self._arrays, *self._numbers])}")
        values = [float(value)] * len(names) if isinstance(value, int | float) else [float(entry) for entry in value]
        if len(values) != len(names):
            raise InputError("simulation", name, list(values), f"a number, or {len(names)} of them")
        if not all(math.isfinite(entry) for entry in values):
            raise InputError("simulation", name, value, "finite")
        return list(zip((self._numbers[entry] for entry in names), values, strict=True))
