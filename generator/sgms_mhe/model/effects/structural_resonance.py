"""A part of the mass that hangs on a spring: payload, chuck, a bridge's yaw."""

import math

import numpy as np
from scipy.signal import lfilter

from sgms_mhe.model.axis import Expressions, SymbolicAxis
from sgms_mhe.model.effects import EffectDefinition, EffectParameter, Excitation, MotionRecord, Need
from sgms_mhe.model.effects.parameters import shape, step_of_share
from sgms_mhe.model.effects.search import Columns, Values, one_size
from sgms_mhe.model.effects.states import EffectState, add_effect_state
from sgms_mhe.support.arrays import Array


def _contribute(axis: SymbolicAxis, p: Expressions, nominal: Values) -> None:
    """The hanging mass in coordinates relative to the rest, e = q - x: e'' = a - omega^2 e - 2 zeta omega e'.

    chi = (omega^2 e, omega e') mass / f_C. The rest is lighter by m2 and pulled by m2 (omega^2 e + 2 zeta omega e').
    """
    omega = 2.0 * math.pi * p["frequency_Hz"]
    fast = 2.0 * math.pi * nominal["frequency_Hz"]
    scale = axis.nominal_mass / axis.coulomb
    specs = (
        EffectState(name, rate_per_second=0.5 * fast, noise=1e-3, initial_state=1.0)
        for name in ("stretch", "stretch_rate")
    )
    stretch, speed = (add_effect_state(axis, spec) for spec in specs)
    stretch.rate = omega * speed.chi
    speed.rate = omega * (scale * axis.acceleration - stretch.chi - 2.0 * p["damping_ratio"] * speed.chi)
    # The integrator holds the acceleration of a step's end all through it, so its states are half a step ahead.
    ahead = 0.5 * axis.step
    pull = stretch.chi - ahead * stretch.rate + 2.0 * p["damping_ratio"] * (speed.chi - ahead * speed.rate)
    axis.add_force(p["mass_kg"] * (pull / scale - axis.acceleration))


def _hanging(motion: MotionRecord, values: Values) -> Array:
    """Acceleration of a hanging mass minus that of the axis (m), -s^2 / (s^2 + 2 d w s + w^2) of it, bilinear."""
    d, f = values["damping_ratio"], values["frequency_Hz"]
    w = 2.0 * math.pi * f
    c = w / math.tan(min(0.49 * math.pi, w / (2.0 * motion.extents.rate)))  # prewarped at the frequency itself
    a0, a1, a2 = c * c + 2 * d * w * c + w * w, 2 * (w * w - c * c), c * c - 2 * d * w * c + w * w
    b = -np.array([c * c, -2 * c * c, c * c]) / a0
    return np.asarray(lfilter(b, [1.0, a1 / a0, a2 / a0], motion.acceleration))


def _frequencies(motion: MotionRecord) -> list[Values]:
    top = 0.35 * motion.extents.rate
    count = 1 + max(8, round(math.log(top / 4.0) / math.log(1.07)))
    return [{"frequency_Hz": float(f), "damping_ratio": d} for f in np.geomspace(4.0, top, count) for d in (0.02, 0.08)]


DEFINITION = EffectDefinition(
    name="structural_resonance",
    summary="part of the mass on a spring",
    parameters=(
        EffectParameter(
            "frequency_Hz",
            100.0,
            1.0,
            "natural frequency with the rest fixed",
            lower=0.1,
            role="period",
            step=step_of_share,
        ),
        shape("damping_ratio", 0.02, 0.01, "damping ratio with the rest fixed", 0.0, 2.0),
        EffectParameter("mass_kg", 0.0, 0.1, "hanging part of the mass", lower=0.0, unit="mass"),
    ),
    contribute=_contribute,
    excitation=Excitation(
        "jerk with frequencies around the resonance, and rest after it",
        (Need("inertial_ratio", 1.0), Need("reversals", 2.0)),
    ),
    confused_with={
        "mass_mismatch": "moves with little jerk, and jerk at the resonance: a mass alone does not ring",
        "periodic_disturbance": "a standstill long after the last move: a resonance has died away",
        "force_delay": "wide-band force, such as noise on the command: a resonance has a peak",
        "encoder_periodic_error": "the same stroke at another speed: the frequency follows speed or stays",
    },
    moves=("jerks",),
    inertial=True,
    search=Columns(lambda m, p: _hanging(m, p)[:, None], one_size("mass_kg"), _frequencies, tests=40.0),
    full_rate=True,
    # It is a part of what moves.
    possible=lambda p, scales: p["mass_kg"] < scales.mass,
    states=("stretch", "stretch_rate"),
)
