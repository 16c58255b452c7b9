"""A record thinned for a search, and brought into line with a model where a difference says nothing about friction."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from sgms_mhe.diagnosis.half_steps import at_rate, compile_half_steps, of_the_step
from sgms_mhe.diagnosis.sampling import TIMING
from sgms_mhe.diagnosis.subject import Fit, Subject
from sgms_mhe.model.effects import effect_definition
from sgms_mhe.recordings.evidence import nuisance
from sgms_mhe.recordings.recording import Recording
from sgms_mhe.recordings.rows import row_means
from sgms_mhe.signals.chain import Signals
from sgms_mhe.support.parallel import beside, in_parallel

Array = NDArray[np.float64]

AT_LIMIT: Final = 1e-6
HELD: Final = 1.5
"""Of h^2 / 12: a force that is held moves by the mean of two samples, low by h^2 / 8 between them."""
SEARCH_RATE: Final = 1000.0
"""Steps of a search per second, at least, as many samples sharing one as that allows [Hz]: the rate of the rows;
alignment takes out what a longer step changes."""
ALIGNABLE: Final = 0.1
"""Change of friction by a longer step that alignment takes out, standard deviations [friction]: a model that it changes
more is fitted at the full rate."""


def thinned(subject: Subject) -> Subject:
    """The same record with the mean signals of as many samples as a step of the search may share.

    Means keep displacements exact. What else a longer step changes, `aligned` takes out.
    """
    recording, factor = subject.recording, _samples_per_step(subject.recording)
    if factor == 1:
        return subject
    rate = subject.machine.sampling.rate / factor
    n = len(recording.time) * recording.factor

    def mean(series: Array) -> Array:
        return row_means(series[:n], factor)

    machine = at_rate(subject.machine, rate)
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
    return replace(Subject.of(machine, less), noise=subject.noise, starts=subject.starts, fine=subject)


def _samples_per_step(recording: Recording) -> int:
    """How many samples share a step: the most, dividing those of a row, that keep at least SEARCH_RATE."""
    rate, factor = recording.machine.sampling.rate, recording.factor
    return max(k for k in range(1, factor + 1) if k == 1 or (factor % k == 0 and rate / k >= SEARCH_RATE))


def aligned(subject: Subject, fit: Fit, *, anew: bool = False) -> Subject:
    """The subject with measured friction in line with the model at a fit.

    Three things are taken out of it: what the length of the model's steps does (`of_the_step`). What is of the sampling
    (`_sampling`), unless a delay or lag is under test. And of a thinned one the difference of its model's friction to
    that at the full rate: residuals are then those of the full rate, but for the change of that difference away from
    the fit. `anew`: with the steps of this very fit, for numbers that are reported.
    """
    whole = subject.whole
    tasks = [partial(whole.friction, fit)]
    if subject.fine is not None:
        tasks.append(partial(subject.friction, fit))
    # What is certain to run next is compiled beside what runs now.
    asked = anew or whole.alignment.later is None
    exact, *own = beside(partial(in_parallel, tasks), [partial(compile_half_steps, whole, fit)] if asked else [])
    used = subject.recording.used
    if not np.all(np.isfinite(exact)):
        return subject
    later = None if anew else whole.alignment.later_at(exact)
    steps = whole.alignment
    if later is None:
        later = of_the_step(whole, fit)
        steps = replace(steps, later=later, at=exact)
    measured = steps.measured - later
    names = [extra.name for extra in fit.extras] + [effect.name for effect in subject.machine.effects]
    timed = any(effect_definition(name).acts_on_timing for name in names)
    columns = _of_sampling(whole, exact)
    sampled = _sampling(whole, fit, columns, measured - exact, timed=timed)
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
    if float(np.std(change[used])) < ALIGNABLE * float(np.std(exact[used])):
        recording = replace(recording, friction=measured - change)
    alignment = replace(subject.alignment, sampled=sampled)
    return replace(subject, recording=recording, alignment=alignment, fine=whole, known={})


def residual_along(whole: Subject, fit: Fit, sampled: Array) -> Array:
    """Measured minus simulated friction (m) [N] along a whole record, of a fit to parts of it.

    `sampled` (2): what the alignment there found of the sampling.
    """
    exact = whole.friction(fit)
    measured = whole.alignment.measured - of_the_step(whole, fit) - _of_sampling(whole, exact) @ sampled
    return np.asarray(measured - exact)


def _sampling(whole: Subject, fit: Fit, columns: Array, residual: Array, *, timed: bool) -> Array:
    """Coefficients of `_of_sampling` (2) in what a residual (m) owes to the sampling of force and position alone.

    Proportional to the force's rate: force and position up to TIMING of a sample apart. Proportional to the second
    derivative of the inertial force: its second difference over a sample h is low by h^2 / 12 of that, against a force
    that is sampled in a point. `timed`: a delay or lag is under test, which the former belongs to; such as that of a
    force that is held over a sample, which is low by h^2 / 8.
    """
    used, step = whole.recording.used, whole.machine.sampling.step
    free = nuisance(fit.slopes[used][:, fit.loose])
    scale = np.array([TIMING * step, step**2 / 12.0])
    Z = free.project(columns[used] * scale)
    e = free.project(residual[used])
    if not timed:
        both = lsq_linear(Z, e, ([-1.0, -1.0], [1.0, 0.0])).x
        if abs(both[0]) <= 1.0 - AT_LIMIT:
            return np.asarray(scale * both)
    # More than sampling: all of it is for a delay or lag to explain.
    snap = lsq_linear(Z[:, 1:], e, ([-HELD if timed else -1.0], [0.0])).x
    return np.asarray(scale * np.array([0.0, *snap]))


def _of_sampling(whole: Subject, friction: Array) -> Array:
    """Rate of the force [N/s], and second derivative of the inertial one [N/s^2] (m, 2), at a friction (m) [N].

    A force that is late is late with all that it overcomes: the rate is that of the inertial force, as the log's
    samples have it, and of the model's friction.
    """
    recording, mass = whole.recording, whole.machine.plant.moved
    step = recording.machine.sampling.step
    jerk = np.gradient(recording.signals.acceleration) / step
    inertial = mass * recording.reduce(np.column_stack((jerk, np.gradient(jerk) / step)))
    inertial[:, 0] += np.gradient(friction) / (recording.factor * step)
    return np.asarray(inertial)
