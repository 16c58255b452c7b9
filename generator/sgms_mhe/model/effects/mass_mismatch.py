"""A moved mass other than the machine file's: payload, motor inertia."""

from typing import Final

from sgms_mhe.model.effects import EffectDefinition, EffectParameter, Excitation, Need
from sgms_mhe.model.effects.search import Columns, one_size

LIGHTEST: Final = 0.95
"""Of the machine file's mass: what may be missing of it, so that something moves."""


DEFINITION = EffectDefinition(
    name="mass_mismatch",
    summary="moved mass differs from the machine file",
    parameters=(EffectParameter("mass_kg", 0.0, 0.05, "true mass minus mass", unit="mass"),),
    contribute=lambda axis, p, nominal: axis.add_mass(p["mass_kg"], nominal["mass_kg"]),
    loads=True,
    excitation=Excitation("accelerations whose inertial force is seen", (Need("inertial_ratio", 0.5),)),
    confused_with={
        "force_gain": "constant speed with known friction, or a known extra mass: a gain scales friction too",
        "structural_resonance": "moves with little jerk, and jerk at the resonance: a mass alone does not ring",
        "force_constant_ripple": "the same acceleration at several places",
    },
    moves=("jerks",),
    excludes=("force_gain",),  # a record tells their quotient
    inertial=True,
    search=Columns(lambda m, _: m.acceleration[:, None], one_size("mass_kg")),
    linear=True,
    possible=lambda p, scales: p["mass_kg"] > -LIGHTEST * scales.mass,
)
