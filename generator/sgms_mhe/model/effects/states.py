"""States of an effect's own."""

from dataclasses import dataclass

import casadi as ca

from sgms_mhe.model.axis import AxisState, StateSpec, SymbolicAxis


@dataclass(frozen=True)
class EffectState:
    """A state of an effect's own.

    `rate_per_metre` [1/m] and `rate_per_second` [1/s] bound how fast it moves at nominal parameters; they set the
    number of Runge-Kutta substeps. `noise` (per update) and `initial_state` are standard deviations in the state's own
    unit. States that are forces count in f_C, so that 1 is large and 1e-3 is nothing.
    """

    name: str
    rate_per_metre: float = 0.0
    rate_per_second: float = 0.0
    noise: float = 1e-3
    initial_state: float = 1e-2


def share_effect_state(axis: SymbolicAxis, state: EffectState, *numbers: ca.SX) -> AxisState:
    """Return the state of that name and these numbers, which effects have in common; the first one declares it.

    Where a number is estimated, the state is the effect's own.
    """
    key = (state.name, *(float(number) if number.is_constant() else axis.scope for number in numbers))
    if key not in axis.shared:
        axis.shared[key] = add_effect_state(axis, state)
    return axis.shared[key]


def add_effect_state(axis: SymbolicAxis, state: EffectState) -> AxisState:
    """Declare a state of the effect that contributes at the moment."""
    # Rates are round numbers: without this, the number of substeps would hang on the rounding of a quotient.
    nudge = 1.0 + 1e-9
    return axis.add_state(
        StateSpec(
            name=f"{axis.scope}_{state.name}",
            element=None,
            rate_per_metre=nudge * state.rate_per_metre,
            rate_per_second=nudge * state.rate_per_second,
            noise=state.noise,
            initial_state=state.initial_state,
        )
    )
