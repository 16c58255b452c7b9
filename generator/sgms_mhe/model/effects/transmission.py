"""Common parts of effects of a gear: the torque the drive transmits."""

import numpy as np

from sgms_mhe.model.effects.excitation import Excitation, Need
from sgms_mhe.model.effects.motion import MotionRecord, direction
from sgms_mhe.support.arrays import Array

LOADED = (Need("load_ratio", 1.0), Need("both_directions", 0.1), Need("moving_s", 0.3))
"""What loads a drive needs to carry for its losses to be seen: about as much as its own friction."""


def load_excitation(text: str) -> Excitation:
    """The excitation of an effect that grows with the torque transmitted."""
    return Excitation(text, LOADED)


def friction_drag(motion: MotionRecord, inertia_ratio: float = 1.0, friction_ratio: float = 0.0) -> Array:
    """Friction of the size of the torque at the mesh (m, 1) [N]: added per unit of a level that grows with it.

    Args:
        motion: of the record.
        inertia_ratio: of the inertial torque that passes the mesh.
        friction_ratio: of friction that does.
    """
    # The drive's torque less the model's friction: what is not in the model yet is in the torque.
    friction = motion.level + motion.damping * motion.velocity
    torque = motion.force - friction - (1.0 - inertia_ratio) * motion.mass * motion.acceleration
    return np.asarray((np.abs(torque + friction_ratio * friction) * direction(motion.velocity))[:, None])
