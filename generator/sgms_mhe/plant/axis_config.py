"""How a simulated axis is driven, measured and integrated."""

import math
from dataclasses import dataclass
from typing import Final, Literal, Self

from sgms_mhe.support.errors import InputError

LAWS: Final = ("sgms", "maxwell_slip")
CONTROLS: Final = ("prescribed", "position", "force", "logged", "command")
SUBSTEP_S: Final = 12.5e-6
MAX_SUBSTEPS: Final = 256


@dataclass(frozen=True)
class Controller:
    """Position controller: PID on the encoder's filtered difference, feed-forward of the reference.

        u = P e + I int(e) + D (c_v dr/dt - dq/dt) + m d2r/dt2,  e = r - q

    Attributes:
        proportional: P [N/m].
        integral: I [N/(m s)].
        derivative: D [N s/m].
        filter_Hz: first-order filter of the derivative term.
        velocity_feedforward: c_v, 0 to 1.
        acceleration_feedforward_kg: m.
        feedforward_lead_s: how far ahead of the sample the reference's acceleration is taken; the time in which the
            drive answers makes its force act when it is due.
    """

    proportional: float
    integral: float
    derivative: float
    filter_Hz: float
    velocity_feedforward: float = 1.0
    acceleration_feedforward_kg: float = 0.0
    feedforward_lead_s: float = 0.0

    @classmethod
    def pid(cls, mass: float, bandwidth_Hz: float, *, feedforward_lead_s: float = 0.0) -> Self:
        """Crossover at the bandwidth with 50 degrees of phase left: zeros at 1/3 and 1/10 of it, filter at 10 times."""
        omega = 2.0 * math.pi * bandwidth_Hz
        proportional = mass * omega**2 / 3.0
        return cls(
            proportional,
            proportional * omega / 10.0,
            mass * omega,
            10.0 * bandwidth_Hz,
            acceleration_feedforward_kg=mass,
            feedforward_lead_s=feedforward_lead_s,
        )


@dataclass(frozen=True)
class AxisConfig:
    """How an axis is simulated, beyond its machine file.

    Attributes:
        law: friction law, "sgms" or the switching "maxwell_slip" (stick until the level, slip at it); None: the machine
            file's.
        control: "position" (closed loop), or "prescribed" (the mass follows the reference exactly; velocity constant
            per sample, the force follows), or driven by the reference: "force" of the drive, "logged" (that
            of a log, linear between samples), "command" (of the machine's [drive], held between samples).
        bandwidth_Hz: of the default controller; None: 80 Hz, or 1/40 of the sample rate where that is less.
        controller: gains; None: `Controller.pid` at the bandwidth for the machine's mass.
        current_loop_Hz: first-order bandwidth from command to force; inf: none. The log has the force behind it.
        max_force_N: limit of the command.
        encoder_resolution_m: 0: none.
        encoder_noise_m: 1 sigma, before quantisation, inside the loop.
        force_noise_N: 1 sigma, white, of the logged force.
        substeps: integration steps per sample; None: as many as keep them within 12.5 us.
        seed: of the noise. Encoder and force have streams of their own.
    """

    law: Literal["sgms", "maxwell_slip"] | None = None
    control: Literal["prescribed", "position", "force", "logged", "command"] = "position"
    bandwidth_Hz: float | None = None
    controller: Controller | None = None
    current_loop_Hz: float = 1000.0
    max_force_N: float = math.inf
    encoder_resolution_m: float = 1e-9
    encoder_noise_m: float = 0.0
    force_noise_N: float = 0.1
    substeps: int | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        for name, value, allowed in (("law", self.law, LAWS), ("control", self.control, CONTROLS)):
            if value is not None and value not in allowed:
                raise InputError("simulation", name, value, f"one of {', '.join(allowed)}")
        for name in ("bandwidth_Hz", "current_loop_Hz", "max_force_N"):
            value = getattr(self, name)
            if value is not None and not value > 0.0:
                raise InputError("simulation", name, value, "a positive number")
        for name in ("encoder_resolution_m", "encoder_noise_m", "force_noise_N"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise InputError("simulation", name, getattr(self, name), "a finite number, 0 or more")
        if self.substeps is not None and not 1 <= self.substeps <= MAX_SUBSTEPS:
            raise InputError("simulation", "substeps", self.substeps, f"1 to {MAX_SUBSTEPS}")
        if self.seed < 0:
            raise InputError("simulation", "seed", self.seed, "an integer, 0 or more")
