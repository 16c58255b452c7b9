"""Gravity on an arm, or on a rotor whose centre of mass is off the axis: a torque with the period of a turn."""

import math

import casadi as ca
import numpy as np

from sgms_mhe.model.effects import EffectDefinition, EffectParameter, Excitation, Need, Simpler
from sgms_mhe.model.effects.search import Columns
from sgms_mhe.model.effects.sines import phase

DEFINITION = EffectDefinition(
    name="unbalance",
    summary="gravity over the angle, one period a turn",
    kinds=("rotary",),
    parameters=(
        EffectParameter("amplitude_N", 0.0, 0.1, "weight times its distance from the axis", unit="coulomb"),
        phase("angle"),
    ),
    contribute=lambda axis, p, _: axis.add_force(p["amplitude_N"] * ca.sin(axis.position + p["phase_rad"])),
    loads=True,
    excitation=Excitation(
        "turning through a quarter of a turn or more, forth and back",
        (Need("travel_m", 0.5 * math.pi), Need("both_directions", 0.1), Need("moving_s", 0.3)),
    ),
    confused_with={
        "force_ripple": "travel over one and a half turns: gravity has one period a turn, whatever drives the axis",
        "constant_offset": "the same move at two angles half a turn apart: gravity has changed its sign",
        "position_spring": "travel over a turn: gravity comes back, a spring goes on",
        "position_dependent_friction": "the same angles in both directions: friction changes sign, gravity does not",
    },
    moves=("travel",),
    # Over a small part of a turn a sine is an offset, or a line.
    simpler=Simpler(("constant_offset", "position_spring")),
    # Linear in the parts that go with the sine and with the cosine of the angle.
    search=Columns(
        lambda m, _: np.column_stack((np.sin(m.position), np.cos(m.position))),
        lambda _, size: {"amplitude_N": math.hypot(*size), "phase_rad": math.atan2(float(size[1]), float(size[0]))},
    ),
    linear=True,
    companion=True,
)
