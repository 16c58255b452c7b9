"""Quantities of a log, linear and rotary, and the units in which a recorded file may hold them.

Where the two kinds of axis differ for a reader of logs: which column a quantity has, and in which SI unit.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Final, Literal, get_args

from sgms_mhe.machine.units import Kind

Command = Literal["goal", "voltage", "duty", "enabled"]
"""Commands of a drive: goal of its position loop, voltage or share of the supply, and if it is on."""
Role = Literal["time", "position", "force", "velocity", "acceleration", "friction", "temperature"] | Command
"""What a quantity is on either kind of axis; the force of a rotary one is its torque."""

REQUIRED: Final[tuple[Role, ...]] = ("time", "position", "force")
"""Quantities that every log has."""

RECORDED: Final = ("A", "mA", "V", "mV", "%")
"""Units of what stands for a force: a scale [N per such a unit, N m per such a unit] makes it one."""

COUNTS: Final = ("counts", "counts/s")
"""Units of an encoder's own: counts_per says how many make a metre, or a revolution."""


@dataclass(frozen=True)
class Quantity:
    """One quantity of a log.

    Attributes:
        role: its meaning.
        column: name of its column, which ends in its SI unit.
        unit: that unit.
        units: SI value = factor * value + shift, for each unit whose factor is known beforehand.
        counted: quantity of `counts_per`, in the SI unit; 0 where the quantity is never counted.
        recorded: units that only a scale turns into this quantity.
    """

    role: Role
    column: str
    unit: str
    units: Mapping[str, tuple[float, float]]
    counted: float = 0.0
    recorded: tuple[str, ...] = field(default=())

    @property
    def allowed(self) -> tuple[str, ...]:
        """Every unit a file may state or `[log]` may give."""
        counts = (COUNTS[1] if self.role == "velocity" else COUNTS[0],) if self.counted else ()
        return (*self.units, *counts, *self.recorded)


def _factors(**factors: float) -> dict[str, tuple[float, float]]:
    return {unit: (factor, 0.0) for unit, factor in factors.items()}


def _over(lengths: Mapping[str, tuple[float, float]], time: str) -> dict[str, tuple[float, float]]:
    return {f"{unit}/{time}": factor for unit, factor in lengths.items()}


_TURN: Final = 2.0 * math.pi
_LENGTHS: Final = _factors(m=1.0, cm=1e-2, mm=1e-3, um=1e-6, nm=1e-9) | {"in": (0.0254, 0.0)}
_ANGLES: Final = _factors(rad=1.0, mrad=1e-3, urad=1e-6, deg=math.pi / 180.0, rev=_TURN)
_FORCES: Final = _factors(N=1.0, mN=1e-3, kN=1e3)
_TORQUES: Final = {"N m": (1.0, 0.0), "mN m": (1e-3, 0.0), "kN m": (1e3, 0.0), "N cm": (1e-2, 0.0)}
_TIME: Final = Quantity("time", "time_s", "s", _factors(s=1.0, ms=1e-3, us=1e-6, ns=1e-9, min=60.0, h=3600.0))
_TEMPERATURE: Final = Quantity(
    "temperature", "temperature_degC", "degC", {"degC": (1.0, 0.0), "K": (1.0, -273.15), "degF": (5 / 9, -160 / 9)}
)
_COMMANDS: Final = (
    Quantity("voltage", "voltage_V", "V", _factors(V=1.0, mV=1e-3)),
    Quantity("duty", "duty", "", {"": (1.0, 0.0), "%": (0.01, 0.0)}),
    Quantity("enabled", "enabled", "", {"": (1.0, 0.0)}),
)
_SLOW_LENGTHS: Final = {"m/min": (1.0 / 60.0, 0.0), "mm/min": (1e-3 / 60.0, 0.0)}
_SLOW_ANGLES: Final = {"rpm": (_TURN / 60.0, 0.0)}

QUANTITIES: Final[Mapping[Kind, tuple[Quantity, ...]]] = {
    "linear": (
        _TIME,
        Quantity("position", "position_m", "m", _LENGTHS, 1.0),
        Quantity("force", "force_N", "N", _FORCES, recorded=RECORDED),
        Quantity("velocity", "velocity_m_s", "m/s", _over(_LENGTHS, "s") | _SLOW_LENGTHS, 1.0),
        Quantity("acceleration", "acceleration_m_s2", "m/s^2", _over(_LENGTHS, "s^2") | {"g": (9.80665, 0.0)}),
        Quantity("friction", "friction_N", "N", _FORCES, recorded=RECORDED),
        _TEMPERATURE,
        Quantity("goal", "goal_m", "m", _LENGTHS, 1.0),
        *_COMMANDS,
    ),
    "rotary": (
        _TIME,
        Quantity("position", "position_rad", "rad", _ANGLES, _TURN),
        Quantity("force", "torque_Nm", "N m", _TORQUES, recorded=RECORDED),
        Quantity("velocity", "velocity_rad_s", "rad/s", _over(_ANGLES, "s") | _SLOW_ANGLES, _TURN),
        Quantity("acceleration", "acceleration_rad_s2", "rad/s^2", _over(_ANGLES, "s^2")),
        Quantity("friction", "friction_Nm", "N m", _TORQUES, recorded=RECORDED),
        _TEMPERATURE,
        Quantity("goal", "goal_rad", "rad", _ANGLES, _TURN),
        *_COMMANDS,
    ),
}
"""Quantities of a log by the kind of the axis, the required ones first."""

