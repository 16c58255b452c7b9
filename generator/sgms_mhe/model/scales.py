"""Scales of a machine, in which effects are sized."""

import math

from sgms_mhe.machine import Machine
from sgms_mhe.model.effects.scales import Scales


def scales_of(machine: Machine) -> Scales:
    """The sizes a machine sets."""
    friction = machine.friction
    deflections = [
        nu * friction.coulomb / kappa for nu, kappa in zip(friction.fraction, friction.stiffness, strict=True)
    ]
    return Scales(
        coulomb=friction.coulomb,
        damping=friction.viscous or friction.coulomb / machine.sampling.max_velocity,
        stiffness=math.fsum(friction.stiffness),
        mass=machine.plant.moved,
        step=machine.sampling.step,
        deflection=max(deflections),
        least_deflection=min(deflections),
        speed=machine.sampling.max_velocity,
    )
