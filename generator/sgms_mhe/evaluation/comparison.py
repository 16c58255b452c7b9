"""The emitted C against the reference solver on the same signals: how far apart they are, and how far they may be.

Differences are relative. Friction: to the range of the reference's friction; deflections: each to the range of its
own; parameters and standard deviations: to the reference's value. In single precision a parameter counts at the
updates where it is excited alone, which is where the data have brought its standard deviation below 90 % of the
prior's: elsewhere nothing holds it, and rounding moves it freely within its own uncertainty.

The status must be the same, but for a flag that compares a number with a limit (HOLD, SPEED, BOUND) at an update
where that number lies on the limit within the tolerance `status`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from sgms_mhe.emission.context import hold_path
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.machine import Machine
from sgms_mhe.model import FreeParameter
from sgms_mhe.reference import estimate_reference
from sgms_mhe.reference.plan import motion_of
from sgms_mhe.signals.chain import Signals
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.signals.status import FLAGS, select_flags
from sgms_mhe.support.arrays import Array, Index, Mask

Progress = Callable[[int, int], None]
"""Called with (updates done, updates in all)."""

EXCITED: Final = 0.9
"""A parameter is excited where its standard deviation is below this part of the prior's."""


@dataclass(frozen=True)
class Tolerance:
    """Largest relative differences; `status`: how close to its limit a number is to be for its flag to be undecided."""

    friction: float
    deflection: float
    parameter: float
    deviation: float
    status: float


TOLERANCES: Final = {
    "double": Tolerance(friction=1e-8, deflection=1e-8, parameter=1e-8, deviation=1e-8, status=1e-8),
    "single": Tolerance(friction=1e-4, deflection=1e-3, parameter=1e-3, deviation=1e-2, status=1e-3),
}


@dataclass(frozen=True)
class ComparedQuantity:
    """One column of the estimates on both sides.

    Attributes:
        name: column.
        difference: largest absolute difference over the updates that count [SI unit].
        relative: the largest relative one.
        tolerance: the largest relative one that is allowed.
        updates: how many updates count.
    """

    name: str
    difference: float
    relative: float
    tolerance: float
    updates: int

    @property
    def agrees(self) -> bool:
        """Return True if the difference is within tolerance; NaN never is."""
        return self.relative <= self.tolerance


@dataclass(frozen=True)
class Comparison:
    """The emitted C beside the reference.

    Attributes:
        machine: name.
        precision: of the C.
        updates: in all.
        quantities: friction, deflections, parameters, standard deviations.
        status_mismatches: updates whose status differs; none may.
        status_undecided: updates whose status differs only in flags that lie on their limits.
        bounds_active: updates with a parameter at its bound, (C, reference).
    """

    machine: str
    precision: str
    updates: int
    quantities: tuple[ComparedQuantity, ...]
    status_mismatches: int
    status_undecided: int
    bounds_active: tuple[int, int]

    @property
    def agrees(self) -> bool:
        """Return True if everything is within tolerance."""
        return self.status_mismatches == 0 and all(quantity.agrees for quantity in self.quantities)


