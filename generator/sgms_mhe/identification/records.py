"""Logs prepared for identification: rows of the signal chain, and the motion that friction elements run along."""

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Self

import numpy as np
from scipy.ndimage import maximum_filter1d

from sgms_mhe.machine import Machine
from sgms_mhe.recordings.encoder import encoder_noise
from sgms_mhe.recordings.joining import drop_rows, join_recordings
from sgms_mhe.recordings.path import (
    ENCODERS,
    bridge_gaps,
    displacements,
    misread_paths,
    reading_error,
    smooth_path,
    thin_path,
)
from sgms_mhe.recordings.recording import Recording, Runs, add_encoder, position_error, prepare
from sgms_mhe.recordings.series import row_means
from sgms_mhe.signals.chain import apply_chain, chain_delay, readings, settle_samples
from sgms_mhe.signals.logs import Log
from sgms_mhe.signals.noise import encoder_step, noise_course
from sgms_mhe.support.arrays import Array, Mask

FORGOTTEN: Final = 2.0
"""Excursion after which an element does not remember its start, over its break-away distance."""
LEAD: Final = 0.6
"""Largest share of a log that is left out for that."""
STAND: Final = 5
"""Samples at one count from which on an axis may stand."""
TURNS: Final = 5.0
"""Time there, over that in which the acceleration's RMS passes a count, from which on it does: else it turns round."""
MOVING: Final = 0.5
"""Share of the rows in which an axis must move: with fewer its rest is what there is."""
PATH_RATE: Final = 16000.0
"""Points of a way a second, where samples are fewer [Hz]: of a step the speed that rules a level is the mean."""
RUNS_CACHED: Final = 16
"""Banks of elements that a motion keeps: a fit begins where another one ended."""

CLEARLY: Final = 2.0
"""Noise of a stretch from which on it is not that of an encoder's steps [theirs]: it scatters by less."""


@dataclass(frozen=True, eq=False)
class ElementMotion:
    """Motion of the elements in one log: displacements at some rate, and the way of a force to decimated samples.

    Attributes:
        machine: whose chain the log went through.
        rate: of the displacements [Hz].
        velocity: over the step that ends at each instant (n) [m/s].
        steps: from one sample to the next.
        factor: samples per row.
        rows: of the log.
        filtered: whether a force passes the chain before it is compared: displacements are those of the encoder then,
            else those behind the filters.
        runs: the newest ones of elements along it.
        scale: level of its record over the mean of all [1]; stiffnesses are the same.
        load: added to the level at each instant, over the level without it (n) [1]; None: nothing.
    """

    machine: Machine
    rate: float
    velocity: Array
    steps: int
    factor: int
    rows: int
    filtered: bool
    runs: Runs = field(default_factory=lambda: Runs(RUNS_CACHED), repr=False)
    scale: float = 1.0
    load: Array | None = None

    def carry(self, load: Array) -> Self:
        """Return the motion under a load that adds to the level: over the level without it, at each row (rows) [1]."""
        samples = (np.arange(1, len(self.velocity) + 1) / self.steps - 1.0) + 0.5 * (1 - self.factor)
        late = chain_delay(self.machine) * self.machine.sampling.rate if self.filtered else 0.0
        course = np.interp((samples + late) / self.factor, np.arange(self.rows), load)
        return replace(self, load=course, runs=Runs(RUNS_CACHED))

    def pick_samples(self, series: Array) -> Array:
        """Return a series (n) at the samples (n // steps)."""
        return series[self.steps - 1 :: self.steps]

    def to_rows(self, series: Array) -> Array:
        """A force, or columns of forces, at the rows: (n // steps, ...) to (rows, ...)."""
        if self.filtered:
            series = apply_chain(self.machine, series)
        return row_means(series[: self.rows * self.factor], self.factor)


