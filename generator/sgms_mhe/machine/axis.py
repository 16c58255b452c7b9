"""Tables [plant] and [friction]: the moving mass, and the law and parameters of its friction."""

from collections.abc import Mapping
from typing import Any, Final, Literal, Self

from pydantic import Field, model_validator

from sgms_mhe.machine.fields import MachineTable, NonNegatives, Positives, quantity, refusal, text
from sgms_mhe.machine.units import OF_KIND, Kind, Units

BASE_PARAMETERS: Final = ("stiffness", "fraction", "coulomb", "viscous", "stribeck_ratio", "stribeck_velocity")
"""Parameters of the base model that can be estimated."""

FASTEST_STRIBECK: Final = 10.0
"""Largest Stribeck velocity of a machine file [m/s, rad/s]."""

SUM_TOLERANCE: Final = 1e-6


class Plant(MachineTable):
    """Moved mass or inertia."""

    kind: Kind = text("what the axis does: moves along, or turns", "linear or rotary", "linear")
    mass: float | None = Field(
        None, gt=0, le=1e6, description="moved mass [kg]; > 0 and <= 1e+06; required of a linear axis"
    )
    inertia: float | None = Field(
        None, gt=0, le=1e6, description="moved inertia [kg m^2]; > 0 and <= 1e+06; required of a rotary axis"
    )

    weight_radius: float | None = Field(
        None, ge=0, le=10, description="radius of gyration of the weights that runs state [m]; default: points"
    )

    @property
    def units(self) -> Units:
        """Return the names of the units of this kind of axis."""
        return OF_KIND[self.kind]

    @property
    def moved(self) -> float:
        """Moved mass [kg], or inertia [kg m^2]; ValueError where there is none."""
        value = self.mass if self.kind == "linear" else self.inertia
        if value is None:
            raise ValueError("a plant has what its kind of axis moves")
        return value

    @model_validator(mode="after")
    def _check(self) -> Self:
        own, other = ("mass", "inertia") if self.kind == "linear" else ("inertia", "mass")
        if getattr(self, own) is None:
            raise refusal(own, None, f"required of a {self.kind} axis: moved {own} [{self.units.mass}], > 0")
        if self.kind == "linear" and self.weight_radius is not None:
            raise refusal("weight_radius", self.weight_radius, "no such key: a weight on an arm turns a rotary axis")
        if getattr(self, other) is not None:
            allowed = f'{own} [{self.units.mass}] of a {self.kind} axis, or kind = "{_OTHER[self.kind]}"'
            raise refusal(other, getattr(self, other), allowed)
        return self


def plant_content(kind: Kind, moved: float) -> dict[str, Any]:
    """[plant] of an axis that moves so much [kg, or kg m^2]."""
    return {"mass": moved} if kind == "linear" else {"kind": kind, "inertia": moved}


_OTHER: Final[dict[Kind, Kind]] = {"linear": "rotary", "rotary": "linear"}


class Smoothing(MachineTable):
    """Smoothing of the slip switches, equation (3); lambda (1 - zeta) = 3.5 leaves 1e-3 of the level."""

    zeta: float = quantity("deflection ratio at which slip sets in", "1", 0.9, gt=0, lt=1)
    lambda_: float = quantity("sharpness of the slip window", "1", 35.0, gt=0, le=1e3, alias="lambda")
    gamma: float = quantity("sharpness of the direction gate", "1", 35.0, gt=0, le=1e3)


class Friction(MachineTable):
    """Law and parameters of friction, one entry per Maxwell-slip element in the arrays."""

    law: Literal["sgms", "switching"] = text(
        "how an element goes over from sticking to slipping", "sgms (smoothed) or switching (at once)", "sgms"
    )
    stiffness: Positives = text(
        "kappa_i, element stiffness [N/m, N m/rad]", "1 to 10 numbers > 0", min_length=1, max_length=10
    )
    fraction: Positives = text("nu_i, share of the Coulomb level [1]", "as many as stiffness, > 0, sum 1")
    micro_viscous: NonNegatives = Field(
        (), description="sigma_i, element damping [N s/m, N m s/rad]; as many as stiffness, >= 0; default 0 each"
    )
    viscous: float = quantity("sigma_v, viscous damping", "N s/m, N m s/rad", 0.0, ge=0, le=1e9)
    coulomb: float = quantity("f_C, Coulomb level", "N, N m", gt=0, le=1e7)
    stribeck_ratio: float = quantity("beta, static over Coulomb level minus one", "1", 0.0, ge=0, le=100)
    stribeck_velocity: float = quantity("v_s, Stribeck velocity", "m/s, rad/s", 1e-3, gt=0, le=FASTEST_STRIBECK)
    smoothing: Smoothing | None = Field(
        default_factory=lambda data: Smoothing() if data.get("law", "sgms") == "sgms" else None,
        description="smoothing of the slip switches, of law sgms alone; default zeta 0.9, 35, 35",
    )

    @property
    def n_z(self) -> int:
        """Number of Maxwell-slip elements."""
        return len(self.stiffness)

    @property
    def mean_break_away(self) -> float:
        """Break-away distance of the elements, their mean by share [m, rad]: comparable whatever their number."""
        return sum(self.coulomb * nu**2 / kappa for nu, kappa in zip(self.fraction, self.stiffness, strict=True))

    @property
    def estimable(self) -> tuple[str, ...]:
        """Names out of BASE_PARAMETERS that can be estimated: 0 is no scale, and one element alone carries all."""
        names = tuple(name for name in BASE_PARAMETERS if getattr(self, name) != 0.0)
        return names if self.n_z > 1 else tuple(name for name in names if name != "fraction")

    @property
    def switches(self) -> bool:
        """Return True if elements go over from sticking to slipping at once."""
        return self.law == "switching"

    @property
    def smoothed(self) -> Smoothing:
        """The smoothing where law is sgms; ValueError where there is none."""
        if self.smoothing is None:
            raise ValueError("the switching law has no smoothing")
        return self.smoothing

    @model_validator(mode="before")
    @classmethod
    def _fill(cls, data: Any) -> Any:
        if (
            isinstance(data, Mapping)
            and "micro_viscous" not in data
            and isinstance(data.get("stiffness"), list | tuple)
        ):
            return {**data, "micro_viscous": [0.0] * len(data["stiffness"])}
        return data

    @model_validator(mode="after")
    def _check(self) -> Self:
        for key in ("fraction", "micro_viscous"):
            values = getattr(self, key)
            if len(values) != self.n_z:
                raise refusal(key, list(values), f"{self.n_z} numbers, as many as stiffness has (here {len(values)})")
        total = sum(self.fraction)
        if abs(total - 1.0) > SUM_TOLERANCE:
            raise refusal("fraction", list(self.fraction), f"fractions that sum to 1 (here {total:.9g})")
        if not self.switches and self.smoothing is None:
            raise refusal("smoothing", None, "a table { zeta, lambda, gamma }, where law is sgms")
        if self.switches and self.smoothing is not None:
            allowed = "no smoothing where law is switching: nothing is smoothed"
            raise refusal("smoothing", self.smoothing.model_dump(by_alias=True), allowed)
        if self.switches and any(self.micro_viscous):
            allowed = "zeros where law is switching: the damping of an element would jump where it breaks away"
            raise refusal("micro_viscous", list(self.micro_viscous), allowed)
        return self
