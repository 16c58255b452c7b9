"""Friction of an axis as simulators of rigid bodies compute it."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from sgms_mhe.support.arrays import Array

GRAVITY: Final = 9.81
"""m/s^2."""
ENGINE_STEP: Final = 1e-3
"""s, Gazebo's step, for engines that step velocities."""


@dataclass(frozen=True)
class SimpleAxis:
    """Coulomb and viscous friction of an axis, its Stribeck effect, and forces of place.

    inertia [kg, kg m^2], effects included; coulomb [N, N m]; viscous [N s/m, N m s/rad]; stribeck_ratio
    and stribeck_velocity [m/s, rad/s] of the law. Against the drive act also `constant` + `stiffness` q + `sine` sin q
    + `cosine` cos q [N, N m], the sines on a joint that turns, and the ripples: each (amplitude, wave number, phase).
    """

    inertia: float
    coulomb: float
    viscous: float
    stribeck_ratio: float = 0.0
    stribeck_velocity: float = 1.0
    constant: float = 0.0
    stiffness: float = 0.0
    sine: float = 0.0
    cosine: float = 0.0
    ripples: tuple[tuple[float, float, float], ...] = ()

    def place_force(self, position: Array) -> Array:
        """Return the force (n) that goes with the position alone [N, N m]."""
        waves = self.sine * np.sin(position) + self.cosine * np.cos(position)
        ripples = sum(size * np.sin(wave * position + phase) for size, wave, phase in self.ripples)
        return np.asarray(self.constant + self.stiffness * position + waves + ripples)

    @property
    def body(self) -> tuple[float, float, float, float]:
        """Mass [kg] and inertia about its centre [kg m^2] of a joint that turns, and where that is at rest (x, z) [m].

        The joint turns about y, z points up. The mass is large enough for its distance to take 1/10 of the inertia.
        """
        moment = float(np.hypot(self.sine, self.cosine)) / GRAVITY
        mass = max(1.0, 10.0 * moment**2 / self.inertia)
        return mass, self.inertia - moment**2 / mass, -self.cosine / (GRAVITY * mass), -self.sine / (GRAVITY * mass)

    def friction(self, velocity: Array, force: Array, step: float) -> Array:
        """Return the friction (n) [N, N m] that a simulator computes along a motion without forces of place.

        Engines that step velocities take a force that stops the axis within a step h, `ENGINE_STEP`, up to the level s:
        clip(u - damping v + M v / h, -s, s) + damping v.

        Args:
            velocity, force: of axis and drive (n) [m/s, N; rad/s, N m].
            step: between two samples [s].
        """
        damping = self.viscous * velocity
        level = self.coulomb * (1.0 + self.stribeck_ratio * np.exp(-((velocity / self.stribeck_velocity) ** 2)))
        return np.clip(force - damping + self.inertia / ENGINE_STEP * velocity, -level, level) + damping
