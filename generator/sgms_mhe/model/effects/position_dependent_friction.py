"""Friction that varies along the travel: a guide's straightness, bearing balls, lubricant."""

from sgms_mhe.model.axis import Expressions, SymbolicAxis
from sgms_mhe.model.effects import EffectDefinition, EffectParameter, Excitation, Need, Simpler
from sgms_mhe.model.effects.search import Values
from sgms_mhe.model.effects.sines import phase, pitch, ripple_search, sine


def _contribute(axis: SymbolicAxis, p: Expressions, _: Values) -> None:
    axis.coulomb_factor = axis.coulomb_factor * (1.0 + p["ratio"] * sine(axis.position, p["pitch_m"], p["phase_rad"]))


DEFINITION = EffectDefinition(
    name="position_dependent_friction",
    summary="Coulomb level periodic in position",
    parameters=(
        EffectParameter("ratio", 0.0, 0.1, "amplitude over the Coulomb level", lower=-0.95, upper=0.95),
        pitch(0.02, 0.001),
        phase("position"),
    ),
    contribute=_contribute,
    excitation=Excitation(
        "sliding over the same places in both directions, over at least one and a half pitches",
        (Need("travel_m", 1.5, times="pitch_m"), Need("both_directions", 0.1)),
    ),
    confused_with={
        "force_ripple": "the same stroke in both directions: friction changes sign, cogging does not",
        "force_constant_ripple": "the same stroke with high acceleration: friction does not grow with inertial force",
        "friction_drift": "the same stroke twice: what belongs to the place comes back",
    },
    moves=("travel",),
    simpler=Simpler(("coulomb",)),
    search=ripple_search("ratio", lambda m: m.level),
    linear=True,
    stage="level",
)
