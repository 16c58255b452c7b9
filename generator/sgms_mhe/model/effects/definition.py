"""What an effect is: something the axis has beyond the S-GMS friction law."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import casadi as ca

if TYPE_CHECKING:
    from sgms_mhe.model.axis import SymbolicAxis


@dataclass(frozen=True)
class EffectParameter:
    """One parameter of an effect; its unit stands at the end of its name (`amplitude_N`, `pitch_m`).

    `scale` is a typical size: it scales the parameter for estimation where the nominal value is zero.
    """

    name: str
    default: float
    scale: float
    description: str
    lower: float = -float("inf")
    upper: float = float("inf")


@dataclass(frozen=True)
class EffectState:
    """A state of an effect's own.

    `rate_per_metre` [1/m] and `rate_per_second` [1/s] bound how fast it moves at nominal parameters; they set the
    number of Runge-Kutta substeps. `noise` is its state noise per update in units of its scale.
    """

    name: str
    rate_per_metre: float = 0.0
    rate_per_second: float = 0.0
    noise: float = 1e-3
    initial_state: float = 1e-3


Contribution = Callable[["SymbolicAxis", Mapping[str, ca.SX]], None]


@dataclass(frozen=True)
class EffectDefinition:
    """The one definition of an effect that simulator, reference, generator and diagnosis read.

    `contribute(axis, parameters)` adds the effect to the symbolic axis: a change of a measured signal, a factor on a
    base parameter, a force, a state. Effects that change signals run first (`stage` "signal"), then those that
    change levels, then forces, whatever their order in the machine file.
    """

    name: str
    summary: str
    parameters: tuple[EffectParameter, ...]
    contribute: Contribution
    stage: str = "force"
    states: Callable[[Mapping[str, float]], tuple[EffectState, ...]] = field(default=lambda _: ())

    def parameter(self, name: str) -> EffectParameter:
        """Return the parameter called `name`; KeyError if there is none."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(name)
