"""Common parts of effects that are sines."""

import math
from collections.abc import Callable

import casadi as ca

from sgms_mhe.model.effects.motion import MotionRecord
from sgms_mhe.model.effects.parameters import EffectParameter, step_of_angle, step_of_pitch
from sgms_mhe.model.effects.search import Harmonic, ones
from sgms_mhe.support.arrays import Array


def pitch(default: float, scale: float) -> EffectParameter:
    """`pitch_m`, a period in position."""
    return EffectParameter(
        "pitch_m",
        default,
        scale,
        "period in position",
        lower=1e-6,
        role="period",
        step=step_of_pitch,
        most=lambda extents: extents.longest_pitch,
    )


def phase(zero: str) -> EffectParameter:
    """`phase_rad`, the angle of a sine at a `zero` of its coordinate."""
    return EffectParameter("phase_rad", 0.0, 0.1, f"phase at {zero} zero", role="place", step=step_of_angle)


def sine(position: ca.SX, pitch: ca.SX, phase: ca.SX) -> ca.SX:
    """sin(2 pi q / pitch + phase)."""
    return ca.sin(2.0 * math.pi / pitch * position + phase)


def ripple_search(size: str, unit: Callable[[MotionRecord], Array]) -> Harmonic:
    """Search of a sine in position whose force at amplitude 1 and phase pi / 2 is `unit` (m) [N]."""
    return Harmonic("position", size, "pitch_m", lambda motion: [unit(motion)], lambda _, k: [ones(k)])
