"""Viscous friction that follows a change of speed late: a film of grease takes its thickness after some time.

Where an axis stops, its force goes on to that of rest for a fraction of a second, though nothing moves any more.
"""

from sgms_mhe.model.axis import Expressions, SymbolicAxis
from sgms_mhe.model.effects import EffectDefinition, Excitation, Need, Simpler
from sgms_mhe.model.effects.lag import FILM_LAG, add_film
from sgms_mhe.model.effects.search import Trials, Values


def _contribute(axis: SymbolicAxis, p: Expressions, nominal: Values) -> None:
    """The force u of the film, in f_C, follows that of the speed: du/dt = ((sigma_v v + c(v)) / f_C - u) / lag.

    Shorter than a quarter sample, the lag is blended out instead, so that zero has no effect.
    """
    state, lag = add_film(axis, "film", p, nominal)
    viscous = axis.damping * axis.velocity
    state.rate = ((viscous + axis.mean_curve) / axis.coulomb - state.chi) / lag
    axis.add_force(p["time_constant_s"] / lag * (axis.coulomb * state.chi - (viscous + axis.curve)))


DEFINITION = EffectDefinition(
    name="viscous_lag",
    summary="viscous friction, and a friction curve, follow speed with a lag",
    parameters=(FILM_LAG,),
    contribute=_contribute,
    excitation=Excitation(
        "stops from several speeds, and changes of speed that are faster than the lag",
        (Need("speed_ratio", 3.0), Need("both_directions", 0.1), Need("moving_s", 0.5)),
    ),
    confused_with={
        "mass_mismatch": "a stop, then rest: a mass acts while the speed changes, a film after it too",
        "frictional_lag": "changes of speed far above the Stribeck velocity: the film alone follows them",
        "force_delay": "high acceleration while sliding: a delayed force is late with the inertial force too",
        "actuator_lag": "high acceleration while sliding: a late drive is late with the inertial force too",
    },
    moves=("speeds", "jerks", "rests"),
    # A line over speed that is a little late is a mass that is too large.
    simpler=Simpler(("mass_mismatch",)),
    search=Trials(lambda _: [{"time_constant_s": x} for x in (16e-3, 64e-3, 256e-3)]),
    stage="level",
    states=("film",),
)
