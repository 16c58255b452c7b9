"""What the length of a model's steps does to its friction."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.configuration import override_machine
from sgms_mhe.diagnosis.freeing import without_bounds
from sgms_mhe.diagnosis.subject import Fit, Subject
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import effect_definition
from sgms_mhe.recordings.recording import Recording, reduced
from sgms_mhe.signals.chain import Signals

Array = NDArray[np.float64]

CUTOFF: Final = 0.4  # of the rate: a low-pass that a machine file may have at it; the signals passed theirs already
LOWEST: Final = 1e-3  # of the rate: the same for the lowest one
FASTEST: Final = 1e6  # Hz, as often as a machine file may ask for updates; what such a step does shows nowhere
AT_A_TIME: Final = 1_000_000  # samples of a long record; bounds memory
LEADS: Final = 10  # of a part: it begins as much of it earlier
MIDDLE: Final = np.array([3.0, -25.0, 150.0, 150.0, -25.0, 3.0]) / 256.0
"""Weights of the six samples about a middle (Lagrange)."""
SEAM: Final = 1.5
"""Steps between two samples from which on they are of different pieces of a record."""


def of_the_step(whole: Subject, fit: Fit) -> Array:
    """What a vanishing step changes of a model's friction (m) [N], to be added to it.

    The chain's velocity is a mean over a sample: that is what displacements need, but as a speed it is half a sample
    old. A force is sampled in a point, so viscous friction shows an acceleration h / 2 more of it, which looks like a
    mass of sigma_v h / 2; and an element that sticks while the axis brakes keeps the level of half a sample ago until
    it slides again. Both are proportional to the step, as is what else a model that is held over it gets wrong: twice
    what half the step changes (Richardson's extrapolation). What rings is left out: about as fast as a sample, it is
    no series in the step.
    """
    m, factor = len(whole.recording.time), whole.recording.factor
    change, still = np.zeros(m), _without_ringing(fit)
    machine, rows = _twice_as_fast(whole.machine), max(1, AT_A_TIME // factor)
    if machine is None:
        return change
    for first in range(0, m, rows):
        # What came before is in both runs, and so hardly in their difference.
        lead = min(first, rows // LEADS)
        part = whole if m <= rows else _part(whole, slice(first - lead, min(m, first + rows)))
        fine = Subject.of(machine, with_half_steps(part.recording, machine)).friction(still)[1::2]
        change[first : first + rows] = 2.0 * (part.recording.reduce(fine) - part.friction(still))[lead:]
    # A model that is not finite at one of the rates says nothing about the other.
    return change if np.all(np.isfinite(change)) else np.zeros(m)


def compile_half_steps(whole: Subject, fit: Fit) -> None:
    """Compile what `of_the_step` runs, while something else is done."""
    machine = _twice_as_fast(whole.machine)
    if machine is not None:
        Subject.of(machine, whole.recording).model(fit.extras)


def _twice_as_fast(machine: Machine) -> Machine | None:
    """The machine at twice the rate; None where that is beyond all that there is."""
    rate = 2.0 * machine.sampling.rate
    return None if rate > FASTEST else at_rate(machine, rate)


def _part(whole: Subject, rows: slice) -> Subject:
    """Some rows of a record, none of which counts."""
    recording = whole.recording
    samples = slice(rows.start * recording.factor, rows.stop * recording.factor)
    signals, clock = recording.signals.part(samples), recording.clock[samples]
    return Subject.of(whole.machine, _uncounted(recording.machine, signals, clock, recording.factor))


def _uncounted(machine: Machine, signals: Signals, clock: Array, factor: int) -> Recording:
    """A record none of whose rows counts: what a model makes of them is compared with nothing."""
    unused = np.full(len(signals) // factor, -1, dtype=np.int64)
    none, nowhere = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.bool_)
    return reduced(machine, signals, clock, factor, unused, none, nowhere, ())


def _without_ringing(fit: Fit) -> Fit:
    """The same numbers, the sizes of effects that ring set to none."""
    ringing = set()
    for group in {column.group for column in fit.model.columns if column.group.kind != "base"}:
        definition = effect_definition(group.cause)
        if definition.full_rate and not definition.acts_on_timing:
            ringing.add(group)
    return replace(fit, theta=fit.theta_without(ringing))


def with_half_steps(recording: Recording, machine: Machine) -> Recording:
    """The record with a sample in the middle of each step, for a machine at twice its rate.

    (2 n) rows, each second one the sample itself; none counts.
    """
    signals, h = recording.signals, recording.machine.sampling.step
    if is_mean_velocity(recording):
        # Along what was travelled: pieces of a record need not meet.
        way = np.concatenate((np.zeros(1), np.cumsum(signals.velocity) * h))
        velocity = np.diff(_with_middles(way)[1:]) * (2.0 / h)
    else:
        velocity = _with_middles(signals.velocity)
    middle = signals.position - 0.5 * h * velocity[1::2]
    halved = Signals(
        time=_in_turn(signals.time - 0.5 * h, signals.time),
        position=_in_turn(middle, signals.position),
        velocity=velocity,
        acceleration=_with_middles(signals.acceleration),
        force=_with_middles(signals.force),
        friction=_with_middles(signals.friction),
        valid=np.repeat(signals.valid, 2),
        missing=np.repeat(signals.missing, 2),
        delay=signals.delay,
    )
    return _uncounted(machine, halved, _in_turn(recording.clock - 0.5 * h, recording.clock), 1)


def is_mean_velocity(recording: Recording) -> bool:
    """Whether the velocity is that of the step before its sample, as a difference of positions is.

    A log may bring its own, which may as well be a reading: what was travelled says.
    """
    signals, h = recording.signals, recording.machine.sampling.step
    joined = np.diff(recording.clock) < SEAM * h
    travelled, now = np.diff(signals.position), signals.velocity[1:]
    between = 0.5 * (signals.velocity[:-1] + now)

    def off(velocity: Array) -> float:
        return float(np.sum((velocity * h - travelled)[joined] ** 2))

    return off(now) <= off(between)


def at_rate(machine: Machine, rate: float) -> Machine:
    """The machine with signals at another rate [Hz], one update and one step of the integrator a sample."""
    cutoff = float(np.clip(machine.sampling.velocity_cutoff, LOWEST * rate, CUTOFF * rate))
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
    """Samples (2 n): the middle before each, of a polynomial through the six about it, and the sample.

    Lines would change a force by its second derivative, which delays and lags show as much of.
    """
    reach = len(MIDDLE) // 2
    padded = np.pad(series, (reach, reach - 1), mode="reflect", reflect_type="odd")
    return _in_turn(np.convolve(padded, MIDDLE, mode="valid"), series)


def _in_turn(middles: Array, series: Array) -> Array:
    """A middle and its sample, and the next ones (2 n)."""
    return np.column_stack((middles, series)).ravel()
