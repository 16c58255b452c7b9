"""How a benchmark hides a cause in a log: the ranges that its numbers are drawn from, and what sizes it."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.random import Generator

from sgms_mhe.model.effects.base import FRACTION
from sgms_mhe.model.effects.scales import Scales
from sgms_mhe.model.effects.search import Values
from sgms_mhe.support.arrays import Array

Logged = Callable[[Array, float, Values], Array]
Concealing = Literal["presliding", "one_way"]
"""Motions that hide a cause: loops below break-away; sliding in one direction only."""


@dataclass(frozen=True)
class Scene:
    """A log to come.

    Attributes:
        scales: of the machine.
        numbers: of the base model, those that are one number each (`viscous`, ...) [SI].
        cutoff: of the chain's low-pass [Hz].
        travel: range of position [m].
        speed: largest [m/s].
        seconds: duration.
        random: what is drawn from.
    """

    scales: Scales
    numbers: Mapping[str, float]
    cutoff: float
    travel: float
    speed: float
    seconds: float
    random: Generator

    def sign(self) -> float:
        """-1 or 1."""
        return float(self.random.choice([-1.0, 1.0]))


def log_uniform(random: Generator, low: float, high: float) -> float:
    """A number whose logarithm is uniform."""
    return float(math.exp(random.uniform(math.log(low), math.log(high))))


@dataclass(frozen=True)
class Range:
    """Range to draw a number from, `low` to `high` times `of`.

    Attributes:
        name: of the number.
        low, high: limits; `high` may hang on the scene.
        of: unit of the limits; 1 where None.
        spacing: log or linear; `part`: `of` over a number between the limits, drawn as in log.
    """

    name: str
    low: float
    high: float | Callable[[Scene], float]
    of: Callable[[Scene], float] | None = None
    spacing: Literal["log", "linear", "part"] = "log"

    def draw(self, scene: Scene) -> float:
        """A number of the range."""
        high = self.high(scene) if callable(self.high) else self.high
        unit = 1.0 if self.of is None else self.of(scene)
        if self.spacing == "linear":
            return unit * float(scene.random.uniform(self.low, high))
        number = log_uniform(scene.random, self.low, high)
        return unit / number if self.spacing == "part" else unit * number


@dataclass(frozen=True)
class Concealed:
    """The cause in a log that cannot tell of it: what motion conceals it, and its parameters."""

    motion: Concealing
    values: Callable[[Scales], Values]


@dataclass(frozen=True)
class Specimen:
    """An effect to hide.

    Attributes:
        size: its parameters from the scene, the numbers drawn and x, what the force grows with; |x| is found by trial.
        ranges: numbers that are drawn, in this order.
        signed: whether x may be negative.
        least: what the machine's base numbers must at least be for the effect to have something to act on.
        logged: (force, step, values) -> what is logged of the force (n) that makes a prescribed motion, samples `step`
            apart: of an effect by which the log may lead the motion, which no plant does along a prescribed one.
        concealed: the same where a log cannot tell of it.
    """

    size: Callable[[Scene, Values, float], Values]
    ranges: tuple[Range, ...] = ()
    signed: bool = True
    least: Values | None = None
    logged: Logged | None = None
    concealed: Concealed | None = None

    def draw(self, scene: Scene) -> Callable[[float], Values]:
        """Parameters of a size."""
        drawn = {entry.name: entry.draw(scene) for entry in self.ranges}
        sign = scene.sign() if self.signed else 1.0
        return lambda x: self.size(scene, drawn, sign * x)


PHASE: Final = Range("phase_rad", -math.pi, math.pi, spacing="linear")
PITCH: Final = Range("pitch_m", 2.2, 30.0, lambda scene: scene.travel, "part")
TIME_CONSTANT: Final = Range("time_constant_s", 0.1, 0.6, lambda scene: scene.seconds)


def one_number(
    name: str,
    unit: Callable[[Scene], float],
    *,
    none: float = 0.0,
    signed: bool = True,
    concealed: Concealed | None = None,
) -> Specimen:
    """An effect of one parameter, `none` + x `unit`."""
    return Specimen(lambda scene, _, x: {name: none + x * unit(scene)}, signed=signed, concealed=concealed)


def ripple(size: str, unit: Callable[[Scene], float], ranges: tuple[Range, ...] = (PITCH, PHASE)) -> Specimen:
    """A sine of amplitude x `unit`; in position, unless other numbers are drawn."""
    return Specimen(lambda scene, drawn, x: {size: x * unit(scene), **drawn}, ranges, signed=False)


def _draw_sines(scene: Scene, drawn: Values, x: float) -> Values:
    """A map of three sines, each smaller than the one before."""
    values = {"pitch_m": drawn["pitch_m"]}
    orders = (1, round(drawn["second"]), round(drawn["third"]))
    for i, order in enumerate(orders, start=1):
        angle, size = drawn[f"angle_{i}"], x * drawn["share"] ** (i - 1) * scene.scales.coulomb
        values |= {
            f"order_{i}": float(order),
            f"sine_{i}_N": size * math.cos(angle),
            f"cosine_{i}_N": size * math.sin(angle),
        }
    return values


def _log_force(force: Array, step: float, p: Values) -> Array:
    """Return the logged series (n) of the force that makes a motion [N]."""
    time = step * np.arange(len(force))
    return np.asarray(np.interp(time - p["delay_s"], time, force))


_DRIFT: Final = Specimen(lambda _, p, x: {"ratio": min(max(x, -0.9), 5.0), **p}, (TIME_CONSTANT,))
"""A drift over a share of the log."""

SPECIMENS: Final[Mapping[str, Specimen]] = {
    "force_ripple": ripple("amplitude_N", lambda scene: scene.scales.coulomb),
    "force_constant_ripple": ripple("ratio", lambda _: 0.1),
    "constant_offset": one_number(
        "force_N",
        lambda scene: scene.scales.coulomb,
        concealed=Concealed("one_way", lambda scales: {"force_N": 0.2 * scales.coulomb}),
    ),
    "position_spring": Specimen(
        lambda scene, _, x: {"stiffness_N_m": x * scene.scales.coulomb / scene.travel, "centre_m": 0.0}
    ),
    "hose_hysteresis": Specimen(
        lambda scene, p, x: {
            "stiffness_N_m": x * scene.scales.coulomb / p["length"],
            "force_N": x * scene.scales.coulomb,
        },
        (Range("length", 0.03, 0.2, lambda scene: scene.travel),),
        signed=False,
    ),
    "asymmetric_coulomb": one_number("ratio", lambda _: 1.0, concealed=Concealed("one_way", lambda _: {"ratio": 0.2})),
    "asymmetric_viscous": one_number(
        "difference_N_s_m",
        lambda scene: scene.scales.coulomb / scene.speed,
        concealed=Concealed("presliding", lambda scales: {"difference_N_s_m": 0.5 * scales.coulomb_over_speed}),
    ),
    "position_dependent_friction": ripple("ratio", lambda _: 1.0),
    "friction_drift": _DRIFT,
    "viscous_drift": _DRIFT,
    "mass_mismatch": one_number("mass_kg", lambda scene: 0.1 * scene.scales.mass),
    "force_gain": one_number("gain", lambda _: 0.1, none=1.0),
    "force_delay": Specimen(lambda scene, _, x: {"delay_s": x * scene.scales.step}, logged=_log_force),
    "actuator_lag": Specimen(
        lambda scene, _, x: {"time_constant_s": x * scene.scales.step},
        signed=False,
        # u = lagged + T d(lagged)/dt makes the motion.
        logged=lambda force, step, p: force + p["time_constant_s"] * np.gradient(force, step),
    ),
    "quadratic_drag": one_number(
        "coefficient_N_s2_m2",
        lambda scene: scene.scales.coulomb / scene.speed**2,
        signed=False,
        concealed=Concealed(
            "presliding", lambda scales: {"coefficient_N_s2_m2": scales.coulomb_over_speed / scales.speed}
        ),
    ),
    "eddy_current_damping": Specimen(
        lambda scene, p, x: {"damping_N_s_m": 2.0 * x * scene.scales.coulomb / p["corner_velocity_m_s"], **p},
        (Range("corner_velocity_m_s", 0.08, 0.35, lambda scene: scene.speed),),
        signed=False,
        concealed=Concealed(
            "presliding",
            lambda scales: {"damping_N_s_m": scales.coulomb_over_speed, "corner_velocity_m_s": 0.3 * scales.speed},
        ),
    ),
    "encoder_periodic_error": ripple("amplitude_m", lambda _: 1e-7),
    "structural_resonance": Specimen(
        lambda scene, p, x: {**p, "mass_kg": min(x, 4.0) * 0.1 * scene.scales.mass},
        (
            Range("frequency_Hz", 12.0, lambda scene: max(20.0, min(150.0, 0.25 * scene.cutoff))),
            Range("damping_ratio", 0.01, 0.06),
        ),
        signed=False,
    ),
    "periodic_disturbance": ripple(
        "amplitude_N", lambda scene: scene.scales.coulomb, (Range("frequency_Hz", 0.5, 80.0), PHASE)
    ),
    "step_disturbance": Specimen(
        lambda scene, p, x: {"force_N": x * scene.scales.coulomb, **p},
        (Range("time_s", 0.25, 0.75, lambda scene: scene.seconds, "linear"),),
    ),
    "backlash": one_number("gap_m", lambda scene: 0.1 * scene.scales.deflection, signed=False),
    "frictional_lag": Specimen(
        lambda _, __, x: {"time_constant_s": x * 0.01},
        signed=False,
        least={"stribeck_ratio": 0.4},  # with little Stribeck effect there is little to lag
    ),
    "dwell_dependence": Specimen(
        lambda _, p, x: {"ratio": min(x, 3.0), **p},
        (Range("time_constant_s", 0.05, 0.3), Range("length_m", 0.3, 2.0, lambda scene: scene.scales.deflection)),
        signed=False,
    ),
    "micro_viscous": one_number("damping_N_s_m", lambda scene: scene.scales.coulomb / scene.speed, signed=False),
    "unbalance": ripple("amplitude_N", lambda scene: scene.scales.coulomb, (PHASE,)),
    "load_dependent_friction": Specimen(lambda _, __, x: {"ratio": 0.1 * x, "rise_ratio": 0.0}, signed=False),
    "drive_efficiency": one_number("efficiency_ratio", lambda _: -0.1, none=1.0, signed=False),
    "position_map": Specimen(
        _draw_sines,
        (
            Range("pitch_m", 1.0, 8.0, lambda scene: scene.travel, "part"),
            Range("second", 2.0, 4.4, spacing="linear"),
            Range("third", 4.6, 8.4, spacing="linear"),
            Range("share", 0.5, 0.8, spacing="linear"),
            *(Range(f"angle_{i}", -math.pi, math.pi, spacing="linear") for i in (1, 2, 3)),
        ),
        signed=False,
    ),
}
"""Effects to hide by their names."""


def _stiffness(scene: Scene, _: float) -> Mapping[str, float]:
    """A factor of its own: what it does to the force hangs on the reversals alone."""
    return {"stiffness": float(np.exp(scene.sign() * scene.random.uniform(0.3, 0.8)))}


def _fraction(scene: Scene, _: float) -> Mapping[str, float] | None:
    """Every element's share by a factor of its own; as of stiffnesses, the force hangs on the reversals alone."""
    shares = {key: value for key, value in scene.numbers.items() if FRACTION.is_element(key)}
    if len(shares) < 2:
        return None
    drawn = {key: value * float(np.exp(scene.random.uniform(-0.8, 0.8))) for key, value in shares.items()}
    total = sum(drawn.values())
    return {key: drawn[key] / total / shares[key] for key in shares}


def _coulomb(scene: Scene, size: float) -> Mapping[str, float]:
    return {"coulomb": 1.0 + size * scene.sign()}


def _viscous(scene: Scene, size: float) -> Mapping[str, float] | None:
    if scene.numbers["viscous"] == 0.0:
        return None
    change = size * scene.scales.coulomb / (scene.numbers["viscous"] * scene.speed)
    return {"viscous": 1.0 + max(-0.8, change * scene.sign())}


def _stribeck(scene: Scene, size: float) -> Mapping[str, float] | None:
    if scene.numbers["stribeck_ratio"] == 0.0:
        return None
    return {"stribeck_ratio": 1.0 + size / scene.numbers["stribeck_ratio"]}


WRONG_NUMBERS: Final[Mapping[str, Callable[[Scene, float], Mapping[str, float] | None]]] = {
    "stiffness": _stiffness,
    "fraction": _fraction,
    "coulomb": _coulomb,
    "viscous": _viscous,
    "stribeck": _stribeck,
}
"""Factors on the numbers of a wrong-number cause, for a size: the largest change of the force over f_C.

On all elements, or on single columns; None where the machine has nothing to make wrong.
"""
