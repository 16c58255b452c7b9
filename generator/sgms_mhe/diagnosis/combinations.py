"""Causes a record does not tell apart: combinations of their sizes it knows, by the joint information."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from scipy.stats import chi2

from sgms_mhe.diagnosis.fits import Fit, Subject, report_name
from sgms_mhe.diagnosis.parametrisation import ParameterGroup
from sgms_mhe.diagnosis.uncertainty import correlate, covariance, standard_deviations
from sgms_mhe.model.effects import effect_definition
from sgms_mhe.recordings.evidence import CONFIDENCE
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.decisions import log_decision
from sgms_mhe.support.statements import Rule, Statement


@dataclass(frozen=True)
class KnownCombination:
    """Combination of the sizes of two causes a record knows, where it knows neither: first + weight second.

    Attributes:
        causes: labels of both.
        parameters: a size of each, units at the ends of the names.
        weight: of the second one.
        value: of the combination.
        std: one standard deviation of it.
    """

    causes: tuple[str, str]
    parameters: tuple[str, str]
    weight: float
    value: float
    std: float

    def to_json(self) -> dict[str, Any]:
        """Return its entry in diagnosis.json."""
        first, second = (f"{label}.{name}" for label, name in zip(self.causes, self.parameters, strict=True))
        return {"of": [first, second], "weights": [1.0, self.weight], "value": self.value, "std": self.std}

    def state(self) -> Statement:
        """Return the statement on it."""
        first, second = (f"{label}.{name}" for label, name in zip(self.causes, self.parameters, strict=True))
        about, numbers = " and ".join(self.causes), {"first": first, "second": second}
        return Statement.of_number(Rule.COMBINATION, about, self.value, self.std, weight=self.weight, **numbers)


def find_combinations(
    subject: Subject, fit: Fit, other: Subject | None, groups: Sequence[tuple[ParameterGroup, str]]
) -> tuple[KnownCombination, ...]:
    """Return the combinations that stand for pairs of causes whose columns are collinear beside all else that is free.

    Such a pair together differs significantly from none, and neither does alone: the force explained by one, the other
    with the machine's numbers can explain as well.

    Args:
        subject: machine and record.
        fit: of the causes with every number of the machine free.
        other: as of `covariance`.
        groups: of the causes, and their labels.
    """
    sizes = {group: _sizes(fit, group) for group, _ in groups}
    joint = correlate(subject, fit, covariance(subject, fit, other))
    found = []
    for (one, label), (another, beside) in combinations(groups, 2):
        first, second = sizes[one], sizes[another]
        alone = [_is_significant(fit, joint, places) for places in (first, second)]
        together = _is_significant(fit, joint, (*first, *second))
        if first and second and together and not any(alone):
            i, k = (max(places, key=lambda j: abs(_change(fit, (j,))[0])) for places in (first, second))
            fixed = replace(fit, free=fit.free & (np.arange(len(fit.free)) != k))
            std = standard_deviations(covariance(subject, fixed, other), fixed)[i]
            found.append(_combine(fit, -float(joint[i, k] / joint[k, k]), std, (i, k), (label, beside)))
        log_decision(
            "verdict",
            "of two causes neither of which is significant alone, the record knows a combination",
            causes=[label, beside],
            significant_alone=alone,
            significant_together=together,
        )
    return tuple(found)


def _sizes(fit: Fit, group: ParameterGroup) -> tuple[int, ...]:
    """Places of a group's free sizes among the numbers of a fit."""
    return tuple(
        i
        for i, column in enumerate(fit.model.columns)
        if column.group == group
        and fit.interior[i]
        and (group.kind == "base" or effect_definition(group.cause).parameter(column.name).is_size)
    )


def _change(fit: Fit, places: Sequence[int]) -> Array:
    """Scaled difference of numbers from those of the file, or of an effect under test from none (places)."""
    columns = fit.model.columns
    none = [c.theta(c.none) if c.group.is_candidate else c.machine_theta for c in (columns[i] for i in places)]
    return np.asarray(fit.theta[list(places)] - np.array(none))


def _is_significant(fit: Fit, joint: Array, places: Sequence[int]) -> bool:
    """Return True if numbers together differ from none (Wald's test), by their covariance (n_p, n_p)."""
    if not places:
        return False
    change = _change(fit, places)
    inverse = np.linalg.pinv(joint[np.ix_(places, places)], hermitian=True)
    return bool(change @ inverse @ change > chi2.ppf(CONFIDENCE, len(places)))


def _combine(fit: Fit, slope: float, std: float, places: tuple[int, int], labels: tuple[str, str]) -> KnownCombination:
    """Return the combination of two sizes that is known best.

    Args:
        fit: its numbers.
        slope: weight of the second, scaled, at which the variance is least.
        std: of the first one, the second one fixed: that of the combination.
        places: of the two among the numbers.
        labels: of their causes.
    """
    one, other = (fit.model.columns[i] for i in places)
    weight = slope * one.scale / other.scale
    first, second = (column.si(float(fit.theta[i])) for column, i in zip((one, other), places, strict=True))
    names = (report_name(one.group, one.name), report_name(other.group, other.name))
    return KnownCombination(labels, names, weight, first + weight * second, std)
