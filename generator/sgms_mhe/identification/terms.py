"""Forces that are linear in a number, beside those of the elements: viscous, inertial, of effects, of the sampling."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.model.effects import effect_definition, effect_names
from sgms_mhe.model.effects.motion import MotionRecord
from sgms_mhe.model.effects.search import Columns
from sgms_mhe.recordings.recording import Recording

Array = NDArray[np.float64]

LATE: Final = "late"
"""Name of the time [s] by which the force comes late."""
LAW_AND_SAMPLING: Final = ("viscous", "mass", LATE, "")
"""Names of terms that are no effects."""
TIMING: Final = 1.0
"""Samples that force and position are apart in time, one standard deviation: a drive holds its force for one."""


@dataclass(frozen=True, eq=False)
class Term:
    """Columns of force [N] per unit of their coefficients.

    Attributes:
        name: `viscous`, `mass`, `late`, or an effect's; empty where the columns say nothing of an axis.
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
    """Return the term of the moved mass minus that of the machine."""
    return Term("mass", rows.acceleration[:, None])


def sampling_terms(rows: Recording) -> tuple[Term, ...]:
    """Return the errors of sampling: of a force by its first derivative, of an acceleration by its second.

    Force and position are not of the same instant, be it by h: all of the force is then late, to first order. To second
    order the inertial force is off by half the second derivative of the acceleration times h^2, beside which the
    h^2 / 12 by which a second difference is low are little.
    """
    step, mass = rows.machine.sampling.step, rows.machine.plant.moved
    rate = -np.gradient(rows.signals.force) / step
    snap = np.gradient(np.gradient(rows.signals.acceleration)) / step**2
    return (
        Term(LATE, rows.reduce(rate)[:, None], deviation=TIMING * step),
        Term("", rows.reduce(snap)[:, None], deviation=0.5 * mass * (TIMING * step) ** 2),
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
        mass=rows.machine.plant.moved,
        deflection=0.0,
        extents=rows.extents,
    )
    found = []
    for name in effect_names(rows.machine.plant.kind):
        definition = effect_definition(name)
        if definition.companion and isinstance(definition.search, Columns):
            found.append(Term(name, definition.search.columns(motion, {})))
    return tuple(found)
