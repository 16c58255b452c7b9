"""Table [sampling]: rates, the velocity filter, the maximum speed, and the integrator."""

import math
from collections.abc import Mapping
from typing import Any, Final, Literal, Self

from pydantic import Field, model_validator

from sgms_mhe.machine.fields import MachineTable, listing, quantity, refusal

DISPLACEMENT: Final = {"rk4": 0.03, "flow": 0.1, "clip": 0.1}
"""Default largest move per substep in deflection scales (`flow`, `clip`: for the blocks that they leave to rk4).

rk4 then keeps the force of Table I within 1e-4 N at every speed."""

CLOSED_FORMS: Final = ("flow", "clip")
"""Schemes that take the steps of elements in closed form, and leave the other blocks to rk4."""

CHOSEN_BY_LAW: Final = ("scheme", "displacement", "slow_displacement")
"""Keys of the integrator that mean nothing under another friction law."""

MOST_SAMPLES: Final = 1e5
"""Samples of an interval: an update every ten seconds at 10 kHz."""
RATIO_TOLERANCE: Final = 1e-9
READINGS_PER_CUTOFF: Final = 2.0
"""Of velocity_cutoff: more measurements per second than this say little new, the filters having made them alike."""
SMALLEST_CUTOFF: Final = 1e-4  # of rate: below it the low-pass coefficients lose their digits


class Integrator(MachineTable):
    """How one shooting interval is integrated."""

    scheme: Literal["rk4", "flow", "clip"] = Field(
        "flow",
        description="integration scheme; rk4 or flow; clip where, and only where, [friction] law is switching; "
        "default 'flow', 'clip' where law is switching, 'rk4' where the smoothing is too soft for the flow",
    )
    substeps: int = Field(
        1,
        ge=1,
        le=1_000_000,
        description="least number of steps per shooting interval [1]; a multiple or a divisor of rate / update_rate; "
        "default: rate / update_rate",
    )
    displacement: float = Field(
        default_factory=lambda data: DISPLACEMENT[data["scheme"]],
        gt=0,
        le=10,
        description="largest move per substep over the deflection scale [1]; > 0 and <= 10; "
        "default 0.03 (rk4), 0.1 (flow, clip)",
    )
    slow_displacement: float = quantity(
        "of the flow: the same below the speed at which the gate saturates", "1", 0.02, gt=0, le=1
    )


class Sampling(MachineTable):
    """Rates, the velocity filter, the stated maximum speed."""

    rate: float = quantity("sample rate of position and force", "Hz", 10000.0, gt=0, le=1e7)
    update_rate: float = quantity("estimator updates; divides rate", "Hz", 100.0, gt=0, le=1e6)
    measurement_rate: float | None = Field(
        None,
        gt=0,
        le=1e7,
        description="friction readings that the estimator uses [Hz]; > 0 and <= 1e+07, a multiple of update_rate that "
        "divides rate; default: the largest up to 2 velocity_cutoff",
    )
    velocity_cutoff: float = quantity("second-order low-pass; < rate / 2", "Hz", 500.0, gt=0)
    position_step: float = quantity("encoder's step: a reading so near to the axis is no motion", "m, rad", 0.0, ge=0)
    max_velocity: float = quantity("speed up to which the estimate is right", "m/s, rad/s", 1.0, gt=0, le=1e3)
    integrator: Integrator = Field(Integrator(), description="integration scheme; default flow, one step per sample")

    @property
    def samples_per_update(self) -> int:
        """M, samples per shooting interval."""
        return round(self.rate / self.update_rate)

    @property
    def step(self) -> float:
        """h [s], time between samples."""
        return 1.0 / self.rate

    @property
    def merged(self) -> int:
        """K, samples that make one integration step."""
        return max(1, self.samples_per_update // self.integrator.substeps)

    @property
    def readings_per_update(self) -> int:
        """R, friction readings per shooting interval, the last one at its end; whole integration steps apart."""
        if self.measurement_rate is not None:
            return round(self.measurement_rate / self.update_rate)
        most = max(
            1, math.floor(READINGS_PER_CUTOFF * self.velocity_cutoff / self.update_rate * (1.0 + RATIO_TOLERANCE))
        )
        return max(count for count in range(1, most + 1) if self._can_read(count))

    def _can_read(self, count: int) -> bool:
        """Return True if so many measurements per interval lie whole integration steps apart."""
        samples = self.samples_per_update
        return samples % count == 0 and samples // count % self.merged == 0

    @model_validator(mode="before")
    @classmethod
    def _fill(cls, data: Any) -> Any:
        # The default of substeps needs both rates; wrong types are left for the fields to refuse.
        if not isinstance(data, Mapping):
            return data
        integrator = data.get("integrator", {})
        rate, update_rate = (data.get(key, cls.model_fields[key].default) for key in ("rate", "update_rate"))
        sound = all(type(value) in (int, float) and 0 < value < math.inf for value in (rate, update_rate))
        sound = sound and 1.0 <= rate / update_rate <= MOST_SAMPLES
        if sound and isinstance(integrator, Mapping) and "substeps" not in integrator:
            return {**data, "integrator": {**integrator, "substeps": round(rate / update_rate)}}
        return data

    @model_validator(mode="after")
    def _check(self) -> Self:
        ratio = self.rate / self.update_rate
        if not ratio <= MOST_SAMPLES:
            allowed = f">= {self.rate / MOST_SAMPLES:g} Hz: at most {MOST_SAMPLES:g} samples per update"
            raise refusal("update_rate", self.update_rate, allowed)
        samples = self.samples_per_update
        if samples < 1 or abs(ratio - samples) > RATIO_TOLERANCE * ratio:
            raise refusal(
                "update_rate", self.update_rate, f"a rate that divides rate = {self.rate:g} Hz (ratio {ratio:g})"
            )
        if not SMALLEST_CUTOFF * self.rate <= self.velocity_cutoff < self.rate / 2:
            allowed = f">= {SMALLEST_CUTOFF * self.rate:g} Hz and < rate / 2 = {self.rate / 2:g} Hz"
            raise refusal("velocity_cutoff", self.velocity_cutoff, allowed)
        steps = self.integrator.substeps
        if steps % samples and samples % steps:
            raise refusal("integrator.substeps", steps, f"a multiple or a divisor of rate / update_rate = {samples}")
        self._check_measurement_rate()
        return self

    def _check_measurement_rate(self) -> None:
        if self.measurement_rate is None:
            return
        ratio = self.measurement_rate / self.update_rate
        count = round(ratio)
        if count < 1 or abs(ratio - count) > RATIO_TOLERANCE * ratio or not self._can_read(count):
            most = self.samples_per_update
            rates = [n * self.update_rate for n in range(1, most + 1) if self._can_read(n)]
            steps = f" and leaves whole steps of {self.merged} samples between readings" if self.merged > 1 else ""
            allowed = f"a multiple of update_rate that divides rate{steps}: {listing([f'{r:g}' for r in rates])} Hz"
            raise refusal("measurement_rate", self.measurement_rate, allowed)
