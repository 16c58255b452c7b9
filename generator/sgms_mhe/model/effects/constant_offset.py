"""A constant force: an amplifier's offset, a cable's pull, gravity on a tilted axis."""

import numpy as np

from sgms_mhe.model.effects import EffectDefinition, EffectParameter, Excitation, Need
from sgms_mhe.model.effects.search import Columns, one_size

DEFINITION = EffectDefinition(
    name="constant_offset",
    summary="constant force, independent of motion",
    parameters=(EffectParameter("force_N", 0.0, 0.1, "force opposing positive drive force", unit="coulomb"),),
    contribute=lambda axis, p, _: axis.add_force(p["force_N"]),
    loads=True,
    excitation=Excitation(
        "sliding in both directions, and reversals: below break-away only an offset is left",
        (Need("both_directions", 0.1), Need("reversals", 2.0)),
    ),
    confused_with={
        "asymmetric_coulomb": "loops below break-away: an offset shifts them, an asymmetric level does not",
        "position_spring": "the same move at two ends of the travel",
        "step_disturbance": "the same move at the beginning and at the end of the log",
        "coulomb": "move in both directions: an offset does not change sign",
    },
    moves=("speeds", "loops"),
    search=Columns(lambda m, _: np.ones((len(m.time), 1)), one_size("force_N")),
    linear=True,
    of_record=True,
    companion=True,
)
