"""What kind of package a machine gets: the choices by which whole pieces of the emitted code come or stay away."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sgms_mhe.model import Model


@dataclass(frozen=True)
class Variant:
    """The choices of one package; templates ask for them by name.

    Attributes:
        single: single precision.
        horizon: intervals of the window; 0 for the filter.
        relinearise: which older intervals an update linearises anew; "newest" where there are none.
        fixed: the arrival cost keeps its weights.
        bounded: a parameter has a bound.
        resumes: the sweep begins where something has changed: the factor before an interval stays what it is while
            linearisations are kept and the output is affine in what is estimated.
        merges: a step of the series is a line through several samples.
        self_scaling: readings are weighed by how well they were predicted.
    """

    single: bool
    horizon: int
    relinearise: Literal["all", "auto", "newest"]
    fixed: bool
    bounded: bool
    resumes: bool
    merges: bool
    self_scaling: bool

    @property
    def has_series(self) -> bool:
        """Whether the series of older intervals is kept, because they may be integrated again."""
        return self.relinearise != "newest"

    @property
    def keeps_inner(self) -> bool:
        """Whether the readings inside an older interval stay as they were linearised."""
        return self.horizon > 0 and self.relinearise != "all"

    @property
    def drifts(self) -> bool:
        """Whether the parameters' drift enters; where the arrival cost is fixed there is nothing for it to enter."""
        return not (self.fixed and self.horizon)


def variant_of(model: Model) -> Variant:
    """The choices that a machine and its model ask for."""
    machine = model.machine
    sampling, estimator = machine.sampling, machine.estimator
    horizon = estimator.horizon if estimator.kind == "mhe" else 0
    # The newest interval is integrated as it is sampled: only older ones need their series again, or lanes.
    relinearise = estimator.relinearise if horizon > 1 else "newest"
    fixed = estimator.arrival_cost.update == "fixed"
    bounds = [edge for p in model.parameters for edge in (p.lower, p.upper)]
    return Variant(
        single=machine.code.precision == "single",
        horizon=horizon,
        relinearise=relinearise,
        fixed=fixed,
        bounded=bool(np.any(np.isfinite(bounds))),
        resumes=horizon > 0 and relinearise != "all" and not fixed and model.output_is_affine,
        merges=sampling.merged > 1,
        self_scaling=estimator.noise.self_scaling,
    )
