"""Differences between an axis and its machine file that stay: numbers that are off, effects that the file has not."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

from sgms_mhe.plant.simulation import Drift, linear_drift

Effect = tuple[str, Mapping[str, float]]


@dataclass(frozen=True)
class LastingError:
    """Difference between the axis and its machine file that is there from the first sample to the last.

    Attributes:
        name: of the error.
        scale: true over nominal value of parameters.
        drift: multipliers of true parameters over time.
        effects: that the axis has and the machine file has not.
        law: of the axis.
        encoder_noise_m: 1 sigma.
        force_noise_N: 1 sigma of the logged force; 0.35 N makes the 0.1 N of friction that the machine file states.
        is_inertia: the effects' force is that of a mass, which is no friction.
    """

    name: str
    scale: Mapping[str, float] = field(default_factory=dict)
    drift: Mapping[str, Drift] = field(default_factory=dict)
    effects: Sequence[Effect] = ()
    law: Literal["maxwell_slip"] | None = None
    encoder_noise_m: float = 0.0
    force_noise_N: float = 0.1
    is_inertia: bool = False


def _gain(gain: float) -> LastingError:
    return LastingError(f"force's gain {gain:g}", effects=(("force_gain", {"gain": gain}),))


def _ripple(amplitude_N: float, pitch_m: float) -> Effect:
    return "force_ripple", {"amplitude_N": amplitude_N, "pitch_m": pitch_m, "phase_rad": 0.7}


def _cogging(amplitude_N: float, pitch_mm: float) -> LastingError:
    return LastingError(
        f"cogging {amplitude_N:g} N / {pitch_mm:g} mm", effects=(_ripple(amplitude_N, 1e-3 * pitch_mm),)
    )


CLEAN: Final = (LastingError("none"), LastingError("none, noise as stated", force_noise_N=0.35))
ERRORS: Final = (
    _gain(1.002),
    _gain(1.005),
    _gain(1.01),
    _gain(1.02),
    LastingError("mass 1 % more", {"mass": 1.01}),
    _cogging(0.1, 0.1),
    _cogging(0.5, 0.5),
    _cogging(0.3, 2.0),
    _cogging(1.0, 32.0),
    LastingError("offset 0.5 N", effects=(("constant_offset", {"force_N": 0.5}),)),
    LastingError("viscous 20 % more", {"viscous": 1.2}),
    LastingError("Coulomb level 10 % less", {"coulomb": 0.9}),
    LastingError("Coulomb level falls by 10 % in 20 s", drift={"coulomb": linear_drift(-0.1, 20.0)}),
    LastingError(
        "axis warms up in 20 s", drift={"viscous": linear_drift(-0.2, 20.0), "coulomb": linear_drift(-0.05, 20.0)}
    ),
    LastingError("force late by half a sample", effects=(("force_delay", {"delay_s": 50e-6}),)),
    LastingError("encoder's noise 10 nm", encoder_noise_m=1e-8),
    LastingError(
        "encoder's error 50 nm / 20 um",
        effects=(("encoder_periodic_error", {"amplitude_m": 5e-8, "pitch_m": 2e-5, "phase_rad": 0.7}),),
    ),
    LastingError(
        "resonance at 250 Hz, 1 kg",
        effects=(("structural_resonance", {"frequency_Hz": 250.0, "damping_ratio": 0.02, "mass_kg": 1.0}),),
        is_inertia=True,
    ),
    LastingError("elements switch", law="maxwell_slip"),
    LastingError(
        "gain 1.005, cogging 0.3 N / 2 mm, offset 0.2 N, viscous 10 % more",
        {"viscous": 1.1},
        effects=(("force_gain", {"gain": 1.005}), _ripple(0.3, 2e-3), ("constant_offset", {"force_N": 0.2})),
    ),
)