@dataclass(frozen=True, eq=False)
class Records:
    """All logs as one, in an order of their own.

    Attributes:
        machine: with the rates of the records; of its friction nothing counts.
        names: of the logs.
        rows: all rows one log behind the other; blocks, folds and held-out rows as in a diagnosis.
        whole: the same with those at which the axis stands, as predict has them; None: `rows` are all.
        coarse: motion behind the filters at the rate of the rows, a log each.
        fine: the encoder's motion at the logs' rate, a log each.
        steps_inertia: force of the acceleration the encoder's steps make (m) [N]; None where they do not show.
        misread: the motion without the encoder's steps (`smooth_blocks`), and as each of ENCODERS encoders of these
            steps, their lines elsewhere, reads that, a log each; none where no steps show.
        thinned: `fine` through every second sample, the even ones and the odd ones, a log each.
        resolution: of the position [m], noise of a measurement included.
        warnings: to the user about the logs.
    """

    machine: Machine
    names: tuple[str, ...]
    rows: Recording
    coarse: tuple[ElementMotion, ...]
    fine: tuple[ElementMotion, ...]
    resolution: float
    warnings: tuple[str, ...]
    steps_inertia: Array | None = None
    whole: Recording | None = None
    misread: tuple[tuple[ElementMotion, ...], ...] = ()
    thinned: tuple[tuple[ElementMotion, ...], ...] = ()


def scale_levels(records: Records, factors: Sequence[float]) -> Records:
    """Return records whose levels are these factors times those before, about the same mean."""
    scales = np.array([motion.scale for motion in records.coarse]) * np.array(factors)
    scales = (scales / scales.mean()).tolist()

    def scaled(motions: Sequence[ElementMotion]) -> tuple[ElementMotion, ...]:
        return tuple(replace(motion, scale=scale) for motion, scale in zip(motions, scales, strict=True))

    return replace(
        records,
        coarse=scaled(records.coarse),
        fine=scaled(records.fine),
        misread=tuple(map(scaled, records.misread)),
        thinned=tuple(map(scaled, records.thinned)),
    )


def sort_logs(logs: Sequence[Log]) -> list[Log]:
    """Logs in the order of a digest of their content, independent of the given order."""

    def key(log: Log) -> str:
        digest = hashlib.sha256(np.ascontiguousarray(log.position_m).tobytes())
        digest.update(np.ascontiguousarray(log.force_N).tobytes())
        return digest.hexdigest()

    return sorted(logs, key=key)


def make_records(machine: Machine, logs: Sequence[Log]) -> Records:
    """Send logs through the chain of a machine and put them behind one another.

    Raises:
        InputError: a log with fewer rows than a fit needs.
    """
    recordings = [prepare(machine, log) for log in logs]
    resolutions = [position_error(readings(log).position_m) for log in logs]
    names = tuple(log.source or "log" for log in logs)
    several = len(logs) > 1
    warnings = tuple(
        f"{name}: {warning}" if several else warning
        for name, recording in zip(names, recordings, strict=True)
        for warning in recording.warnings
    )
    paths = [_read_path(log, noise) for log, noise in zip(logs, resolutions, strict=True)]
    fine = tuple(_encoder_motion(*one) for one in zip(recordings, logs, [path[0] for path in paths], strict=True))
    read = list(map(add_encoder, recordings, logs))
    steps = [recording.steps_inertia for recording in read]
    shown = any(inertia is not None for inertia in steps)
    noise = np.concatenate([_acceleration_noise(*one) for one in zip(read, logs, strict=True)])
    stands = np.concatenate([_find_stands(*one) for one in zip(recordings, logs, strict=True)])
    rows = whole = replace(join_recordings(recordings), acceleration_noise=float(np.mean(noise**2)))
    if np.count_nonzero(rows.used & ~stands) >= MOVING * np.count_nonzero(rows.used):
        rows = drop_rows(rows, stands)
    return Records(
        machine=machine,
        names=names,
        rows=rows,
        whole=whole,
        coarse=tuple(filter_motion(recording) for recording in recordings),
        fine=fine,
        resolution=max(resolutions),
        warnings=warnings,
        steps_inertia=np.concatenate(
            [np.zeros(len(r.time)) if s is None else s for r, s in zip(read, steps, strict=True)]
        )
        if shown
        else None,
        misread=tuple(
            tuple(
                own if inertia is None else _encoder_motion(recording, log, path[k])
                for own, inertia, recording, log, path in zip(fine, steps, recordings, logs, paths, strict=True)
            )
            for k in range(1, ENCODERS + 2)
        )
        if shown
        else (),
        thinned=tuple(
            tuple(_encoder_motion(*one) for one in zip(recordings, logs, ways, strict=True))
            for ways in zip(*(thin_path(path[0]) for path in paths), strict=True)
        ),
    )


