"""An encoder whose measurement errs periodically in position: interpolation error, a scale's mounting."""

import math

import casadi as ca

from sgms_mhe.model.axis import Expressions, SymbolicAxis
from sgms_mhe.model.effects import EffectDefinition, EffectParameter, Excitation, Need
from sgms_mhe.model.effects.search import Harmonic, Values, ones
from sgms_mhe.model.effects.sines import phase, pitch


def _contribute(axis: SymbolicAxis, p: Expressions, _: Values) -> None:
    """Reading = q + A sin(k q + phi): its derivatives give the real velocity and acceleration.

    v_read = v (1 + A k cos), a_read = a (1 + A k cos) - A k^2 v^2 sin. The angle at the measurement is one
    Newton step away from the one at q; |A k| < 1, or the measurement would not tell the position.
    """
    k = 2.0 * math.pi / p["pitch_m"]
    angle = k * axis.position + p["phase_rad"]
    # q = measurement - A sin(k q + phi), solved to second order in A k
    shift = p["amplitude_m"] * ca.sin(angle) / (1.0 + p["amplitude_m"] * k * ca.cos(angle))
    real = angle - k * shift
    slope = 1.0 + p["amplitude_m"] * k * ca.cos(real)
    curvature = p["amplitude_m"] * k * k * ca.sin(real)
    axis.position = axis.position - shift
    axis.velocity = axis.velocity / slope
    axis.velocity_ratio = axis.velocity_ratio / slope
    read = axis.acceleration
    axis.acceleration = (read + curvature * axis.velocity * axis.velocity) / slope
    axis.add_force(axis.mass * (axis.acceleration - read))


DEFINITION = EffectDefinition(
    name="encoder_periodic_error",
    summary="encoder error periodic in position",
    parameters=(
        EffectParameter("amplitude_m", 0.0, 1e-7, "amplitude of the error"),
        pitch(0.001, 1e-5),
        phase("position"),
    ),
    contribute=_contribute,
    excitation=Excitation(
        "constant speeds at which the pitch passes below the velocity cutoff, over many pitches",
        (Need("travel_m", 3.0, times="pitch_m"), Need("moving_s", 0.3)),
    ),
    confused_with={
        "force_ripple": "the same stroke at twice the speed: an encoder's error makes four times the force",
        "structural_resonance": "the same stroke at another speed: the frequency follows speed or stays",
        "periodic_disturbance": "the same stroke at another speed: the frequency follows speed or stays",
    },
    moves=("travel",),
    search=Harmonic(
        "position",
        "amplitude_m",
        "pitch_m",
        # The encoder reads d too much: u - m a changes by -m d2d/dt2, the model's viscous force by sigma_v dd/dt.
        weights=lambda m: [m.velocity**2, m.mass * m.acceleration + m.damping * m.velocity],
        factors=lambda m, k: [m.mass * k**2 * ones(k), -1j * k * ones(k)],
    ),
    linear=True,
    stage="signal",
)
