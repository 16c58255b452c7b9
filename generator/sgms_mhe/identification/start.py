"""The convex start of an identification: records with their levels, and the terms beside the elements."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from sgms_mhe.identification.elements import NO_RISE, run_elements
from sgms_mhe.identification.fits import RecordView
from sgms_mhe.identification.records import Records, drop_start, scale_levels
from sgms_mhe.identification.search import MATERIAL, Progress, Views
from sgms_mhe.identification.spectrum import PER_DECADE, Spectrum, distance_grid, find_spectrum
from sgms_mhe.identification.terms import (
    LEVEL_OF_RECORD,
    Term,
    companion_terms,
    level_terms,
    mass_term,
    record_sizes,
    record_terms,
    sampling_terms,
    transmitted_force,
    viscous_term,
)
from sgms_mhe.recordings.evidence import noise_floor
from sgms_mhe.recordings.recording import Recording
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.decisions import log_decision

SCALINGS: Final = 2
"""Times that the levels of records are found beside each other [1]: each to first order."""
LEAST_SCALE: Final = 0.1
"""Least factor that a level changes by in one of them [1]."""


@dataclass(frozen=True, eq=False)
class Begun:
    """Records with their levels, the convex start, and the terms beside the elements that are no effects."""

    records: Records
    views: Views
    spectrum: Spectrum
    base: tuple[Term, ...]


def begin(records: Records, per_decade: float, report: Progress) -> Begun:
    """Start from the convex fit of records; `per_decade`: distances of its grid."""
    report("convex start")
    # Which rows count is no matter of where the search starts: of one grid, whatever the start's is.
    records = drop_start(records, _start(records, PER_DECADE)[1].reach)
    records, spectrum, base = _start(records, per_decade)
    rows, grid = records.rows, distance_grid(records, per_decade)
    noise, limits = noise_floor(rows, rows.friction), (float(grid[0]), float(grid[-1]))
    fine = RecordView(rows, records.fine, noise, limits, records.steps_inertia, records.misread, records.thinned)
    return Begun(records, Views(RecordView(rows, records.coarse, noise, limits), fine), spectrum, base)


def _start(records: Records, per_decade: float) -> tuple[Records, Spectrum, tuple[Term, ...]]:
    """Return the records with their levels, the convex start, and the terms beside the elements that are no effects."""
    rows, grid = records.rows, distance_grid(records, per_decade)
    base: tuple[Term, ...] = (viscous_term(rows), mass_term(rows), *sampling_terms(rows))
    beside, noise = companion_terms(rows), noise_floor(rows, rows.friction)
    spectrum = find_spectrum(records, (*base, *beside), noise, grid)
    records, base, spectrum = _separate_records(records, base, beside, spectrum, noise, grid)
    terms, level = (*base, *beside), start_level_terms(rows, base, spectrum)
    if level:
        spectrum = find_spectrum(records, (*terms, *level), noise, grid)
    return records, spectrum, base


def _separate_records(
    records: Records, base: Sequence[Term], beside: Sequence[Term], spectrum: Spectrum, noise: float, grid: Array
) -> tuple[Records, tuple[Term, ...], Spectrum]:
    """Return records, terms and convex start with a record's own terms, where their residual is clearly smaller.

    Args:
        records: all logs.
        base: terms that are no effects.
        beside: effects that may be there.
        spectrum: convex start with these terms.
        noise: of a row [N].
        grid: break-away distances [m].
    """
    own: list[Term] = []
    left = list(_record_terms(records, spectrum))
    while left:
        tried = [find_spectrum(records, (*own, term, *base, *beside), noise, grid) for term in left]
        best = min(range(len(left)), key=lambda k: tried[k].loss)
        if not tried[best].loss < (1.0 - MATERIAL) ** 2 * spectrum.loss:
            break
        spectrum = tried[best]
        own.append(left.pop(best))
    names = [term.name for term in own]
    for _ in range(SCALINGS if LEVEL_OF_RECORD in names else 0):
        first = names.index(LEVEL_OF_RECORD) * (len(records.names) - 1)
        sizes = record_sizes(spectrum.coefficients[first : first + len(records.names) - 1])
        factors = np.maximum(1.0 + sizes / float(spectrum.levels.sum()), LEAST_SCALE)
        records = scale_levels(records, factors.tolist())
        anew = {term.name: term for term in _record_terms(records, spectrum)}
        own = [anew[name] for name in names]
        spectrum = find_spectrum(records, (*own, *base, *beside), noise, grid)
    log_decision("records", "what belongs to each record, where it leaves clearly less", own=names)
    return records, (*own, *base), spectrum


def _record_terms(records: Records, spectrum: Spectrum) -> tuple[Term, ...]:
    """Return the terms of a record and not of the axis, the level along the convex start's elements."""
    if len(records.names) < 2 or not len(spectrum.distances):
        return ()
    runs = run_elements(records.coarse, "switching", spectrum.distances, spectrum.rise or NO_RISE)
    force = (runs.chi + runs.jacobian[..., 0]) @ spectrum.levels
    lengths = [motion.rows for motion in records.coarse]
    return record_terms(records.rows, lengths, force / float(spectrum.levels.sum()))


def start_level_terms(rows: Recording, base: Sequence[Term], spectrum: Spectrum) -> tuple[Term, ...]:
    """Return the effects of the level beside a convex start, base terms and companions."""
    terms = (*base, *companion_terms(rows))
    count = sum(term.columns.shape[1] for term in terms)
    return level_terms(
        rows, transmitted_force(rows, terms, spectrum.coefficients[:count]), spectrum.sliding, spectrum.rise
    )
