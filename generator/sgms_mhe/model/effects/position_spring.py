"""A force proportional to position: a cable or a hose that bends, a tilted table, a gravity compensator."""

import numpy as np

from sgms_mhe.model.effects import EffectDefinition, EffectParameter, Excitation, Need, Simpler
from sgms_mhe.model.effects.search import Columns

DEFINITION = EffectDefinition(
    name="position_spring",
    summary="force proportional to position",
    parameters=(
        EffectParameter("stiffness_N_m", 0.0, 1e-4, "force over position", unit="stiffness"),
        EffectParameter(
            "centre_m", 0.0, 0.01, "position without force", role="place", main=False, times="stiffness_N_m"
        ),
    ),
    contribute=lambda axis, p, _: axis.add_force(p["stiffness_N_m"] * (axis.position - p["centre_m"])),
    loads=True,
    excitation=Excitation(
        "travel over much more than the break-away distance, in both directions",
        (Need("travel_m", 0.01), Need("both_directions", 0.1)),
    ),
    confused_with={
        "constant_offset": "the same move at two ends of the travel",
        "force_ripple": "travel over several pitches",
        "hose_hysteresis": "the same long stroke forth and back: a spring has no loop",
        "friction_drift": "return to the start: a spring's force comes back with the position",
    },
    moves=("travel", "places"),
    simpler=Simpler(("constant_offset",)),
    # Linear in stiffness and stiffness * centre.
    search=Columns(
        lambda m, _: np.column_stack((m.position, np.ones(len(m.time)))),
        lambda _, size: {
            "stiffness_N_m": float(size[0]),
            "centre_m": float(-size[1] / size[0]) if size[0] != 0.0 else 0.0,
        },
    ),
    linear=True,
    companion=True,
)
