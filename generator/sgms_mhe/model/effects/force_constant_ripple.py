"""A force constant that varies with position: magnet spacing, end effects of a linear motor."""

from sgms_mhe.model.axis import Expressions, SymbolicAxis
from sgms_mhe.model.effects import EffectDefinition, EffectParameter, Excitation, Need
from sgms_mhe.model.effects.search import Values
from sgms_mhe.model.effects.sines import phase, pitch, ripple_search, sine


def _contribute(axis: SymbolicAxis, p: Expressions, _: Values) -> None:
    axis.drive = axis.drive / (1.0 + p["ratio"] * sine(axis.position, p["pitch_m"], p["phase_rad"]))


DEFINITION = EffectDefinition(
    name="force_constant_ripple",
    summary="force constant periodic in position",
    parameters=(
        EffectParameter("ratio", 0.0, 0.01, "amplitude over the mean force constant", lower=-0.9, upper=0.9),
        pitch(0.032, 0.001),
        phase("position"),
    ),
    contribute=_contribute,
    excitation=Excitation(
        "accelerations at many places: the inertial force should exceed friction",
        (Need("travel_m", 1.5, times="pitch_m"), Need("inertial_ratio", 1.0)),
    ),
    confused_with={
        "force_ripple": "the same stroke with another acceleration: cogging does not grow with force",
        "position_dependent_friction": "the same stroke with high acceleration: friction does not know inertia",
    },
    moves=("travel", "jerks"),
    search=ripple_search("ratio", lambda m: -m.force),
    linear=True,
    stage="motor",
)