def compare_estimates(
    machine: Machine, generated: Estimates, reference: Estimates, prior_std: Array, undecided: Index | None = None
) -> Comparison:
    """Compare two sets of estimates of the same signals.

    Args:
        machine: the machine; its precision decides the tolerances.
        generated: of the C, u updates.
        reference: of the reference solver, u updates.
        prior_std: standard deviation of the parameters' prior, SI units (n_p).
        undecided: flags of the status that may differ at each update (u); None: none.
    """
    if len(generated) != len(reference):
        raise ValueError(f"{len(generated)} updates against {len(reference)}")
    precision, units = machine.code.precision, machine.plant.units
    tolerance = TOLERANCES[precision]
    everywhere = np.ones(len(reference), dtype=np.bool_)
    rows = [("friction_N", generated.friction_N, reference.friction_N, tolerance.friction)]
    deflections = zip(generated.z_m.T, reference.z_m.T, strict=True)
    rows += [(f"z_{i + 1}_m", ours, theirs, tolerance.deflection) for i, (ours, theirs) in enumerate(deflections)]
    quantities = [
        _quantity(units.named(name), ours, theirs, float(np.ptp(theirs)) if len(theirs) else 0.0, allowed, everywhere)
        for name, ours, theirs, allowed in rows
    ]
    flags = generated.status ^ reference.status
    flags[(flags != 0) & (np.minimum(generated.status, reference.status) < 0)] = -1  # refused is no flag: all differ
    decided = flags if undecided is None else flags & ~undecided
    excited = (
        reference.std < EXCITED * prior_std if precision == "single" else np.ones(reference.std.shape, dtype=np.bool_)
    )
    for kind, prefix, allowed in (("parameters", "", tolerance.parameter), ("std", "std_", tolerance.deviation)):
        for k, name in enumerate(reference.parameter_names):
            ours, theirs = getattr(generated, kind)[:, k], getattr(reference, kind)[:, k]
            quantities.append(
                _quantity(f"{prefix}{units.named(name)}", ours, theirs, np.abs(theirs), allowed, excited[:, k])
            )
    return Comparison(
        machine=machine.name,
        precision=precision,
        updates=len(reference),
        quantities=tuple(quantities),
        status_mismatches=int(np.count_nonzero(decided)),
        status_undecided=int(np.count_nonzero(flags)) - int(np.count_nonzero(decided)),
        bounds_active=(_bounds(generated), _bounds(reference)),
    )


def compare_signals(machine: Machine, signals: Signals, *, progress: Progress | None = None) -> Comparison:
    """Run the emitted C and the reference on aligned signals and compare them."""
    estimator = CompiledEstimator(machine)
    generated = estimator.estimate(signals, progress=progress)  # reports too, so that it can be interrupted
    reference = estimate_reference(machine, signals, progress=progress)
    flags = undecided_flags(machine, signals, reference, estimator.model.parameters)
    return compare_estimates(machine, generated, reference, estimator.model.prior_std, flags)


def undecided_flags(
    machine: Machine, signals: Signals, estimates: Estimates, parameters: Sequence[FreeParameter]
) -> Index:
    """Flags that at each update (u) depend on a number which lies on its limit, within the tolerance `status`."""
    tolerance = TOLERANCES[machine.code.precision].status
    samples, updates = machine.sampling.samples_per_update, len(estimates)
    velocity = signals.velocity[1 : 1 + updates * samples].reshape(updates, samples)
    speed, step = np.abs(velocity), machine.sampling.step
    hold, fastest = hold_path(machine), machine.sampling.max_velocity
    motion = motion_of(speed.sum(axis=1) * step, velocity.sum(axis=1) * step, hold)
    at_hold = np.abs(motion - hold) <= tolerance * hold
    at_speed = np.abs(speed.max(axis=1, initial=0.0) - fastest) <= tolerance * fastest
    at_bound = np.zeros(updates, dtype=np.bool_)
    for parameter, values in zip(parameters, estimates.parameters.T, strict=True):
        theta = 1.0 + (values - parameter.nominal) / parameter.scale
        for bound in (parameter.lower, parameter.upper):
            if np.isfinite(bound):
                at_bound |= np.abs(theta - bound) <= tolerance * max(1.0, abs(bound))
    flags = np.zeros(updates, dtype=np.int64)
    for name, mask in (("hold", at_hold), ("speed", at_speed), ("bound", at_bound)):
        flags[mask] |= FLAGS[name]
    return flags


def _bounds(estimates: Estimates) -> int:
    return int(np.count_nonzero(select_flags(estimates.status)["bound"]))


def _quantity(
    name: str, generated: Array, reference: Array, unit: Array | float, tolerance: float, counts: Mask
) -> ComparedQuantity:
    difference = np.abs(generated - reference)[counts]
    unit = np.broadcast_to(unit, len(reference))[counts]
    # Where there is nothing to relate to (a friction that is zero throughout), only equality agrees.
    relative = np.divide(difference, unit, out=np.where(difference == 0.0, 0.0, np.inf), where=unit > 0.0)
    return ComparedQuantity(
        name=name,
        difference=_largest(difference),
        relative=_largest(relative),
        tolerance=tolerance,
        updates=int(np.count_nonzero(counts)),
    )


def _largest(values: Array) -> float:
    return float(np.max(values, initial=0.0))  # NaN stays NaN
