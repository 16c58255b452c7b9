"""Axes, recorders and the logs that they leave, drawn at random; written apart from the product's simulation.

The friction of an axis is one element: a spring until it slips at the Coulomb level, and viscous friction beside it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.machine import Kind, Role
from sgms_mhe.signals.logs import Log

Array = NDArray[np.float64]
Rng = np.random.Generator

RATES: Final = (250.0, 400.0, 500.0, 800.0, 1000.0, 1000.0, 2000.0, 2500.0, 4000.0)
"""Samples per second whose times are whole microseconds."""

UNITS: Final[Mapping[Kind, Mapping[Role, Mapping[str, float]]]] = {
    "linear": {
        "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6},
        "position": {"m": 1.0, "mm": 1e-3, "um": 1e-6, "cm": 1e-2, "in": 0.0254},
        "force": {"N": 1.0, "kN": 1e3, "mN": 1e-3},
        "velocity": {"m/s": 1.0, "mm/s": 1e-3, "m/min": 1.0 / 60.0},
    },
    "rotary": {
        "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6},
        "position": {"rad": 1.0, "mrad": 1e-3, "deg": np.pi / 180.0, "rev": 2.0 * np.pi},
        "force": {"Nm": 1.0, "mNm": 1e-3, "Ncm": 1e-2},
        "velocity": {"rad/s": 1.0, "deg/s": np.pi / 180.0, "rpm": np.pi / 30.0},
    },
}
"""Units that recorders use, in SI units."""

NAMES: Final[Mapping[Kind, Mapping[Role, tuple[str, ...]]]] = {
    "linear": {
        "time": ("Time", "t", "Zeit", "Time stamp", "Elapsed time"),
        "position": ("Position", "x", "ActPos", "Position actual value", "Lageistwert", "pos.act", "Axis Position"),
        "force": ("Force", "F", "ActForce", "Kraft", "Drive force", "Force actual value", "Istkraft"),
        "velocity": ("Velocity", "v", "ActVel", "Velocity actual value", "Istgeschwindigkeit"),
    },
    "rotary": {
        "time": ("Time", "t", "Zeit", "Time stamp", "Elapsed time"),
        "position": ("Angle", "phi", "q", "Position actual value", "Istwinkel", "Motor Position", "theta_act"),
        "force": ("Torque", "ActTorque", "tau", "Torque actual value", "Istmoment", "Motor torque"),
        "velocity": ("Speed", "omega", "ActVel", "Velocity actual value", "Istdrehzahl"),
    },
}
"""Names that drives give, in English and German."""


@dataclass(frozen=True)
class Axis:
    """True numbers of an axis, in SI units of its kind.

    Attributes:
        mass: what moves, or its inertia.
        deflection: before the element slips.
    """

    kind: Kind
    mass: float
    coulomb: float
    viscous: float
    deflection: float

    def friction(self, position: Array, velocity: Array) -> Array:
        """Friction along a motion that begins at rest, relaxed (n)."""
        stretch, stretches = 0.0, []
        for step in np.diff(position, prepend=position[0]).tolist():
            stretch = min(max(stretch + step, -self.deflection), self.deflection)
            stretches.append(stretch)
        return np.asarray(self.coulomb * np.array(stretches) / self.deflection + self.viscous * velocity)

    def machine_file(self, rate: float, fastest: float) -> str:
        """Text of its machine file for logs of a rate [Hz] and up to a speed."""
        samples = max(1, round(rate / 100.0))
        inert = "mass" if self.kind == "linear" else "inertia"
        return f"""name = "drawn"
