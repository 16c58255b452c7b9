"""Parts of a diagnosis: causes, candidates and numbers as they are reported."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from sgms_mhe.support.arrays import Array

StandsFor = Literal["", "curve over speed", "what has no name"]
Outcome = Literal["named", "redundant", "too small", "not significant"]
"""Of a candidate in a round: added; good, but another was better; found, but less than matters; not found."""


@dataclass(frozen=True)
class Rms:
    """RMS of measured minus simulated friction [N], on the segments the fit saw and on those it did not."""

    before: float
    after: float
    held_out_before: float
    held_out_after: float


@dataclass(frozen=True)
class Cause:
    """A named cause.

    Attributes:
        name: of an effect, or of numbers of the base model.
        label: name within the extended machine (`force_ripple_2` for the second of its name).
        parameters: values, units in their names (a wrong base number: `coulomb_N`, `stiffness_1_N_m`, ...).
        std: one standard deviation of each, robust to coloured residuals; NaN where the data do not tell.
        nominal: values of the machine file for a wrong base number, else empty.
        rms: without and with this cause, everything else in place.
        gain_N: RMS of the force this cause explains on held-out data.
        gain_interval_N: 95 % interval of `gain_N` over held-out blocks.
        p_value: of the score test against the model without it, multiplicity included.
        vague: parameters the record does not determine.
        stands_for: the whole, where it is a part and no cause of its own: a curve over speed of another form, which is
            left or named beside it; or a force without a name, which it predicts though it is not certain or changes.
        transfers: whether it holds on the other records; None: there are none, or none of them shows it.
    """

    name: str
    label: str
    parameters: Mapping[str, float]
    std: Mapping[str, float]
    nominal: Mapping[str, float]
    rms: Rms
    gain_N: float
    gain_interval_N: tuple[float, float]
    p_value: float
    vague: tuple[str, ...] = ()
    stands_for: StandsFor = ""
    transfers: bool | None = None


@dataclass(frozen=True)
class Score:
    """Score of one candidate in one step of the forward selection.

    Attributes:
        name: candidate.
        round: 1 is the first search over the refitted base model.
        p_value: autocorrelation-robust score test, multiplicity included.
        gain_N: RMS of the force it explains by cross-validation in the linear approximation (negative gains: 0).
        refit_gain_N: the same after the non-linear refit, NaN where it was not refitted.
        parameters: where its search ended.
        outcome: see `Outcome`.
    """

    name: str
    round: int
    p_value: float
    gain_N: float
    refit_gain_N: float
    parameters: Mapping[str, float]
    outcome: Outcome


@dataclass(frozen=True)
class Alternative:
    """A candidate that was not named, and why; `rival` if the data cannot tell it from a named one.

    `parameters`: of its refit; `excess_N`: RMS of the force by which it fits worse than the replaced cause.
    """

    name: str
    why_not: str
    rival: bool
    instead_of: str | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    excess_N: float = math.nan


@dataclass(frozen=True, eq=False)
class RivalFit:
    """Fit of a rival in a cause's place, which did not see the held-out segments.

    Attributes:
        name: of the rival.
        instead_of: cause whose place it takes.
        rms_N, held_out_rms_N: RMS of measured minus simulated friction on the segments the fit saw, and on those
            it did not.
        residual_N: measured minus simulated (m), in step with `Traces`.
    """

    name: str
    instead_of: str
    rms_N: float
    held_out_rms_N: float
    residual_N: Array


@dataclass(frozen=True)
class BaseParameter:
    """A number of the base model, as the file has it and as the refit found it (`std` robust; NaN: not excited)."""

    name: str
    nominal: float
    refitted: float
    std: float


@dataclass(frozen=True)
class RefutedNumber:
    """A number of the machine file the record refutes: the file's value, the record's, one standard deviation."""

    name: str
    file: float
    record: float
    std: float


@dataclass(frozen=True)
class PlainFriction:
    """Residual of Coulomb and viscous friction by least squares, mass and an offset beside them.

    RMS on the segments the fit saw, on those that it did not, and of the force there [N].
    """

    rms: float
    held_out: float
    force: float