def _find_stands(recording: Recording, log: Log) -> Mask:
    """Rows (m) that the chain makes of samples at which the axis stands within a count of its encoder.

    Friction there is anything within the level, by a motion the log does not have: no column explains it.
    """
    position, settle = readings(log).position_m, settle_samples(recording.machine)
    step = encoder_step(position)
    if step == 0.0:
        return np.zeros(len(recording.time), dtype=np.bool_)
    run = np.cumsum(np.abs(np.diff(position, prepend=position[0])) > 0.5 * step)
    turn = math.sqrt(step / max(recording.rms(recording.acceleration), step)) * recording.machine.sampling.rate
    stands = np.bincount(run)[run] >= max(STAND, TURNS * turn)
    return np.asarray(recording.reduce(maximum_filter1d(stands.astype(float), settle | 1)) > 0.5)


def _read_path(log: Log, error: float) -> list[Array]:
    """Return the way of an axis (n) [m]; where its encoder's steps show, one without them, and as others would read it.

    Args:
        log: the record.
        error: of a reading, one standard deviation [m].
    """
    position = bridge_gaps(readings(log).position_m)
    step, course = encoder_step(readings(log).position_m), noise_course(position)
    beyond = course  # what the encoder's steps alone do not make
    if step > 0.0:
        alone = smooth_path(position, error)
        counted = noise_course(alone + reading_error(alone, step, uneven=True))
        beyond = np.where(course > CLEARLY * counted, np.sqrt(np.maximum(0.0, course**2 - counted**2)), 0.0)
        course = np.hypot(error, beyond)
    way = smooth_path(position, error, course)
    if step == 0.0:
        return [way]
    return [way, *misread_paths(position, step, error, course, beyond)]


def _acceleration_noise(recording: Recording, log: Log) -> Array:
    """Acceleration (m) [m/s^2] that the encoder's steps, or readings off their stamps, make.

    None where friction or acceleration was recorded: the friction then holds no noise of a position's.
    """
    if recording.has_own_speeds or log.friction_N is not None:
        return np.zeros(len(recording.time))
    return recording.reduce(encoder_noise(recording)[:, 2])


def filter_motion(recording: Recording) -> ElementMotion:
    """The motion behind the filters at the rate of the rows: means of velocities keep displacements exact."""
    return ElementMotion(
        machine=recording.machine,
        rate=recording.rate,
        velocity=np.ascontiguousarray(recording.velocity),
        steps=1,
        factor=1,
        rows=len(recording.time),
        filtered=False,
    )


def _encoder_motion(recording: Recording, log: Log, way: Array) -> ElementMotion:
    """The axis's own way (n) [m], also between the samples; of a log that brings its velocity, that."""
    rate = recording.machine.sampling.rate
    bypassed = log.velocity_m_s is not None
    steps = 1 if bypassed else max(1, int(PATH_RATE / rate))
    velocity = recording.signals.velocity if bypassed else displacements(way, steps) * (rate * steps)
    return ElementMotion(
        machine=recording.machine,
        rate=rate * steps,
        velocity=np.ascontiguousarray(velocity),
        steps=steps,
        factor=recording.factor,
        rows=len(recording.time),
        filtered=not bypassed,
    )


def drop_start(records: Records, distance: float) -> Records:
    """The records without the rows at which elements may still remember how a log began.

    An axis is not at rest, relaxed, where a log begins. After an excursion of twice the largest break-away distance no
    element knows. A log that would lose too much keeps its rows, with a warning: its elements are taken to begin
    relaxed.

    Args:
        records: all logs.
        distance: of the element that breaks away last [m].
    """
    rows, length = records.rows, records.machine.plant.units.position
    unknown, first, kept = np.zeros(len(rows.time), dtype=np.bool_), 0, []
    for name, motion in zip(records.names, records.fine, strict=True):
        position = rows.position[first : first + motion.rows]
        excursion = np.maximum.accumulate(position) - np.minimum.accumulate(position)
        known = int(np.searchsorted(excursion, FORGOTTEN * distance))
        if known <= LEAD * motion.rows:
            unknown[first : first + known] = True
        else:
            kept.append(
                f"{name}: no excursion of {FORGOTTEN * distance:.2g} {length} soon; friction is taken to begin relaxed"
            )
        first += motion.rows
    fewer = drop_rows(rows, unknown)
    return replace(records, rows=fewer, warnings=(*records.warnings, *kept))
