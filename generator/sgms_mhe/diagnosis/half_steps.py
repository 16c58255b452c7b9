"""What the length of a model's steps does to its friction, and the same without."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.configuration import override_machine
from sgms_mhe.diagnosis.compiling import without_bounds
from sgms_mhe.diagnosis.subject import Fit, Subject
from sgms_mhe.identification.path import displacements
from sgms_mhe.machine import Machine
from sgms_mhe.recordings.recording import Recording, reduced
from sgms_mhe.signals.chain import Signals

Array = NDArray[np.float64]

CUTOFF: Final = 0.4  # of the rate: a low-pass that a machine file may have at it; the signals passed theirs already
FASTEST: Final = 1e6  # Hz, as often as a machine file may ask for updates; what such a step does shows nowhere
SLOWEST: Final = 1e-3  # the same for the lowest


def of_the_step(whole: Subject, fit: Fit) -> Array:
    """What a vanishing step changes of a model's friction (m) [N], to be added to it.

    The chain's velocity is a mean over a sample: that is what displacements need, but as a speed it is half a sample
    old. A force is sampled in a point, so viscous friction shows an acceleration h / 2 more of it, which looks like a
    mass of sigma_v h / 2; and an element that sticks while the axis brakes keeps the level of half a sample ago until
    it slides again. Both are proportional to the step, as is what else a model that is held over it gets wrong: twice
    what half the step changes (Richardson's extrapolation).
    """
    rate = 2.0 * whole.machine.sampling.rate
    if rate > FASTEST:
        return np.zeros(len(whole.recording.time))
    machine = at_rate(whole.machine, rate)
    fine = Subject.of(machine, with_half_steps(whole.recording, machine)).friction(fit)[1::2]
    return 2.0 * (whole.recording.reduce(fine) - whole.friction(fit))


def with_half_steps(recording: Recording, machine: Machine) -> Recording:
    """The record with a sample in the middle of each step, for a machine at twice its rate.

    (2 n) rows, each second one the sample itself. None counts: what a model makes of them is compared with nothing.
    """
    signals, h = recording.signals, recording.machine.sampling.step
    if is_mean_velocity(recording):
        # Along what was travelled: pieces of a record need not meet.
        way = np.concatenate((np.zeros(1), np.cumsum(signals.velocity) * h))
        velocity = displacements(way, 2)[2:] * (2.0 / h)
    else:
        velocity = _with_middles(signals.velocity)
    middle = signals.position - 0.5 * h * velocity[1::2]
    halved = Signals(
        time=np.column_stack((signals.time - 0.5 * h, signals.time)).ravel(),
        position=np.column_stack((middle, signals.position)).ravel(),
        velocity=velocity,
        acceleration=_with_middles(signals.acceleration),
        force=_with_middles(signals.force),
        friction=_with_middles(signals.friction),
        valid=np.repeat(signals.valid, 2),
        missing=np.repeat(signals.missing, 2),
        delay=signals.delay,
    )
    clock = np.column_stack((recording.clock - 0.5 * h, recording.clock)).ravel()
    unused = np.full(len(halved), -1, dtype=np.int64)
    return reduced(machine, halved, clock, 1, unused, recording.fold, recording.held_out, ())


def is_mean_velocity(recording: Recording) -> bool:
    """Whether the velocity is that of the step before its sample, as a difference of positions is.

    A log may bring its own, which may as well be a reading: what was travelled says.
    """
    signals, h = recording.signals, recording.machine.sampling.step
    joined = np.diff(recording.clock) < 1.5 * h
    travelled, before, now = np.diff(signals.position), signals.velocity[:-1], signals.velocity[1:]

    def off(velocity: Array) -> float:
        return float(np.sum((velocity * h - travelled)[joined] ** 2))

    return off(now) <= off(0.5 * (before + now))


def at_rate(machine: Machine, rate: float) -> Machine:
    """The machine with signals at another rate [Hz], one update and one step of the integrator a sample."""
    cutoff = float(np.clip(machine.sampling.velocity_cutoff, SLOWEST * rate, CUTOFF * rate))
    changes = {
        "sampling": {
            "rate": rate,
            "update_rate": rate,
            "measurement_rate": rate,
            "velocity_cutoff": cutoff,
            "integrator": {"substeps": 1},
        }
    }
    return override_machine(without_bounds(machine), changes)


def _with_middles(series: Array) -> Array:
    """Samples (2 n): the mean of each and the one before it, and the sample."""
    before = np.concatenate((series[:1], series[:-1]))
    return np.column_stack((0.5 * (before + series), series)).ravel()
