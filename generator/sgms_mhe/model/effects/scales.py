"""The sizes a machine sets: units of effects, which know no machine themselves."""

from dataclasses import dataclass
from typing import Literal

Unit = Literal["one", "coulomb", "damping", "stiffness", "mass", "step", "deflection"]


@dataclass(frozen=True)
class Scales:
    """Sizes of a machine, SI.

    Attributes:
        coulomb: f_C [N].
        damping: sigma_v, or f_C over the maximum speed where there is none [N s/m].
        stiffness: sum of kappa_i [N/m].
        mass: that moves [kg].
        step: time between samples [s].
        deflection: of the element that breaks away last, nu_i f_C / kappa_i [m].
        least_deflection: of the one that breaks away first [m].
        speed: the machine's largest [m/s].
    """

    coulomb: float
    damping: float
    stiffness: float
    mass: float
    step: float
    deflection: float
    least_deflection: float
    speed: float

    @property
    def coulomb_over_speed(self) -> float:
        """Damping that makes f_C at the largest speed [N s/m]."""
        return self.coulomb / self.speed

    def of(self, unit: Unit) -> float:
        """Size of a unit [SI]; `one` is 1."""
        return 1.0 if unit == "one" else float(getattr(self, unit))
