"""Table [estimator]: kind, horizon, parameters and their bounds, and the weights."""

import math
from collections import Counter
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from sgms_mhe.machine.axis import BASE_PARAMETERS
from sgms_mhe.machine.fields import Deviation, MachineTable, Names, Pair, listing, quantity, refusal, text


class Noise(MachineTable):
    """Weights of the estimator, all one standard deviation."""

    measurement: float = quantity("sigma_y, friction measurement", "N, N m", 0.5, gt=0, le=1e6)
    state: float = quantity("sigma_x per interval, as a fraction of nu_i f_C", "1", 0.02, gt=0, le=1e3)
    parameter: float = quantity(
        "prior of a parameter that [estimator.prior] does not name, relative", "1", 0.3, gt=0, le=1e3
    )
    parameter_drift: float = quantity(
        "random walk of a parameter with that prior per update, relative; others walk in proportion to theirs",
        "1",
        0.002,
        ge=0,
        le=1e3,
    )
    initial_state: float = quantity("prior of the first state, fraction of nu_i f_C", "1", 1.0, gt=0, le=1e3)
    state_as: Literal["force", "deflection"] = text(
        "scaling of the state that the noise acts on", "force (element force) or deflection (the paper)", "force"
    )
    colour: float = quantity(
        "mean square of a sum of so many innovations over their number, as the axis is known to leave it",
        "1",
        1.0,
        ge=1,
        le=1e6,
    )
    self_scaling: bool = text(
        "readings count less while they contradict what the estimator predicts of them", "true or false", True
    )


class Disturbance(MachineTable):
    """Errors of the model the estimator takes out beside the estimated parameters."""

    mass: float = quantity("1 sigma of the mass or inertia, relative; 0: it is right", "1", 0.0, ge=0, le=1)
    gain: float = quantity(
        "1 sigma of the logged force's gain, relative, which motion shows as an error of the mass; 0: it is right",
        "1",
        0.0,
        ge=0,
        le=1,
    )

    force: float = quantity(
        "1 sigma of a force that belongs to the place, as cogging or an offset; 0: there is none",
        "N, N m",
        0.0,
        ge=0,
        le=1e6,
    )
    length: float | None = Field(
        None,
        description="travel [m, rad] over which that force becomes another; > 0 and <= 1e6; default twice the longest "
        "deflection at break-away",
        gt=0,
        le=1e6,
    )

    @property
    def inertia(self) -> float:
        """Standard deviation of the mass by both, relative; 0: no such error is estimated."""
        return math.hypot(self.mass, self.gain)


class ArrivalCost(MachineTable):
    """Summary of the past before the horizon."""

    update: Literal["riccati", "fixed"] = text("update of the arrival cost", "riccati or fixed", "riccati")


def _flatten(data: Any) -> Any:
    # TOML reads a bare key `effect.param` as a nested table: both spellings mean the same.
    if not isinstance(data, Mapping):
        return data
    flat: dict[str, Any] = {}
    for key, value in data.items():
        nested = (
            {f"{key}.{inner}": entry for inner, entry in value.items()} if isinstance(value, Mapping) else {key: value}
        )
        for name, entry in nested.items():
            if name in flat:
                raise refusal(name, entry, "one entry per parameter; this one is given twice")
            flat[name] = entry
    return flat


class Estimator(MachineTable):
    """The observer."""

    kind: Literal["mhe", "ekf"] = text("estimator", "mhe or ekf", "mhe")
    horizon: int = quantity("N, shooting intervals", "1", 20, ge=1, le=1000)
    relinearise: Literal["all", "auto", "newest"] = text(
        "what of the older intervals an update linearises anew about the last solution",
        "all, auto (the blocks that have moved most) or newest (none: each but once, as the newest); of the mhe alone",
        "auto",
    )
    parameters: Names = text(
        "parameters to estimate",
        f"any of {listing(BASE_PARAMETERS)} and effect.parameter of the effects, each once, at least one",
        ("stiffness",),
        min_length=1,
    )
    noise: Noise = Field(Noise(), description="standard deviations; default as in its keys")
    disturbance: Disturbance = Field(
        Disturbance(), description="errors of the model that are estimated beside the parameters; default none"
    )
    arrival_cost: ArrivalCost = Field(ArrivalCost(), description="arrival cost; default riccati")
    prior: Annotated[dict[str, Deviation], BeforeValidator(_flatten)] = Field(
        {},
        description="1 sigma of a parameter before any data: of the friction law over nominal, of an effect in the "
        "unit that its name ends in; > 0 and <= 1e12; default noise.parameter",
    )
    bounds: Annotated[dict[str, Pair], BeforeValidator(_flatten)] = Field(
        {}, description="[low, high] of a parameter over its nominal value [1]; 0 <= low < 1 < high; default unbounded"
    )

    def prior_of(self, name: str, scale: float) -> float:
        """Standard deviation of a parameter before any data, over `scale`, which is its nominal value or its unit's."""
        stated = self.prior.get(name, self.noise.parameter)
        return stated / abs(scale) if name in self.prior and name not in BASE_PARAMETERS else stated

    @property
    def drift_interval(self) -> int:
        """Shifts of the window between two growths of the arrival cost by the drift: one window long, 20 at most."""
        return min(self.horizon, 20)

    @model_validator(mode="after")
    def _check(self) -> Self:
        for name, (low, high) in self.bounds.items():
            if not low < 1.0 < high:
                raise refusal(f"bounds.{name}", [low, high], "[low, high] times nominal with 0 <= low < 1 < high")
        for name, count in Counter(self.parameters).items():
            if count > 1:
                raise refusal("parameters", list(self.parameters), f"each parameter once ({name} stands {count} times)")
        return self
