"""Friction that follows a change of speed late: the lubricant film takes time to build up."""

from sgms_mhe.model.axis import Expressions, SymbolicAxis
from sgms_mhe.model.effects import EffectDefinition, Excitation, Need
from sgms_mhe.model.effects.lag import FILM_LAG, add_film
from sgms_mhe.model.effects.search import Trials, Values


def _contribute(axis: SymbolicAxis, p: Expressions, nominal: Values) -> None:
    """The level follows s(v)/f_C with a first-order lag; chi is its difference from the level at rest.

    Shorter than a quarter sample, the lag is blended out instead, so that zero has no effect.
    """
    state, lag = add_film(axis, "level", p, nominal)
    target = axis.stribeck_level - axis.rest_level
    state.rate = (target - state.chi) / lag
    axis.stribeck_level = axis.stribeck_level + p["time_constant_s"] / lag * (state.chi - target)


DEFINITION = EffectDefinition(
    name="frictional_lag",
    summary="friction level follows speed with a lag",
    parameters=(FILM_LAG,),
    contribute=_contribute,
    excitation=Excitation(
        "speed that swings about the Stribeck velocity while sliding on, at several frequencies",
        (Need("speed_ratio", 3.0),),
    ),
    confused_with={
        "stribeck": "pass through the Stribeck velocity with different accelerations",
        "dwell_dependence": "break away after rests of different length",
        "force_delay": "high acceleration while sliding: a delayed force is late with the inertial force too",
    },
    moves=("loops", "jerks", "rests"),
    # Nothing to see where stribeck_ratio is 0.
    search=Trials(lambda _: [{"time_constant_s": x} for x in (1e-3, 4e-3, 16e-3, 64e-3)]),
    stage="level",
    states=("level",),
)
