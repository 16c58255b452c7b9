"""Forces that are linear in a number, beside those of the elements: viscous, inertial, of effects, of the sampling."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.diagnosis.recording import Recording
from sgms_mhe.model.effects import effect_definition, effect_names
from sgms_mhe.model.effects.motion import MotionRecord
from sgms_mhe.model.effects.search import Columns

Array = NDArray[np.float64]

TIMING: Final = 0.1
"""Of a sample: how far force and position of any axis are apart in time, one standard deviation."""


@dataclass(frozen=True, eq=False)
class Term:
    """Columns of force [N] per unit of their coefficients.

    Attributes:
        name: `viscous`, `mass`, or an effect's; empty where the columns are of the sampling and say nothing of an axis.
        columns: on all rows (m, k).
        positive: whether the coefficients are at least 0; otherwise free in sign.
        deviation: of a prior about 0, in the coefficients' units; inf: none.
    """

    name: str
    columns: Array
    positive: bool = False
    deviation: float = math.inf


def viscous_term(rows: Recording) -> Term:
    """The speed at the instant of the force: the chain's is a mean over the sample before it, half a sample older."""
    velocity = rows.velocity + 0.5 * rows.machine.sampling.step * rows.acceleration
    return Term("viscous", velocity[:, None], positive=True)


def mass_term(rows: Recording) -> Term:
    """What the moved mass is more than that of the machine."""
    return Term("mass", rows.acceleration[:, None])


def sampling_terms(rows: Recording) -> tuple[Term, ...]:
    """What sampling leaves of an acceleration, by its first and second derivative.

    Force and position are not read at the same instant, and the second difference over a sample h is low by h^2 / 12 of
    the acceleration's own second derivative.
    """
    step, mass = rows.machine.sampling.step, rows.machine.plant.mass
    jerk = np.gradient(rows.signals.acceleration) / step
    snap = np.gradient(jerk) / step
    return (
        Term("", rows.reduce(jerk)[:, None], deviation=mass * TIMING * step),
        Term("", rows.reduce(snap)[:, None], deviation=mass * step**2 / 12.0),
    )


def companion_terms(rows: Recording) -> tuple[Term, ...]:
    """Effects that are looked for beside friction from the first, as they say themselves; free in sign."""
    nothing = np.zeros(len(rows.time))
    motion = MotionRecord(
        time=rows.time,
        position=rows.position,
        velocity=rows.velocity,
        acceleration=rows.acceleration,
        force=rows.force,
        friction=nothing,
        level=nothing,
        damping=0.0,
        mass=rows.machine.plant.mass,
        deflection=0.0,
        extents=rows.extents,
    )
    found = []
    for name in effect_names():
        definition = effect_definition(name)
        if definition.companion and isinstance(definition.search, Columns):
            found.append(Term(name, definition.search.columns(motion, {})))
    return tuple(found)
