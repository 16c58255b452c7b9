"""A force that repeats with position, of any shape: cogging over a pitch, a turn or the whole stroke."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import casadi as ca
import numpy as np

from sgms_mhe.model.axis import Expressions, SymbolicAxis
from sgms_mhe.model.effects import EffectDefinition, EffectParameter, Excitation, Need, Simpler
from sgms_mhe.model.effects.definition import Fault, Value
from sgms_mhe.model.effects.periodic_table import periodic_spline, spline_coefficients
from sgms_mhe.model.effects.search import Periodic, Values
from sgms_mhe.model.effects.sines import pitch, ripple_search

HIGHEST_ORDER: Final = 100
ROOM: Final = 1.05  # of the travel: a map over the whole stroke repeats where the stroke ends

_ORDER: Final = EffectParameter(
    "order",
    1.0,
    1.0,
    "periods of a sine in one of the map",
    lower=1.0,
    upper=HIGHEST_ORDER,
    role="place",
    frozen=True,
    array=True,
    whole=True,
)
_SINE: Final = EffectParameter("sine_N", 0.0, 0.1, "its amplitude", unit="coulomb", array=True)
_COSINE: Final = EffectParameter("cosine_N", 0.0, 0.1, "amplitude of its cosine", unit="coulomb", array=True)


def _contribute(axis: SymbolicAxis, p: Expressions, nominal: Values) -> None:
    """sum_h sine_h sin(2 pi order_h q / pitch) + cosine_h cos(2 pi order_h q / pitch).

    From a table where these numbers are fixed, and sine by sine where an estimator or a fit moves them.
    """
    periods = axis.position / p["pitch_m"]
    rows = [(_ORDER.entry(i), _SINE.entry(i), _COSINE.entry(i)) for i in range(1, len(p) // 3 + 1)]
    if all(p[name].is_constant() for row in rows for name in row):
        orders = [round(nominal[order]) for order, _, _ in rows]
        sines, cosines = ([nominal[row[k]] for row in rows] for k in (1, 2))
        axis.add_force(periodic_spline(spline_coefficients(orders, sines, cosines), periods))
        return
    for order, sine, cosine in rows:
        angle = 2.0 * math.pi * (p[order] * periods)
        axis.add_force(p[sine] * ca.sin(angle) + p[cosine] * ca.cos(angle))


def _find_fault(values: Mapping[str, Value]) -> Fault | None:
    """An order that is there twice."""
    orders = values[_ORDER.name]
    if isinstance(orders, tuple) and len(set(orders)) < len(orders):
        return Fault(_ORDER.name, "each number once")
    return None


DEFINITION = EffectDefinition(
    name="position_map",
    summary="force over position, of any shape that repeats",
    parameters=(
        # Of a turn a record may show the shorter sines alone.
        replace(pitch(0.032, 0.001), most=lambda extents: ROOM * max(extents.travel, 2.0 * math.pi)),
        _ORDER,
        _SINE,
        _COSINE,
    ),
    contribute=_contribute,
    fault=_find_fault,
    excitation=Excitation(
        "slow travel over the whole of a period, in both directions and at two speeds; where the axis never was a map "
        "is not determined",
        (Need("travel_m", 0.95, times="pitch_m"), Need("moving_s", 0.3)),
    ),
    confused_with={
        "force_ripple": "slow travel over several pitches: is there more in the pattern than one sine",
        "periodic_disturbance": "the same stroke at another speed: the pattern stays in place or stays in time",
        "position_spring": "travel over several pitches",
        "encoder_periodic_error": "the same stroke at twice the speed: an encoder's error makes four times the force",
        "position_dependent_friction": "the same stroke in both directions: friction changes sign, cogging does not",
    },
    moves=("travel",),
    simpler=Simpler(("force_ripple", "constant_offset", "position_spring")),
    search=Periodic(
        sine=ripple_search("sine_N", lambda m: np.ones(len(m.time))), order=_ORDER, cosine=_COSINE.name, room=ROOM
    ),
    linear=True,
)
