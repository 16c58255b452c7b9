"""Alignment of a record with a model: decimation for a search, the length of its steps, the timing of its force."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from sgms_mhe.configuration import override_machine
from sgms_mhe.diagnosis.fits import ALIKE, Fit, Subject
from sgms_mhe.diagnosis.parametrisation import TIMING, TIMING_MOST, drop_bounds
from sgms_mhe.diagnosis.result import Diagnosis
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import EFFECT_NAMES, effect_definition
from sgms_mhe.recordings.evidence import largest_force, misread_forces
from sgms_mhe.recordings.least_squares import RIDGE, solve_box
from sgms_mhe.recordings.recording import RATE_MAX, Recording, reduce_signals
from sgms_mhe.recordings.series import Shift, row_means
from sgms_mhe.signals.chain import Signals, apply_chain
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.arrays import TINY, Array
from sgms_mhe.support.parallel import beside, run_parallel

AT_LIMIT: Final = 1e-6
HOLD_SNAP: Final = 1.5
"""Of h^2 / 12: a force that is held moves by the mean of two samples, low by h^2 / 8 between them."""
CUTOFF: Final = 0.4  # of the rate: a low-pass that a machine file may have at it; the signals passed theirs already
LOWEST: Final = 1e-3  # of the rate: the same for the lowest one
FASTEST: Final = 1e6  # Hz, as often as a machine file may ask for updates; what such a step does shows nowhere
SAMPLES_AT_A_TIME: Final = 1_000_000  # samples of a long record; bounds memory
LEADS: Final = 10  # of a part: it begins as much of it earlier
MIDDLE: Final = np.array([3.0, -25.0, 150.0, 150.0, -25.0, 3.0]) / 256.0
"""Weights of the six samples about a middle (Lagrange)."""


def decimate(subject: Subject) -> Subject:
    """The same record with the mean signals of as many samples as a step of the search may share.

    Means keep displacements exact. `align` takes out all other changes by a longer step.
    """
    recording, factor = subject.recording, _samples_per_step(subject.recording)
    if factor == 1:
        return subject
    rate = subject.machine.sampling.rate / factor
    n = len(recording.time) * recording.factor

    def mean(series: Array) -> Array:
        return row_means(series[:n], factor)

    machine = set_rate(subject.machine, rate)
    signals = recording.signals
    thin = Signals(
        time=mean(signals.time),
        position=mean(signals.position),
        velocity=mean(signals.velocity),
        acceleration=mean(signals.acceleration),
        force=mean(signals.force),
        friction=mean(signals.friction),
        valid=np.asarray(signals.valid[:n].reshape(-1, factor).all(axis=1)),
        missing=np.asarray(signals.missing[:n].reshape(-1, factor).any(axis=1)),
        delay=signals.delay,
    )
    clock = mean(recording.clock)
    noise = None if recording.noise is None else mean(recording.noise)
    fewer = recording.factor // factor
    less = replace(recording, machine=machine, signals=thin, clock=clock, factor=fewer, noise=noise)
    own = Subject.of(machine, less)
    return replace(own, noise=subject.noise, starts=subject.starts, is_open=subject.is_open, fine=subject)


def _samples_per_step(recording: Recording) -> int:
    """Return the samples that share a step: the most, dividing those of a row, that keep at least RATE_MAX.

    Alignment takes out the changes by a longer step.
    """
    rate, factor = recording.machine.sampling.rate, recording.factor
    return max(k for k in range(1, factor + 1) if k == 1 or (factor % k == 0 and rate / k >= RATE_MAX))


def align(subject: Subject, fit: Fit, *, anew: bool = False) -> Subject:
    """The subject with measured friction in line with the model at a fit.

    Four parts are taken out of it: the errors of the model's step length (`find_step_error`) and of its motion behind
    the chain (`find_chain_error`); that of the sampling
    (`_fit_sampling`), unless a delay or lag is under test; and of a decimated one the difference of its model's
    friction to that at the full rate: residuals are then those of the full rate, but for the change of that difference
    away from the fit. `anew`: with the steps of this very fit, for numbers that are reported.
    """
    whole = subject.whole
    tasks = [partial(whole.friction, fit)]
    if subject.fine is not None:
        tasks.append(partial(subject.friction, fit))
    # What is certain to run next is compiled beside what runs now.
    asked = anew or whole.alignment.later is None
    exact, *own = beside(partial(run_parallel, tasks), [partial(compile_half_steps, whole, fit)] if asked else [])
    used = subject.recording.used
    if not np.all(np.isfinite(exact)):
        return subject
    later = None if anew else whole.alignment.find_later(exact)
    steps = whole.alignment
    if later is None:
        later = find_step_error(whole, fit) + find_chain_error(whole, fit)
        steps = replace(steps, later=later, at=exact)
    measured = steps.measured - later
    names = [effect.name for effect in fit.effects] + [effect.name for effect in subject.machine.effects]
    timed = any(effect_definition(name).acts_on_timing for name in names)
    columns = find_sampling_columns(whole, exact)
    sampled = _fit_sampling(whole, fit, columns, measured - exact, timed=timed)
    measured = measured - columns @ sampled
    whole = replace(
        whole,
        recording=replace(whole.recording, friction=measured),
        alignment=replace(steps, sampled=sampled),
        known={},
    )
    if subject.fine is None:
        return whole
    recording, change = subject.recording, exact - own[0]
    # What is no small difference is a model that the longer steps do not suit: it is fitted at the full rate.
    if float(np.std(change[used])) < ALIKE * float(np.std(exact[used])):
        recording = replace(recording, friction=measured - change)
    alignment = replace(subject.alignment, sampled=sampled)
    return replace(subject, recording=recording, alignment=alignment, fine=whole, known={})


def find_residual(whole: Subject, fit: Fit, sampled: Array) -> Array:
    """Measured minus simulated friction (m) [N] along a whole record, of a fit to parts of it.

    `sampled` (2): coefficients of the sampling found by the alignment there.
    """
    exact = whole.friction(fit)
    later = find_step_error(whole, fit) + find_chain_error(whole, fit)
    own = 0.0 if fit.own is None else fit.own.force
    return np.asarray(whole.alignment.measured - later - find_sampling_columns(whole, exact) @ sampled - exact - own)


def _fit_sampling(whole: Subject, fit: Fit, columns: Array, residual: Array, *, timed: bool) -> Array:
    """Coefficients of the sampling columns (2) in the part of a residual (m) due to sampling alone.

    Proportional to the force's rate: force and position up to TIMING of a sample apart. Proportional to the second
    derivative of the inertial force: its second difference over a sample h is low by h^2 / 12 of that, against a force
    sampled in a point. `timed`: a delay or lag is under test, which the former belongs to; such as that of a
    force held over a sample, which is low by h^2 / 8.
    """
    used, step = whole.recording.used, whole.machine.sampling.step
    free = fit.find_nuisance(used)
    scale = np.array([TIMING * step, step**2 / 12.0])
    Z = free.project(columns[used] * scale)
    e = free.project(residual[used])
    if not timed:
        both = _within(Z, e, [-1.0, -1.0], [1.0, 0.0])
        if abs(both[0]) <= 1.0 - AT_LIMIT:
            return np.asarray(scale * both)
    # More than sampling: all of it is for a delay or lag to explain.
    snap = _within(Z[:, 1:], e, [-HOLD_SNAP if timed else -1.0], [0.0])
    return np.asarray(scale * np.array([0.0, *snap]))


def _within(Z: Array, e: Array, lower: Sequence[float], upper: Sequence[float]) -> Array:
    """Return the coefficients of columns Z (rows, k) within bounds (k) that leave least of e (rows)."""
    H = Z.T @ Z
    ridge = max(TINY, RIDGE * float(np.diag(H).max()))
    return solve_box(H + ridge * np.eye(len(H)), Z.T @ e, np.array(lower), np.array(upper))


def find_sampling_columns(whole: Subject, friction: Array) -> Array:
    """Return the rate of the force [N/s], the second derivative of the inertial one [N/s^2] (m, 2), at a friction (m).

    A force that is late is late with all that it overcomes: the rate is that of the inertial force, as the log's
    samples have it, and of the model's friction.
    """
    recording, mass = whole.recording, whole.recording.inertia
    step = recording.machine.sampling.step
    jerk = np.gradient(recording.signals.acceleration) / step
    inertial = mass * recording.reduce(np.column_stack((jerk, np.gradient(jerk) / step)))
    inertial[:, 0] += np.gradient(friction) / (recording.factor * step)
    return np.asarray(inertial)


def find_step_error(whole: Subject, fit: Fit) -> Array:
    """Return the change of a model's friction (m) [N] by a vanishing step, to be added to it.

    The chain's velocity is a mean over a sample: displacements need exactly this, but as a speed it is half a sample
    old. A force is sampled in a point, so viscous friction shows an acceleration h / 2 more of it, which looks like a
    mass of sigma_v h / 2; and an element that sticks while the axis brakes keeps the level of half a sample ago until
    it slides again. Both are proportional to the step, as is every other error of a model held over it: twice
    the change by half the step (Richardson's extrapolation). Ringing is left out: about as fast as a sample, it is
    no series in the step.
    """
    m, factor = len(whole.recording.time), whole.recording.factor
    change, still = np.zeros(m), _drop_ringing(fit)
    machine, rows = _double_rate(whole.machine), max(1, SAMPLES_AT_A_TIME // factor)
    if machine is None:
        return change
    for first in range(0, m, rows):
        # What came before is in both runs, and so hardly in their difference.
        lead = min(first, rows // LEADS)
        part = whole if m <= rows else _part(whole, slice(first - lead, min(m, first + rows)))
        fine = Subject.of(machine, halve_steps(part.recording, machine)).friction(still)[1::2]
        change[first : first + rows] = 2.0 * (part.recording.reduce(fine) - part.friction(still))[lead:]
    # A model that is not finite at one of the rates says nothing about the other.
    return change if np.all(np.isfinite(change)) else np.zeros(m)


def find_chain_error(whole: Subject, fit: Fit) -> Array:
    """Return the change of a model's friction (m) [N] where its force passes the chain, not its motion.

    Measured friction has passed the low-passes. A model along the filtered motion turns round and breaks away as late
    as they smear a reversal: with a cutoff of 25 Hz that is a tenth of the friction. Ringing is left out. A record
    in which it does not matter (`is_smeared`) is spared it: the motion before the chain is noisier.
    """
    recording, still = whole.recording, _drop_ringing(fit)
    if recording.unfiltered is None or not recording.is_smeared:
        return np.zeros(len(recording.time))
    change = _friction_before_chain(whole, still, recording.unfiltered) - whole.friction(still)
    return change if np.all(np.isfinite(change)) else np.zeros(len(change))


def find_encoder_force(whole: Subject, fit: Fit) -> Array | None:
    """Return the force the encoder's steps leave in a residual (m) [N]; None where they do not show.

    Mass times the acceleration they make; and friction, as far as the model takes another trajectory from them:
    where stiff elements stick, a fraction of a step is a force; and a smooth law goes down a little at every reversal
    near its level. One realisation, lines being elsewhere.
    """
    recording, still = whole.recording, _drop_ringing(fit)
    inertial = recording.steps_inertia
    if inertial is None or recording.unfiltered is None or recording.misread is None:
        return None
    tasks = [partial(_friction_before_chain, whole, still, motion) for motion in recording.misread_motions()]
    force = largest_force(recording, misread_forces(inertial, run_parallel(tasks)))
    return inertial if force is None else force


def _friction_before_chain(whole: Subject, fit: Fit, motion: Array) -> Array:
    """Return a model's friction (m) [N] along a motion before the chain (n, 4), behind the chain."""
    recording, machine = whole.recording, whole.recording.machine
    m, factor = len(recording.time), recording.factor
    friction, rows = np.empty(m), max(1, SAMPLES_AT_A_TIME // factor)
    for first in range(0, m, rows):
        lead, last = min(first, rows // LEADS), min(m, first + rows)
        samples = slice((first - lead) * factor, last * factor)
        signals = recording.signals.part(samples).before_chain(motion[samples])
        clock = recording.clock[samples] + recording.signals.delay
        before = Subject.of(whole.machine, _make_uncounted(recording.machine, signals, clock, 1))
        friction[first:last] = row_means(apply_chain(machine, before.friction(fit)), factor)[lead:]
    return friction


def compile_half_steps(whole: Subject, fit: Fit) -> None:
    """Compile the models of `find_step_error` in the background."""
    machine = _double_rate(whole.machine)
    if machine is not None:
        Subject.of(machine, whole.recording).model(fit.effects)


def _double_rate(machine: Machine) -> Machine | None:
    """The machine at twice the rate; None where that is beyond all that there is."""
    rate = 2.0 * machine.sampling.rate
    return None if rate > FASTEST else set_rate(machine, rate)


def _part(whole: Subject, rows: slice) -> Subject:
    """Some rows of a record, none of which counts."""
    recording = whole.recording
    samples = slice(rows.start * recording.factor, rows.stop * recording.factor)
    signals, clock = recording.signals.part(samples), recording.clock[samples]
    return Subject.of(whole.machine, _make_uncounted(recording.machine, signals, clock, recording.factor))


def _make_uncounted(machine: Machine, signals: Signals, clock: Array, factor: int) -> Recording:
    """A record none of whose rows counts: no prediction of a model is compared with them."""
    unused = np.full(len(signals) // factor, -1, dtype=np.int64)
    none, nowhere = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.bool_)
    return reduce_signals(machine, signals, clock, factor, unused, none, nowhere, ())


def _drop_ringing(fit: Fit) -> Fit:
    """The same numbers, the sizes of effects that ring set to none."""
    ringing = set()
    for group in {column.group for column in fit.model.columns if column.group.kind != "base"}:
        definition = effect_definition(group.cause)
        if definition.full_rate and not definition.acts_on_timing:
            ringing.add(group)
    return replace(fit, theta=fit.theta_without(ringing))


def halve_steps(recording: Recording, machine: Machine) -> Recording:
    """The record with a sample in the middle of each step, for a machine at twice its rate.

    (2 n) rows, each second one the sample itself; none counts.
    """
    signals, h = recording.signals, recording.machine.sampling.step
    # Along what was travelled: pieces of a record need not meet.
    way = np.concatenate((np.zeros(1), np.cumsum(signals.velocity) * h))
    velocity = np.diff(_insert_middles(way)[1:]) * (2.0 / h)
    middle = signals.position - 0.5 * h * velocity[1::2]
    halved = Signals(
        time=_interleave(signals.time - 0.5 * h, signals.time),
        position=_interleave(middle, signals.position),
        velocity=velocity,
        acceleration=_insert_middles(signals.acceleration),
        force=_insert_middles(signals.force),
        friction=_insert_middles(signals.friction),
        valid=np.repeat(signals.valid, 2),
        missing=np.repeat(signals.missing, 2),
        delay=signals.delay,
    )
    return _make_uncounted(machine, halved, _interleave(recording.clock - 0.5 * h, recording.clock), 1)


def set_rate(machine: Machine, rate: float) -> Machine:
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
    return override_machine(drop_bounds(machine), changes)


def _insert_middles(series: Array) -> Array:
    """Samples (2 n): the middle before each, of a polynomial through the six about it, and the sample.

    Lines would change a force by its second derivative, which delays and lags show as much of.
    """
    reach = len(MIDDLE) // 2
    padded = np.pad(series, (reach, reach - 1), mode="reflect", reflect_type="odd")
    return _interleave(np.convolve(padded, MIDDLE, mode="valid"), series)


def _interleave(middles: Array, series: Array) -> Array:
    """A middle and its sample, and the next ones (2 n)."""
    return np.column_stack((middles, series)).ravel()


def sampling_offset(diagnosis: Diagnosis) -> float:
    """Return the age [s] of the logged force by a named delay or lag that is of the sampling; 0: none.

    A drive that holds its force over a sample logs one that is half a sample old on average, or half a sample young
    (below zero), depending on when it writes it down. A smaller shift, with a margin, says nothing about the axis.
    """
    machine = diagnosis.machine
    most = TIMING_MOST * machine.sampling.step
    for cause in diagnosis.causes:
        if cause.name not in EFFECT_NAMES:
            continue
        definition = effect_definition(cause.name)
        for parameter in definition.parameters:
            value = cause.parameters.get(parameter.name, 0.0)
            if parameter.timing and abs(value) <= most:
                return value if definition.delays else -value  # a force that lags the logged one makes that one young
    return 0.0


def in_step(log: Log, offset: float) -> Log:
    """The log with its force that time [s] younger.

    Values computed by the controller itself stay. Samples next to gaps are missing.
    """
    return replace(log, force_N=Shift.of(-offset, log.rate).of_series(log.force_N))


def offset_notes(machine: Machine, offset: float) -> tuple[str, ...]:
    """Return the remarks on a force put in step with the position by that time [s]."""
    if offset == 0.0:
        return ()
    age = "older" if offset > 0.0 else "younger"
    return (
        f"the logged force is {abs(offset) * machine.sampling.rate:.2f} samples ({abs(offset):.2g} s) {age} than the "
        "position, as where a drive holds its force over a sample: taken out, and no delay of the axis",
    )
