"""Errors of the emitted integrator at an interval's end, and of its derivatives, against a converged solution."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sgms_bench.benchmark.peers import Windows
from sgms_mhe.emission.package import Package
from sgms_mhe.host.compiled import CompiledModel
from sgms_mhe.machine import Machine
from sgms_mhe.reference.linearised import Linearised
from sgms_mhe.signals.chain import Signals, mean_samples, signal_array
from sgms_mhe.signals.logs import Log

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SampledMotion:
    """A simulated log of U updates, windows of it, and what a converged integration makes of their intervals.

    Attributes:
        name: of the motion.
        log: of the axis.
        signals: after the signal chain.
        windows: as the peers take them; their nodes lie on the way of the nominal model.
        first: node at which each window begins.
        exact: the windows' intervals, window by window.
    """

    name: str
    log: Log
    signals: Signals
    windows: Windows
    first: tuple[int, ...]
    exact: tuple[Linearised, ...]


def emitted_errors(machine: Machine, package: Package, recording: SampledMotion) -> tuple[float | None, float | None]:
    """Largest errors of the emitted state and of its derivatives over all intervals of the windows."""
    sampling = machine.sampling
    samples = sampling.samples_per_update
    model = CompiledModel(machine, package)
    n_x, n_p = model.model.n_x, model.model.n_p
    # d_x1 = A d_x0 + B: columns of the identity for d_x0, as many at a time as there are parameters.
    seeds = np.zeros((n_x, -(-n_x // n_p) * n_p))
    seeds[:, :n_x] = np.eye(n_x)
    state, sensitivity = [], []
    for window, first in enumerate(recording.first):
        for k, x0 in enumerate(recording.windows.x[window, :-1]):
            start = (first + k) * samples
            part = slice(start, start + samples + 1)
            signals = recording.signals.part(part)
            w = signal_array(signals, sampling.step, start, mean_samples(machine))
            x1, d_x1 = _end(model, w, x0, np.zeros((n_x, n_p)))
            columns = [_end(model, w, x0, seed)[1] - d_x1 for seed in np.split(seeds, seeds.shape[1] // n_p, axis=1)]
            by_x = np.hstack(columns)[:, :n_x]
            exact = recording.exact[window]
            state.append(x1 - exact.x1[k])
            sensitivity += [d_x1 - exact.B[k], by_x - exact.A[k]]
    return largest_magnitude(*state), largest_magnitude(*sensitivity)


def _end(model: CompiledModel, w: Array, x: Array, d_x: Array) -> tuple[Array, Array]:
    """Node state at the last sample of signals w, and its derivatives in theta, from those at the first."""
    state, sensitivity = np.array(x, dtype=np.float64), np.array(d_x, dtype=np.float64, order="C")
    model.advance(w, np.ones(model.model.n_p), state, sensitivity, None, None)
    return state, sensitivity


def largest_magnitude(*differences: Array) -> float | None:
    """Largest magnitude; None where there is a number that is not finite."""
    largest = max(float(np.abs(difference).max()) for difference in differences)
    return largest if all(np.isfinite(difference).all() for difference in differences) else None
