"""Visible part of a force, once the base model's numbers have absorbed their share."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.configuration import override_machine
from sgms_mhe.host.compiled import CompiledModel
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import BASE_CAUSES
from sgms_mhe.recordings.series import row_means
from sgms_mhe.signals.chain import Signals, mean_samples, settle_samples, signal_array

Array = NDArray[np.float64]
_RATE: Final = 500.0  # of projections


_models: Final[dict[str, CompiledModel]] = {}
"""Compiled once per process and machine."""


def visible_share(machine: Machine, columns: Array, force: Array, others: Array | None = None) -> float:
    """Share of a force (RMS) that neither the base model's numbers (`columns`) nor other forces can take over."""
    factor = max(1, round(machine.sampling.rate / _RATE))
    start = settle_samples(machine) // factor + 2

    def reduced(series: Array) -> Array:
        return row_means(series, factor)[start:]

    f, free = reduced(force), reduced(columns)
    if others is not None:
        free = np.hstack((free, reduced(others)))
    scale = np.linalg.norm(free, axis=0)
    q, r = np.linalg.qr(free[:, scale > 0.0] / scale[scale > 0.0])
    q = q[:, np.abs(np.diag(r)) > 1e-8]
    norm = float(np.linalg.norm(f))
    return float(np.linalg.norm(f - q @ (q.T @ f))) / norm if norm > 0.0 else 0.0


def sensitivities(machine: Machine, plain: Signals) -> Array:
    """Derivatives of friction in the base model's numbers along a motion (n, k)."""
    model = _model(machine)
    n_x, n_p = model.model.n_x, model.model.n_p
    w = signal_array(plain, model.machine.sampling.step, mean=mean_samples(model.machine))
    friction, slopes = np.empty(len(plain)), np.empty((len(plain), n_p))
    model.advance(w, np.ones(n_p), np.zeros(n_x), np.zeros((n_x, n_p)), friction, slopes)
    return slopes


def _model(machine: Machine) -> CompiledModel:
    if machine.digest not in _models:
        friction, sampling = machine.friction, machine.sampling
        # Those that the friction is linear in, or nearly; of a number that is 0 there is no multiple.
        linear = [number.name for base in BASE_CAUSES.values() for number in base.numbers[:1]]
        names = [name for name in linear if name in friction.estimable]
        substeps = max(sampling.integrator.substeps, sampling.samples_per_update)
        changes = {
            "name": "base_numbers",
            "estimator": {"parameters": names},
            "sampling": {"integrator": {"substeps": substeps}},
            "code": {"precision": "double"},
        }
        plain = override_machine(machine, changes)
        _models[machine.digest] = CompiledModel(plain)
    return _models[machine.digest]
