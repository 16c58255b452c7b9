"""How sure the numbers of a fitted axis are."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.identification.fitting import AxisFit, View
from sgms_mhe.recordings.evidence import UNSEEN_ERROR, noise_floor, robust_covariance

Array = NDArray[np.float64]


def covariance(view: View, fit: AxisFit) -> Array:
    """Covariance (p, p) of log D (k), levels (k), beta and log v_s where there is a rise, and the coefficients.

    Noise and what the model gets wrong (`robust_covariance`): its RMS beyond the noise floor, or `unseen` of that,
    which it may hide. 0 where a level or a coefficient is held at 0.
    """
    rows = view.rows
    loose = np.any(fit.slopes != 0.0, axis=0)
    X = fit.slopes[:, loose]
    scale = np.sqrt(np.maximum(np.sum(X[rows.used] ** 2, axis=0) + fit.prior[loose], 1e-300))
    X = X / scale
    H = X[rows.used].T @ X[rows.used] + np.diag(fit.prior[loose] / scale**2)
    inverse = np.asarray(np.linalg.pinv(H, hermitian=True, rcond=1e-14))
    floor = noise_floor(rows, fit.residual)
    wrong = max(math.sqrt(max(0.0, fit.cross_rms**2 - floor**2)), UNSEEN_ERROR * floor)
    result = np.zeros((len(loose), len(loose)))
    inner = robust_covariance(rows, X, fit.residual, H, inverse, wrong)
    result[np.ix_(loose, loose)] = inner / np.outer(scale, scale)
    return result


@dataclass(frozen=True)
class Quantity:
    """A number and its standard deviation."""

    value: float
    std: float

    @property
    def relative(self) -> float:
        """Standard deviation over the value's size; inf where that is 0."""
        return self.std / abs(self.value) if self.value != 0.0 else math.inf


def quantities(fit: AxisFit, cov: Array) -> dict[str, Quantity]:
    """The friction law's numbers with their deviations, named as in a machine file.

    `coulomb`, `viscous`, `stribeck_ratio`, `stribeck_velocity`, `stiffness_k`, `fraction_k`; what the fit does not have
    is left out. Where all levels are 0 shares have no meaning and are NaN.
    """
    count, level = len(fit.levels), fit.coulomb
    p = len(cov)
    found: dict[str, Quantity] = {}

    def add(name: str, value: float, gradient: Array) -> None:
        found[name] = Quantity(value, math.sqrt(max(0.0, float(gradient @ cov @ gradient))))

    total = np.zeros(p)
    total[count : 2 * count] = 1.0
    add("coulomb", level, total)
    for k, (own, distance) in enumerate(zip(fit.levels.tolist(), fit.shape.distances.tolist(), strict=True)):
        stiffness = np.zeros(p)
        stiffness[k], stiffness[count + k] = -own / distance, 1.0 / distance
        add(f"stiffness_{k + 1}", own / distance, stiffness)
        if level > 0.0:
            share = -own / level**2 * total
            share[count + k] += 1.0 / level
            add(f"fraction_{k + 1}", own / level, share)
        else:
            found[f"fraction_{k + 1}"] = Quantity(math.nan, math.nan)
    rise = fit.shape.rise
    if rise is not None:
        for place, name, value, unit in (
            (2 * count, "stribeck_ratio", rise.ratio, 1.0),
            (2 * count + 1, "stribeck_velocity", rise.velocity, rise.velocity),
        ):
            add(name, value, unit * np.eye(p)[place])
    for name in ("viscous", "mass"):
        column = fit.place(name)
        if column.stop:
            add(name, float(fit.coefficient(name)[0]), np.eye(p)[column.start])
    return found
