"""Numbers as an engineer writes them: a unit, a prefix that suits the size, digits as the uncertainty allows."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Final

from sgms_mhe.machine import LINEAR, Units
from sgms_mhe.machine.units import is_ratio, suffix_of
from sgms_mhe.model.effects import base_number
from sgms_mhe.support.numbers import SIGMAS
from sgms_mhe.support.statements import Statement

_PREFIXES: Final = {
    "m": ((1.0, "m"), (1e-3, "mm"), (1e-6, "µm"), (1e-9, "nm")),
    "s": ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs")),
    "m/s": ((1.0, "m/s"), (1e-3, "mm/s"), (1e-6, "µm/s")),
    "N": ((1.0, "N"), (1e-3, "mN"), (1e-6, "µN")),
    "N/m": ((1e6, "N/µm"), (1e3, "N/mm"), (1.0, "N/m")),
    "rad/s": ((1.0, "rad/s"), (1e-3, "mrad/s"), (1e-6, "µrad/s")),
    "N m": ((1.0, "N m"), (1e-3, "mN m"), (1e-6, "µN m")),
    "N m/rad": ((1e6, "N m/µrad"), (1e3, "N m/mrad"), (1.0, "N m/rad")),
}
_FORCES: Final = ("N", "N m")
_axis: ContextVar[Units] = ContextVar("axis", default=LINEAR)
_RAISED: Final = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
MINUS: Final = "\N{MINUS SIGN}"
SPACE: Final = "\N{NO-BREAK SPACE}"
"""Between a number and its unit."""


@contextmanager
def use_units(units: Units) -> Iterator[None]:
    """Write the following text in the units of one kind of axis."""
    token = _axis.set(units)
    try:
        yield
    finally:
        _axis.reset(token)


def axis_units() -> Units:
    """Units of the axis reported on."""
    return _axis.get()


def force_suffix() -> str:
    """Return the text behind a force: its unit, and the space before it."""
    return f"{SPACE}{_axis.get().force}"


@dataclass(frozen=True)
class PrintedValue:
    """A quantity ready to print: `value`, `spread` (two standard deviations, empty where unknown) and `unit`."""

    value: str
    spread: str
    unit: str

    def __str__(self) -> str:
        number = f"{self.value}{SPACE}±{SPACE}{self.spread}" if self.spread else self.value
        return f"{number}{SPACE}{self.unit}".rstrip()


def split_name(name: str) -> tuple[str, str]:
    """(words, unit) of a parameter's name on a linear axis: `amplitude_N` -> ("amplitude", "N"), or "N m"."""
    units, number = _axis.get(), base_number(name)
    own = name + number.suffix if number is not None else name
    stem = name if number is not None else units.named(name).removesuffix(suffix_of(units.named(name)))
    unit = units.unit(own)
    return stem.replace("_", " "), unit or ("%" if is_ratio(name) else "")


def quantity(name: str, value: float, std: float = math.nan) -> PrintedValue:
    """A parameter's value with two standard deviations, in the unit its name ends in."""
    _, unit = split_name(name)
    return reading(value, unit, std)


def stated(statement: Statement, value: float | None = None) -> PrintedValue:
    """A statement's value with two standard deviations, or another value in its unit."""
    unit = statement.unit or ("%" if is_ratio(statement.about) else "")
    return reading(statement.value, unit, statement.std) if value is None else reading(value, unit)


def reading(value: float, unit: str, std: float = math.nan) -> PrintedValue:
    """A value in SI (a ratio in units of one) with two standard deviations."""
    if not math.isfinite(value):
        return PrintedValue("–", "", "")
    factor, shown = scaled_unit(value if value != 0.0 else SIGMAS * std, unit)
    number, spread = value / factor, SIGMAS * std / factor
    if not math.isfinite(spread) or spread <= 0.0:
        return PrintedValue(plain(number), "", shown)
    # Two digits of the spread, but no more than six of the value.
    least = min(spread, abs(number) or spread)
    decimals = 1 - math.floor(math.log10(spread))
    if number != 0.0:
        decimals = min(decimals, 5 - math.floor(math.log10(abs(number))))
    if spread > 1e4 * least:
        return PrintedValue(plain(number), plain(spread, 2), shown)
    decimals = max(0, decimals)
    return PrintedValue(_fixed_point(number, decimals), _fixed_point(spread, decimals), shown)


def scaled_unit(value: float, unit: str) -> tuple[float, str]:
    """(factor, unit) that a value in SI (a ratio in units of one) is written in: value / factor, unit."""
    if unit == "%":
        return 0.01, unit
    if unit == "rad":
        return math.pi / 180.0, "°"
    return _prefix(value, unit) if unit in _PREFIXES else (1.0, unit)


def plain(number: float, digits: int = 3) -> str:
    """A number with so many digits, without an exponent where it can be read without one."""
    if not math.isfinite(number):
        return "–"
    if number == 0.0:
        return "0"
    power = math.floor(math.log10(abs(number)))
    if -4 <= power < 7:
        return _fixed_point(number, max(0, digits - 1 - power))
    return _minus(f"{number:.{digits - 1}e}".replace("e-0", "e-").replace("e+0", "e"))


def force(newton: float) -> str:
    """A force in N, or a torque in N m, with three digits, to a thousandth: those of one report are to be compared."""
    if not math.isfinite(newton):
        return "–"
    decimals = sum(abs(newton) < limit for limit in (0.9995, 9.995, 99.95))
    return f"{_fixed_point(newton, decimals)}{force_suffix()}"


def percent(share: float) -> str:
    """A share as percent."""
    return "–" if not math.isfinite(share) else f"{_fixed_point(100.0 * share, 0 if abs(share) >= 0.1 else 1)}{SPACE}%"


def probability(p: float) -> str:
    """A p-value in words of numbers: nobody needs more than its order."""
    if not math.isfinite(p):
        return "–"
    if p >= 0.01:
        return f"{p:.2f}"
    if p < 1e-12:
        return "< 10⁻¹²"
    digit, power = f"{p:.0e}".split("e")
    return f"{digit}·10⁻{str(-int(power)).translate(_RAISED)}"


def _prefix(value: float, unit: str) -> tuple[float, str]:
    size = abs(value)
    for factor, shown in _PREFIXES[unit]:
        # Forces of a report are to be compared: a tenth of a newton stays one.
        if size >= (0.01 if unit in _FORCES else 0.9995) * factor:
            return factor, shown
    return _PREFIXES[unit][-1 if size > 0.0 else 0]


def _fixed_point(number: float, decimals: int) -> str:
    text = f"{number:.{decimals}f}"
    return _minus("0" if text.strip("-0.") == "" and decimals == 0 else text)


def _minus(text: str) -> str:
    return text.replace("-", MINUS)
