"""Table [sampling]: rates, the velocity filter, the maximum speed, and the integrator."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final, Literal, Self

from pydantic import Field, model_validator

from sgms_mhe.machine.fields import Table, listing, quantity, refusal, text

DISPLACEMENT: Final = {"rk4": 0.03, "rk2": 0.05, "bs23": 0.02, "euler": 0.01, "flow": 0.1, "clip": 0.1}
"""Default largest move per substep in deflection scales (`flow`, `clip`: for the blocks that they leave to rk4).

rk4 and bs23 then keep the force of Table I within 1e-4 N at every speed; rk2 and euler are off by up to 6e-3 N."""

CLOSED_FORMS: Final = ("flow", "clip")
"""Schemes that take the steps of elements in closed form, and leave the other blocks to rk4."""

CHOSEN_BY_TOLERANCE: Final = ("scheme", "substeps", "displacement", "slow_displacement")
"""Keys of the integrator that a tolerance excludes: it chooses them."""

CHOSEN_BY_LAW: Final = ("scheme", "tolerance", "displacement", "slow_displacement")
"""Keys of the integrator that mean nothing under another friction law."""

MOST_SAMPLES: Final = 1e5
"""Samples of an interval: an update every ten seconds at 10 kHz."""
RATIO_TOLERANCE: Final = 1e-9
READINGS_PER_CUTOFF: Final = 2.0
"""Of velocity_cutoff: more readings per second than this say little new, the filters having made them alike."""
SMALLEST_CUTOFF: Final = 1e-4  # of rate: below it the low-pass coefficients lose their digits


def runge_kutta_scheme(scheme: str) -> str:
    """The scheme of the Runge-Kutta steps that a scheme takes."""
    return "rk4" if scheme in CLOSED_FORMS else scheme


class Integrator(Table):
    """How one shooting interval is integrated."""

    velocity: Literal["constant", "linear"] = text(
        "velocity between two samples",
        "constant or linear (linear: at least one substep per sample, neither flow nor clip)",
        "constant",
    )
    scheme: Literal["rk4", "rk2", "bs23", "euler", "flow", "clip"] = Field(
        default_factory=lambda data: "rk4" if data.get("velocity") == "linear" else "flow",
        description="integration scheme; rk4, rk2, bs23, euler or flow; clip where, and only where, [friction] law is "
        "switching; default 'flow', 'clip' where law is switching, 'rk4' where velocity is linear or the smoothing too "
        "soft for the flow",
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
        "default 0.03 (rk4), 0.1 (flow, clip), 0.05 (rk2), 0.02 (bs23), 0.01 (euler)",
    )
    slow_displacement: float = quantity(
        "of the flow: the same below the speed at which the gate saturates", "1", 0.02, gt=0, le=1
    )
    tolerance: float | None = Field(
        None,
        gt=0,
        le=0.1,
        description="largest error of an element's end state and of both its sensitivities over one interval, over the "
        "deflection scale [1]; > 0 and <= 0.1; chooses the scheme and its steps, so it stands without "
        f"{listing(CHOSEN_BY_TOLERANCE)}; default none",
    )


class Sampling(Table):
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
        """Whether so many readings per interval lie whole integration steps apart."""
        samples = self.samples_per_update
        return samples % count == 0 and samples // count % self.merged == 0

    @property
    def varies_in_step(self) -> bool:
        """Whether signals are lines within a step, not constant."""
        return self.merged > 1 or self.integrator.velocity == "linear"

    @model_validator(mode="before")
    @classmethod
    def _fill(cls, data: Any) -> Any:
        # The default of substeps needs both rates; wrong types are left for the fields to refuse.
        if not isinstance(data, Mapping):
            return data
        integrator = data.get("integrator", {})
        if isinstance(integrator, Mapping) and integrator.get("tolerance") is not None:
            given = [key for key in CHOSEN_BY_TOLERANCE if key in integrator]
            if given:
                allowed = f"no {given[0]} beside a tolerance, which chooses {listing(CHOSEN_BY_TOLERANCE)}"
                raise refusal(f"integrator.{given[0]}", integrator[given[0]], allowed)
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
        if self.integrator.velocity == "linear":
            if self.integrator.tolerance is not None:
                raise refusal("integrator.velocity", "linear", "constant, where a tolerance is given")
            if self.integrator.scheme in CLOSED_FORMS:
                raise refusal("integrator.velocity", "linear", f"constant, where scheme is {self.integrator.scheme}")
            if steps < samples:
                raise refusal(
                    "integrator.velocity",
                    "linear",
                    f"constant, where substeps < {samples}: merged samples are lines already",
                )
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
