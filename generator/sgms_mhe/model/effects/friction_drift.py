"""A Coulomb level that changes over time: lubricant running in, warming up."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np

from sgms_mhe.model.axis import SymbolicAxis
from sgms_mhe.model.effects.causes import Simpler
from sgms_mhe.model.effects.definition import EffectDefinition, EffectParameter, step_by_factor
from sgms_mhe.model.effects.excitation import Excitation, Need
from sgms_mhe.model.effects.motion import Extents, MotionRecord
from sgms_mhe.model.effects.search import Array, Columns, Values, one_size
from sgms_mhe.model.effects.specimen import TIME_CONSTANT, Specimen


def _contribute(axis: SymbolicAxis, p: Mapping[str, ca.SX], _: Mapping[str, float]) -> None:
    axis.coulomb_factor = axis.coulomb_factor * (1.0 + p["ratio"] * (1.0 - ca.exp(-axis.time / p["time_constant_s"])))


def _settling(motion: MotionRecord, values: Values) -> Array:
    return np.asarray(1.0 - np.exp(-motion.time / values["time_constant_s"]))


def _time_constants(motion: MotionRecord) -> list[Values]:
    return [{"time_constant_s": share * motion.extents.end} for share in (0.03, 0.08, 0.2, 0.4, 0.8, 2.0)]


def _is_level(p: Values, extents: Extents) -> bool:
    return p["time_constant_s"] < 0.01 * extents.end


DEFINITION = EffectDefinition(
    name="friction_drift",
    summary="Coulomb level that settles at another value over time",
    parameters=(
        EffectParameter("ratio", 0.0, 0.1, "final change over the initial Coulomb level", lower=-0.95),
        EffectParameter(
            "time_constant_s", 10.0, 1.0, "time to 63 % of the change", lower=1e-3, role="shape", step=step_by_factor
        ),
    ),
    contribute=_contribute,
    excitation=Excitation(
        "the same move again and again, over more than a time constant",
        (Need("moving_s", 1.0), Need("reversals", 4.0)),
    ),
    confused_with={
        "coulomb": "the same move at the beginning and at the end of the log",
        "viscous_drift": "two constant speeds at the beginning, and again at the end of the log",
        "position_dependent_friction": "the same stroke twice: what belongs to the place comes back",
        "dwell_dependence": "rests of different length in the middle of the log",
    },
    moves=("again",),
    simpler=Simpler(("coulomb",), _is_level),
    search=Columns(
        lambda m, p: (m.level * _settling(m, p))[:, None],
        one_size("ratio"),
        _time_constants,
        tests=3.0,
    ),
    linear=True,
    stage="level",
    specimen=Specimen(lambda _, p, x: {"ratio": min(max(x, -0.9), 5.0), **p}, (TIME_CONSTANT,)),
)
