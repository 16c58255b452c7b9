"""Offset, level, damping and moved mass of each of several records beside a fit with their means."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sgms_mhe.identification.fits import NOTHING, AxisFit, NumberEstimate, RecordView
from sgms_mhe.identification.search import Views
from sgms_mhe.identification.terms import (
    DAMPING_OF_RECORD,
    LEVEL_OF_RECORD,
    MASS_OF_RECORD,
    OFFSET_OF_RECORD,
    Term,
    record_sizes,
    record_terms,
)
from sgms_mhe.identification.writing import OFFSET
from sgms_mhe.machine import Units
from sgms_mhe.support.arrays import Array


def fit_record_terms(views: Views, fit: AxisFit) -> tuple[Term, ...]:
    """Return the terms a record may own, the level along a fit's elements: of the same stiffness, to first order."""
    lengths, count = [motion.rows for motion in views.coarse.motions], len(fit.levels)
    force = fit.elements @ fit.levels + fit.jacobian[:, :count].sum(axis=1)
    return record_terms(views.fine.rows, lengths, force / max(fit.coulomb, NOTHING))


def add_spread(view: RecordView, fit: AxisFit, numbers: dict[str, NumberEstimate]) -> dict[str, NumberEstimate]:
    """Return the numbers, a record's own with the spread over the records."""
    own = {
        "coulomb": find_record_levels(view, fit),
        "viscous": record_sizes(fit.coefficient(DAMPING_OF_RECORD)),
        "mass": record_sizes(fit.coefficient(MASS_OF_RECORD)),
    }
    for name, values in own.items():
        if len(values) > 1 and name in numbers:
            numbers[name] = replace(numbers[name], spread=float(np.std(values, ddof=1)))
    return numbers


def find_record_levels(view: RecordView, fit: AxisFit) -> Array:
    """Return the Coulomb level of each record (k) [N]; none where all have the same."""
    scales, term = np.array([motion.scale for motion in view.motions]), fit.coefficient(LEVEL_OF_RECORD)
    if not len(term):
        return fit.coulomb * scales if np.ptp(scales) > 0.0 else scales[:0]
    return np.asarray(fit.coulomb * scales + record_sizes(term))


def find_followed(view: RecordView, fit: AxisFit) -> dict[str, float]:
    """Return the largest deviation from the mean of what differs between records, by the name of its parameter.

    As in `[estimator.prior]`: of the offset [N], relative of level and damping.
    """
    damping = float(fit.coefficient("viscous").sum())
    found = {
        OFFSET: record_sizes(fit.coefficient(OFFSET_OF_RECORD)),
        "coulomb": find_record_levels(view, fit) / max(fit.coulomb, NOTHING) - 1.0,
        "viscous": record_sizes(fit.coefficient(DAMPING_OF_RECORD)) / damping if damping > 0.0 else np.empty(0),
    }
    return {name: float(f"{np.max(np.abs(sizes)):.3g}") for name, sizes in found.items() if np.any(sizes)}


def list_record_numbers(names: Sequence[str], view: RecordView, fit: AxisFit, units: Units) -> tuple[str, ...]:
    """Return the sentences on each record's own numbers; the file has the means."""
    kinds = (OFFSET_OF_RECORD, DAMPING_OF_RECORD, MASS_OF_RECORD)
    offsets, damping, mass = (record_sizes(fit.coefficient(name)) for name in kinds)
    mean = "; the file has the mean over records, and its estimator follows each"
    if len(mass):
        mass = mass + view.rows.machine.plant.moved + float(fit.coefficient("mass").sum())
    stated = (
        ("offset beside the mean", offsets, units.force, mean),
        ("Coulomb level", find_record_levels(view, fit), units.force, mean),
        ("damping", damping + float(fit.coefficient("viscous").sum()), units.damping, mean),
        (f"{units.inert}, payload included", mass, units.mass, ""),
    )
    said = []
    for name, values, unit, end in stated:
        if len(values) > 1:
            pairs = zip(names, values.tolist(), strict=True)
            said.append(f"{name}: {', '.join(f'{value:.4g} {unit} in {record}' for record, value in pairs)}{end}")
    return tuple(said)
