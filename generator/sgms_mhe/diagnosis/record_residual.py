"""Residual and noise floor of a machine along a log, as a diagnosis states them of a machine as it is."""

import math
from dataclasses import asdict, dataclass

import numpy as np

from sgms_mhe.configuration import step_every_sample
from sgms_mhe.diagnosis.verdict import SMEARED
from sgms_mhe.host.compiled import CompiledModel
from sgms_mhe.machine import Machine, Units
from sgms_mhe.recordings.evidence import largest_force, misread_forces, noise_floor
from sgms_mhe.recordings.recording import Recording, add_encoder, prepare
from sgms_mhe.recordings.series import row_means
from sgms_mhe.signals.chain import apply_chain
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.arrays import Array


@dataclass(frozen=True)
class MachineResidual:
    """Residual of a machine along a record it was not fitted to, in decimated samples.

    Attributes:
        rms_N: measured minus simulated friction, RMS [N].
        held_out_N: the same on the third of the record a diagnosis holds out, RMS [N].
        noise_floor_N: noise of the measured friction, RMS [N].
        rate_Hz: decimated samples per second [Hz].
    """

    rms_N: float
    held_out_N: float
    noise_floor_N: float
    rate_Hz: float

    def describe(self, units: Units) -> str:
        """Return both numbers in words."""
        return (
            f"residual {self.rms_N:.3g} {units.force}, noise floor {self.noise_floor_N:.3g} {units.force} at "
            f"{self.rate_Hz:g} Hz"
        )

    def to_json(self) -> dict[str, float]:
        """Plain data, keys as of a linear axis."""
        return asdict(self)


def measure_residual(machine: Machine, log: Log) -> MachineResidual:
    """Compare simulated with measured friction along a log, at the rate of a diagnosis.

    Raises:
        InputError: the log has fewer samples than a diagnosis needs.
    """
    record = add_encoder(prepare(machine, log), log)
    model = CompiledModel(step_every_sample(machine))
    simulated = record.reduce(model.predict(record.signals))
    residual, encoder = record.friction - simulated, record.steps_inertia
    if record.unfiltered is not None:
        unfiltered = _friction_before_chain(model, record, record.unfiltered)
        smear = unfiltered - simulated
        if np.all(np.isfinite(smear)) and record.rms(smear) > SMEARED * noise_floor(record, residual):
            residual = residual - smear
    if encoder is not None and record.misread is not None:
        friction = [_friction_before_chain(model, record, motion) for motion in record.misread_motions()]
        found = largest_force(record, misread_forces(encoder, friction))
        encoder = encoder if found is None else found
    held_out = residual[record.rows_held_out()]
    return MachineResidual(
        rms_N=record.rms(residual),
        held_out_N=float(np.sqrt(np.mean(held_out**2))) if len(held_out) else math.nan,
        noise_floor_N=noise_floor(record, residual, encoder),
        rate_Hz=record.rate,
    )


def _friction_before_chain(model: CompiledModel, record: Recording, motion: Array) -> Array:
    """Return a model's friction (m) [N] along a motion before the chain (n, 4), behind the chain."""
    friction = apply_chain(record.machine, model.predict(record.signals.before_chain(motion)))
    return row_means(friction, record.factor)[: len(record.time)]
