"""Coulomb and viscous friction alone, as simulators of rigid bodies compute it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from sgms_mhe.support.arrays import Array

SOLVER_REFERENCE: Final = (0.02, 1.0)
SOLVER_IMPEDANCE: Final = (0.9, 0.95, 0.001, 0.5, 2.0)
"""solreffriction and solimpfriction of MuJoCo, its defaults: what its friction loss does below its level."""
GRAVITY: Final = 9.81
"""m/s^2."""
ENGINE_STEP: Final = 1e-3
"""s, Gazebo's step, for engines that step velocities."""


@dataclass(frozen=True)
class SimpleAxis:
    """Coulomb and viscous friction of an axis, and forces of place: what a simulator without presliding holds.

    inertia [kg, kg m^2], what effects add to it included; coulomb [N, N m]; viscous [N s/m, N m s/rad]. Against the
    drive act also `constant` + `stiffness` q + `sine` sin q + `cosine` cos q [N, N m], the sines on a joint that turns.
    """

    inertia: float
    coulomb: float
    viscous: float
    constant: float = 0.0
    stiffness: float = 0.0
    sine: float = 0.0
    cosine: float = 0.0

    def place_force(self, position: Array) -> Array:
        """Return the force (n) that goes with the position alone [N, N m]."""
        waves = self.sine * np.sin(position) + self.cosine * np.cos(position)
        return np.asarray(self.constant + self.stiffness * position + waves)

    @property
    def body(self) -> tuple[float, float, float, float]:
        """Mass [kg] and inertia about its centre [kg m^2] of a joint that turns, and where that is at rest (x, z) [m].

        The joint turns about y, z points up. The mass is large enough for its distance to take 1/10 of the inertia.
        """
        moment = float(np.hypot(self.sine, self.cosine)) / GRAVITY
        mass = max(1.0, 10.0 * moment**2 / self.inertia)
        return mass, self.inertia - moment**2 / mass, -self.cosine / (GRAVITY * mass), -self.sine / (GRAVITY * mass)


def simple_friction(form: str, axis: SimpleAxis, velocity: Array, force: Array) -> Array:
    """Friction (n) [N, N m] of Coulomb and viscous friction as a simulator computes it along a motion.

    MuJoCo's friction loss is a constraint that asks for the acceleration -b v and is held softly, b = 2 / (d_max T),
    with a share d_0 of what that takes, up to its level; of the force u that acts,

        clip(d_0 (u - damping v + M b v), -f_C, f_C) + damping v

    Engines that step velocities (ODE, Bullet, DART), by which a URDF is simulated, take what stops the axis within a
    step h, `ENGINE_STEP`, up to the level: clip(u - damping v + M v / h, -f_C, f_C) + damping v.

    Args:
        form: "mujoco" or "urdf".
        axis: its numbers.
        velocity, force: of axis and drive (n) [m/s, N; rad/s, N m].
    """
    least, most = SOLVER_IMPEDANCE[:2]
    share, rate = (least, 2.0 / (most * SOLVER_REFERENCE[0])) if form == "mujoco" else (1.0, 1.0 / ENGINE_STEP)
    damping = axis.viscous * velocity
    held = share * (force - damping + axis.inertia * rate * velocity)
    return np.asarray(np.clip(held, -axis.coulomb, axis.coulomb) + damping)
