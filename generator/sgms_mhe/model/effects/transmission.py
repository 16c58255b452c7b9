"""What effects of a gear have in common: the torque that the drive transmits."""

from __future__ import annotations

import numpy as np

from sgms_mhe.model.effects.excitation import Excitation, Need
from sgms_mhe.model.effects.motion import MotionRecord
from sgms_mhe.model.effects.search import Array

LOADED = (Need("load_ratio", 1.0), Need("both_directions", 0.1), Need("moving_s", 0.3))
"""What loads a drive needs to carry for its losses to be seen: about as much as its own friction."""


def loaded(text: str) -> Excitation:
    """The excitation of an effect that grows with the torque transmitted."""
    return Excitation(text, LOADED)


def transmitted(motion: MotionRecord) -> Array:
    """The drive's torque less the model's friction (m) [N]: what is not in the model yet is in the torque."""
    return np.asarray(motion.force - motion.level - motion.damping * motion.velocity)
