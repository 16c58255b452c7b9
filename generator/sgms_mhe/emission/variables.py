"""An axis as block diagrams and co-simulations see it: every number of it by name, unit and C expression."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Literal

from sgms_mhe.emission.context import PackageView

Causality = Literal["input", "output", "parameter"]
Kind = Literal["Real", "Integer", "Boolean"]

_EXPONENTS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "m": 'm="1"',
        "m/s": 'm="1" s="-1"',
        "m/s2": 'm="1" s="-2"',
        "N": 'kg="1" m="1" s="-2"',
        "kg": 'kg="1"',
        "rad": 'rad="1"',
        "rad/s": 'rad="1" s="-1"',
        "rad/s2": 'rad="1" s="-2"',
        "N.m": 'kg="1" m="2" s="-2"',
        "kg.m2": 'kg="1" m="2"',
    }
)


@dataclass(frozen=True)
class Variable:
    """One number of an axis.

    Attributes:
        reference: its number among all, from 1; 0 is time.
        name: unique, with dots and indices.
        kind: of number.
        causality: of whom it comes; parameters may change while the axis runs.
        unit: in the notation of FMI; empty where it has none.
        text: what it is.
        code: C expression that reads it, of `self`, an axis with its inputs, and `now`, its estimate.
        start: where it does not come from the estimator.
        least, most: limits, where it has any.
    """

    reference: int
    name: str
    kind: Kind
    causality: Causality
    unit: str
    text: str
    code: str
    start: str | None = None
    least: float | None = None
    most: float | None = None

    @property
    def exponents(self) -> str:
        """Attributes of its unit in SI base units."""
        return _EXPONENTS[self.unit]


def variables_of(view: PackageView) -> tuple[Variable, ...]:
    """All variables of a package's axis, in the order of their references."""
    rows = [*_inputs(view), *_outputs(view), *_estimated(view)]
    return tuple(Variable(number, *row) for number, row in enumerate(rows, 1))


_Row = (
    tuple[str, Kind, Causality, str, str, str]
    | tuple[str, Kind, Causality, str, str, str, str]
    | tuple[str, Kind, Causality, str, str, str, str, float, float]
)


def _inputs(view: PackageView) -> Iterator[_Row]:
    units = view.units
    position, push = "position of the axis, one sample a step", f"drive {units.push}, what was fed forward included"
    yield "position", "Real", "input", _unit(units.position), position, "self->position", "0.0"
    yield units.push, "Real", "input", _unit(units.force), push, f"self->{units.push}", "0.0"
    for name, unit in (("velocity", units.velocity), ("acceleration", units.acceleration)):
        text = f"{name} of the set-point while the answer to this sample acts; read where ahead is true"
        yield f"ahead_{name}", "Real", "input", _unit(unit), text, f"self->ahead_{name}", "0.0"
    yield "ahead", "Boolean", "input", "", "whether the set-point is given", "self->ahead", "false"
    enabled = "true" if view.compensation.enabled else "false"
    on = f"whether the {units.push} to feed forward is on, along its ramp"
    yield "compensate", "Boolean", "parameter", "", on, "self->compensate", enabled
    if not view.signals.mass_in_model:
        mass, what = view.signals.mass, f"{units.inert} that moves, payload included"
        code = f"self->{units.inert}"
        yield units.inert, "Real", "parameter", _unit(units.mass), what, code, repr(mass), mass / 20.0, 20.0 * mass


def _outputs(view: PackageView) -> Iterator[_Row]:
    force = _unit(view.units.force)
    yield "feed_forward", "Real", "output", force, f"{view.units.push} to feed forward", "self->feed_forward"
    for name, unit, text in (
        ("friction", force, "friction at the last update"),
        ("friction_measured", force, "the newest reading of friction"),
        ("innovation", force, "the newest reading minus its prediction"),
        ("test_ratio", "", "square of the innovation over the variance predicted for it"),
        ("noise_scale", "", "factor on the stated standard deviation that the reading was taken with"),
    ):
        yield name, "Real", "output", unit, text, f"(double)now->{name}"
    stated = "status of the last update: 0, a sum of positive flags, or negative: refused"
    yield "status", "Integer", "output", "", stated, "now->status"
    doubt = f"now->status > 0 && (now->status & {view.package.NAME}_DOUBT) != 0"
    yield "doubt", "Boolean", "output", "", "the readings contradict the model beyond their stated noise", doubt


def _estimated(view: PackageView) -> Iterator[_Row]:
    unit = _unit(view.units.position)
    for i in range(view.sizes.elements):
        code = f"(double)now->deflection[{i}]"
        yield f"deflection[{i + 1}]", "Real", "output", unit, f"deflection of element {i + 1}", code
    for field, text in (("parameter", "estimated"), ("deviation", "one standard deviation")):
        for p, name in enumerate(view.model.parameter_columns):
            yield f"{field}.{name}", "Real", "output", "", f"{name}, {text}, SI units", f"(double)now->{field}[{p}]"


def _unit(text: str) -> str:
    """`kg m^2` -> `kg.m2`."""
    return text.replace("^", "").replace(" ", ".")