BY_COLUMN: Final[Mapping[str, Quantity]] = {
    quantity.column: quantity for quantities in QUANTITIES.values() for quantity in quantities
}
"""Every quantity of either kind by its column."""

COMMANDS: Final = frozenset(name for name, quantity in BY_COLUMN.items() if quantity.role in get_args(Command))
"""Columns of commands: held between their samples, and no measurements."""

_SIGNS: Final = (("µ", "u"), ("μ", "u"), ("²", "^2"), ("**", "^"), ("°C", "degC"), ("°F", "degF"), ("°", "deg"))
_SPELLINGS: Final = {
    **dict.fromkeys(("sec", "secs", "second", "seconds", "Sec", "sek", "Sek", "Sekunden"), "s"),
    **dict.fromkeys(("msec", "millisecond", "milliseconds"), "ms"),
    **dict.fromkeys(("usec", "microsecond", "microseconds"), "us"),
    **dict.fromkeys(("nsec", "nanosecond", "nanoseconds"), "ns"),
    **dict.fromkeys(("metre", "metres", "meter", "meters"), "m"),
    **dict.fromkeys(("millimetre", "millimetres", "millimeter", "millimeters"), "mm"),
    **dict.fromkeys(("micrometre", "micrometres", "micrometer", "micrometers", "micron", "microns"), "um"),
    **dict.fromkeys(("inch", "inches"), "in"),
    **dict.fromkeys(("degree", "degrees", "Deg", "DEG", "Grad"), "deg"),
    **dict.fromkeys(("radian", "radians", "Rad", "RAD"), "rad"),
    **dict.fromkeys(("revs", "revolution", "revolutions", "turn", "turns"), "rev"),
    **dict.fromkeys(("count", "cnt", "cnts", "cts", "inc", "incs", "increment", "increments", "ticks"), "counts"),
    **dict.fromkeys(("rev/min", "1/min", "min^-1", "RPM", "U/min"), "rpm"),
    **dict.fromkeys(("newton", "newtons", "Newton"), "N"),
    **dict.fromkeys(("N-m", "newton meter", "newton meters", "newton metre", "newton metres"), "N m"),
    **dict.fromkeys(("amp", "amps", "ampere", "amperes"), "A"),
    **dict.fromkeys(("volt", "volts"), "V"),
    **dict.fromkeys(("percent", "pct"), "%"),
    **dict.fromkeys(("C", "celsius", "Celsius"), "degC"),
    **dict.fromkeys(("kelvin", "Kelvin"), "K"),
}


@lru_cache(maxsize=65_536)
def normal_unit(text: str) -> str:
    """A unit as this package spells it; an unknown spelling comes back without brackets and doubled spaces.

    'µm', '[um]' and 'micron' are um; 'Nm', 'N·m' and 'N*m' are N m; 'mm/s2' and 'mm s^-2' are mm/s^2.
    """
    unit = text.strip().strip("[](){}<>").strip()
    for sign, plain in _SIGNS:
        unit = unit.replace(sign, plain)
    unit = re.sub(r"\s*(?:[·⋅*]|\.(?!\d))\s*|\s+", " ", unit)
    unit = re.sub(r"\s*/\s*", "/", unit)
    unit = re.sub(r" ?s\^?-1$", "/s", unit) if len(unit) > 3 else unit
    unit = re.sub(r" ?s\^?-2$|/s2$|/s/s$", "/s^2", unit)
    unit = re.sub(r"^(m|k)?N ?(m|cm)$", lambda found: f"{found[1] or ''}N {found[2]}", unit)
    whole, mark, time = unit.partition("/")
    return _SPELLINGS.get(unit) or _SPELLINGS.get(whole, whole) + mark + _SPELLINGS.get(time, time)


_TIMES: Final = re.compile(r"(\d+(?:[.,]\d+)?(?:[eE][+-]?\d+)?)\s*[·*]?\s*([^\W\d_].*|[%°].*)")
"""A number of units: 0.1 ms, 0.001°."""


def split_unit(text: str) -> tuple[float, str]:
    """(number, unit as this package spells it) of '0.001 deg'; the number is 1 where there is none."""
    found = _TIMES.fullmatch(text.strip().strip("[](){}<>").strip())
    return (float(found[1].replace(",", ".")), normal_unit(found[2])) if found else (1.0, normal_unit(text))
