"""A force that belongs to the place, which the estimator follows: not explained by any effect of the machine file."""

from typing import Final

import casadi as ca

from sgms_mhe.machine import Machine
from sgms_mhe.model.axis import StateSpec, SymbolicAxis

SLOPE: Final = 2.2
"""1 sigma of the force's slope over that of the force, per length."""
LENGTHS: Final = 2.0
"""Length over the longest deflection at break-away, where the machine file states none."""


def place_length(machine: Machine) -> float:
    """Travel [m] over which the force becomes another."""
    friction, stated = machine.friction, machine.estimator.disturbance.length
    ends = zip(friction.fraction, friction.stiffness, strict=True)
    return stated or LENGTHS * max(nu * friction.coulomb / kappa for nu, kappa in ends)


def add_place_force(axis: SymbolicAxis, machine: Machine) -> None:
    """Add the force f_C d and its slope f_C g / l, two states that motion along l makes forget themselves.

    With velocity v, dd/dt = (g v - d |v|) / l and dg/dt = -g |v| / l. Without noise a force is followed to the next
    place by its slope, and is nothing some l farther on. The noise comes with the path: an axis that stays on one
    spot does not average the force of that spot away.
    """
    length = place_length(machine)
    deviation = machine.estimator.disturbance.force / axis.coulomb
    states = [
        axis.add_state(
            StateSpec(
                name=name,
                element=None,
                rate_per_metre=1.0 / length,
                rate_per_second=0.0,
                noise=size,
                initial_state=size,
                noise_travel=length,
            )
        )
        for name, size in (("place_force", deviation), ("place_slope", SLOPE * deviation))
    ]
    force, slope = states
    v = axis.velocity / length
    force.rate = slope.chi * v - force.chi * ca.fabs(v)
    slope.rate = -slope.chi * ca.fabs(v)
    axis.add_force(axis.coulomb * force.chi)
