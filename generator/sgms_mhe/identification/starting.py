"""The numbers of an axis with so many elements, from its friction alone: where a fit that knows more may start."""

from __future__ import annotations

from typing import Final

import numpy as np

from sgms_mhe.identification.fitting import Shape, View, fit_axis
from sgms_mhe.identification.records import Records, behind_filters
from sgms_mhe.identification.search import split_distances
from sgms_mhe.identification.spectrum import distance_grid, find_spectrum
from sgms_mhe.identification.terms import companion_terms, mass_term, sampling_terms, viscous_term
from sgms_mhe.recordings.recording import Recording

LEAST_SHARE: Final = 1e-3
"""Of all levels: what an element starts from that the fit has no use for."""
ITERATIONS: Final = 12


def element_numbers(recording: Recording, noise: float) -> dict[str, float]:
    """Numbers of the elements, viscous friction and the rise towards low speed, by their names in results [SI].

    A spectrum of break-away distances by nonnegative least squares, as many clusters of it as the recording's machine
    has elements, and their nonlinear fit, as elements that switch whatever the machine's law: the laws differ by less
    than a start is off. Of the machine's numbers only the order counts in which its elements break away: the one that
    does first is still called what the machine calls it.

    Args:
        recording: rows of a log, behind the chain.
        noise: of a row [N].

    Returns:
        Nothing where there is no friction.
    """
    friction = recording.machine.friction
    records = Records(recording.machine, ("",), recording, (behind_filters(recording),), (), 0.0, ())
    terms = (viscous_term(recording), mass_term(recording), *sampling_terms(recording), *companion_terms(recording))
    grid = distance_grid(records)
    spectrum = find_spectrum(records, terms, noise, grid)
    if not len(spectrum.distances):
        return {}
    view = View(recording, records.coarse, noise, (float(grid[0]), float(grid[-1])))
    start = Shape("switching", split_distances(spectrum, friction.n_z), spectrum.rise)
    found = fit_axis(view, terms, start, iterations=ITERATIONS)
    if not found.coulomb > 0.0:  # the spectrum had a trace of a level, the fit at this rate has no use for it
        return {}
    levels = np.maximum(found.levels, LEAST_SHARE * found.coulomb)
    coulomb = float(levels.sum())
    numbers = {"coulomb": coulomb, "viscous": float(found.coefficient("viscous")[0])}
    own = np.argsort(np.array(friction.fraction) / np.array(friction.stiffness))
    for place, level, distance in zip(own.tolist(), levels.tolist(), found.shape.distances.tolist(), strict=True):
        numbers[f"stiffness_{place + 1}"] = level / distance
        numbers[f"fraction_{place + 1}"] = level / coulomb
    if found.shape.rise is not None:
        numbers |= {"stribeck_ratio": found.shape.rise.ratio, "stribeck_velocity": found.shape.rise.velocity}
    return numbers
