"""Where the elements' numbers start, whatever the machine file says: identification's convex start and its fit."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.diagnosis.subject import Fit, Subject
from sgms_mhe.identification.elements import Law
from sgms_mhe.identification.fitting import AxisFit, Shape, View, fit_axis
from sgms_mhe.identification.records import Motion, Records
from sgms_mhe.identification.search import split_distances
from sgms_mhe.identification.spectrum import distance_grid, find_spectrum
from sgms_mhe.identification.terms import companion_terms, mass_term, sampling_terms, viscous_term
from sgms_mhe.recordings.recording import Recording

Array = NDArray[np.float64]

LEAST_SHARE: Final = 1e-3
"""Of all levels: what an element starts from that the convex fit has no use for."""
ITERATIONS: Final = 12


def convex_start(subject: Subject, fit: Fit) -> dict[str, float]:
    """Numbers of the elements, viscous friction and rise towards low speed to start from, by column [SI].

    The friction that a fit's effects do not explain, as identification from nothing sees it: a spectrum of break-away
    distances by nonnegative least squares, as many clusters of it as the machine has elements, and their nonlinear fit
    under the machine's law. Which numbers the machine file has, and where the fit stopped, does not matter.

    Returns nothing where there is no friction.
    """
    friction = subject.machine.friction
    recording = _without_effects(subject, fit)
    motion = Motion(recording.machine, recording.rate, np.ascontiguousarray(recording.velocity), 1,
                    len(recording.time), filtered=False)  # fmt: skip
    records = Records(recording.machine, ("",), recording, (motion,), (), 0.0, ())
    terms = (
        viscous_term(recording),
        mass_term(recording),
        *sampling_terms(recording),
        *companion_terms(recording),
    )
    grid = distance_grid(records)
    spectrum = find_spectrum(records, terms, subject.noise, grid)
    if not len(spectrum.distances):
        return {}
    law: Law = "switching" if friction.switches else "sgms"
    view = View(recording, records.coarse, subject.noise, (float(grid[0]), float(grid[-1])))
    distances = split_distances(spectrum, friction.n_z)
    found = fit_axis(view, terms, Shape(law, distances, spectrum.rise), iterations=ITERATIONS)
    return _columns(found, subject)


def _without_effects(subject: Subject, fit: Fit) -> Recording:
    """The record without the force of the effects under test."""
    recording = subject.recording
    if not fit.extras:
        return recording
    alone = subject.model(())
    theta = subject.start(alone, (), fit)
    friction = recording.friction - (subject.friction(fit) - alone.run(recording, theta, derivatives=False)[0])
    return replace(recording, friction=friction)


def _columns(found: AxisFit, subject: Subject) -> dict[str, float]:
    """The numbers by column; the element that breaks away first is the machine's that does, and so on."""
    friction = subject.machine.friction
    levels = np.maximum(found.levels, LEAST_SHARE * found.coulomb)
    coulomb = float(levels.sum())
    own = np.array(friction.fraction) / np.array(friction.stiffness)
    numbers = {"coulomb": coulomb, "viscous": float(found.coefficient("viscous")[0])}
    for place, level, distance in zip(np.argsort(own), levels, found.shape.distances, strict=True):
        numbers[f"stiffness_{place + 1}"] = float(level / distance)
        numbers[f"fraction_{place + 1}"] = float(level / coulomb)
    if found.shape.rise is not None:
        numbers |= {"stribeck_ratio": found.shape.rise.ratio, "stribeck_velocity": found.shape.rise.velocity}
    columns = {column.name for column in subject.model(()).columns if not column.group.is_extra}
    return {name: value for name, value in numbers.items() if name in columns}