description = "one element"
[plant]
kind = "{self.kind}"
{inert} = {self.mass!r}
[friction]
stiffness = [{self.coulomb / self.deflection!r}]
fraction = [1.0]
viscous = {self.viscous!r}
coulomb = {self.coulomb!r}
[sampling]
rate = {rate!r}
update_rate = {rate / samples!r}
velocity_cutoff = {min(0.1 * rate, 60.0)!r}
max_velocity = {1.5 * fastest!r}
integrator = {{ scheme = "flow" }}
[estimator]
horizon = 5
parameters = ["coulomb"]
"""


@dataclass(frozen=True)
class Truth:
    """An axis and a log of it without anything wrong; `log` has velocity and friction too."""

    axis: Axis
    log: Log

    @property
    def fastest(self) -> float:
        """Largest speed."""
        return float(np.abs(self.log.columns["velocity_m_s"]).max())


def draw_axis(rng: Rng, travel: float, acceleration: float) -> Axis:
    """An axis whose friction is between a third and three times what its inertia takes at an acceleration."""
    kind: Kind = "linear" if rng.random() < 0.5 else "rotary"
    mass = 10.0 ** (rng.uniform(-0.5, 2.3) if kind == "linear" else rng.uniform(-4.5, -1.0))
    coulomb = mass * acceleration * 10.0 ** rng.uniform(-0.5, 0.5)
    return Axis(kind, mass, coulomb, 0.0, travel * 10.0 ** rng.uniform(-4.0, -2.5))


def draw_truth(rng: Rng, travel: float | None = None) -> Truth:
    """An axis that swings slowly, with a faster swing on top, from rest; some seconds of it."""
    rate, seconds = float(rng.choice(RATES)), rng.uniform(5.0, 10.0)
    time = np.arange(int(seconds * rate)) / rate
    low, high, phase = rng.uniform(0.2, 0.4), rng.uniform(1.2, 2.5), rng.uniform(0.0, 2.0 * np.pi)
    size = 10.0 ** rng.uniform(-2.0, 0.0)

    def motion(at: Array) -> Array:
        ramp = np.clip(at / 0.5, 0.0, 1.0)
        swing = np.sin(2.0 * np.pi * low * at) + 0.05 * np.sin(2.0 * np.pi * high * at + phase)
        return np.asarray(size * ramp**3 * (10.0 - 15.0 * ramp + 6.0 * ramp**2) * swing)

    shape = motion(time)
    acceleration = float(np.std(np.diff(shape, n=2))) * rate**2
    axis = draw_axis(rng, size, acceleration)
    if axis.kind == "rotary":  # turns, not metres
        scale = 10.0 ** rng.uniform(0.5, 2.0)
        axis = Axis(axis.kind, axis.mass, scale * axis.coulomb, 0.0, scale * axis.deflection)
        size *= scale
    position = motion(time)
    velocity = np.gradient(position, 1.0 / rate)
    fastest = float(np.abs(velocity).max())
    axis = Axis(axis.kind, axis.mass, axis.coulomb, rng.uniform(0.1, 0.5) * axis.coulomb / fastest, axis.deflection)
    friction = axis.friction(position, velocity)
    force = axis.mass * np.gradient(velocity, 1.0 / rate) + friction
    force += rng.uniform(0.002, 0.02) * float(np.std(force)) * rng.standard_normal(len(force))
    step = size / 10.0 ** rng.uniform(4.5, 6.0)
    counted = np.round(position / step) * step
    return Truth(axis, Log(time, counted, force, rate, velocity_m_s=velocity, friction_N=friction, kind=axis.kind))


def run_driven(rng: Rng, torque: Callable[[Array, float], Array]) -> Truth:
    """A rotor under a torque of (time [s], its Coulomb torque), integrated in steps of a tenth of a sample."""
    rate = float(rng.choice((500.0, 1000.0, 2000.0)))
    time = np.arange(int(rng.uniform(7.0, 10.0) * rate)) / rate
    coulomb = 10.0 ** rng.uniform(-2.0, 0.5)
    inertia, viscous = coulomb * 10.0 ** rng.uniform(-2.0, -1.2), coulomb * rng.uniform(0.01, 0.04)
    stiff, angle, speed, stretch = 0.002, 0.0, 0.0, 0.0
    angles, speeds, step = [], [], 0.1 / rate
    driving = torque(time, coulomb)
    for value in driving.tolist():
        angles.append(angle)
        speeds.append(speed)
        for _ in range(10):
            stretch = min(max(stretch + step * speed, -stiff), stiff)
            speed += step * (value - coulomb * stretch / stiff - viscous * speed) / inertia
            angle += step * speed
    axis = Axis("rotary", inertia, coulomb, viscous, stiff)
    position, velocity = np.round(np.array(angles) / 1e-5) * 1e-5, np.array(speeds)
    friction = axis.friction(np.array(angles), velocity)
    return Truth(axis, Log(time, position, driving, rate, velocity_m_s=velocity, friction_N=friction, kind="rotary"))
