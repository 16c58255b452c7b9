"""The part of a long record that models are fitted to: pieces from all over it."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from sgms_mhe.recordings.recording import (
    BLOCKS,
    Recording,
    count_spanning,
    forget_extent,
    reduce_signals,
    samples_per_row,
    split_blocks,
)

SEAM: Final = 2  # rows at the end of a piece that derivatives of a row's neighbours would mix with the next
LEAD_MIN: Final = 0.5
"""Motion before a piece, at least [s]: what only time settles."""
LEAD_MAX: Final = 2.0
"""Motion before a piece, at most [s]: it is run through and says nothing."""
LEAD_TRAVEL: Final = 0.3
"""Way of the motion before a piece, within LEAD_MIN and LEAD_MAX [range of position]: slow hysteresis is known after
it."""
SLOW_SPEED: Final = 0.02
"""Speed below which motion counts as slow where pieces are chosen [largest speed]: pieces rich in slow motion are
wanted too."""
REST_SPEED: Final = 4e-4
"""Speed below which the axis rests where pieces are chosen [largest speed]: reversals count from rest too."""
PLACES: Final = 60
"""Parts of the range of position that pieces are to have been at [1]: pitches show over all of it."""


@dataclass(frozen=True)
class _Piece:
    """A block of the record, and the row the motion before it begins at."""

    block: int
    first: int


def make_excerpt(recording: Recording) -> Recording:
    """Return the record that models are fitted to; of a longer one segments from all over it, `fitted_time` in all.

    A piece is a block and the motion before it, which the fit runs through and does not see: as long as states need to
    forget the past. The record is cut into as many stretches of time as there are to be pieces. Each gives the
    one of its blocks that is richest in something, taking turns: reversals, acceleration, speed, slow motion, and
    places no piece has been to. So drifts and steps are seen from the first stretch to the last, pitches over the
    whole range, and rare motion is seen too. Rows are as fine as those of a short record.
    """
    step = recording.factor / recording.machine.sampling.rate
    seconds = recording.machine.diagnosis.fitted_time
    m = len(recording.time)
    if m * step <= seconds:
        return recording
    pieces = _pieces(recording)
    if not pieces:  # nothing ever moves far enough to forget where it started: the beginning of the record
        ends = [float(recording.time[recording.block == b][-1]) for b in range(recording.blocks)]
        pieces = [_Piece(b, 0) for b, end in enumerate(ends) if end < seconds]
    wanted, chosen = np.zeros(m, dtype=np.bool_), np.full(m, -1, dtype=np.int64)
    parts = math.ceil(BLOCKS / len(pieces))
    for number, piece in enumerate(pieces):
        rows = np.flatnonzero(recording.block == piece.block)
        wanted[piece.first : rows[-1] + 1] = True
        chosen[rows] = number * parts + np.arange(len(rows)) * parts // len(rows)
    last = np.flatnonzero(wanted & ~np.append(wanted[1:], True))
    for back in range(SEAM):
        chosen[np.maximum(last - back, 0)] = -1
    numbers, block = np.unique(chosen[wanted], return_inverse=True)
    block = np.where(chosen[wanted] >= 0, block - int(numbers[0] < 0), -1)
    kept = numbers[numbers >= 0]
    fine = samples_per_row(recording.machine)
    samples = np.flatnonzero(np.repeat(wanted, recording.factor))
    fitted = reduce_signals(
        recording.machine,
        recording.signals.part(samples),
        recording.clock[samples],
        fine,
        np.repeat(block, recording.factor // fine).astype(np.int64),
        split_blocks(len(kept), recording.machine)[0],
        recording.held_out[[pieces[k // parts].block for k in kept.tolist()]],
        recording.warnings,
    )
    note = (
        f"models are fitted to {float(fitted.used.sum()) / fitted.rate:.0f} s of the record's {m * step:.0f} s, in "
        f"{len(pieces)} pieces from all over it; what is left is stated for the whole record"
    )
    encoder = recording.noise, recording.unfiltered, recording.misread
    noise, unfiltered, misread = (a if a is None else a[samples] for a in encoder)
    return replace(
        fitted,
        noise=noise,
        unfiltered=unfiltered,
        misread=misread,
        warnings=(*recording.warnings, note),
        has_own_speeds=recording.has_own_speeds,
        is_filtered=recording.is_filtered,
    )


def _pieces(recording: Recording) -> list[_Piece]:
    """The pieces of an excerpt; none where no state ever forgets."""
    leads = _leads(recording)
    if len(leads) < 2:
        return []
    span = {b: slice(first, int(np.flatnonzero(recording.block == b)[-1]) + 1) for b, first in leads.items()}
    step = recording.factor / recording.machine.sampling.rate
    length = float(np.mean([rows.stop - rows.start for rows in span.values()])) * step
    count = max(2, min(len(leads), int(recording.machine.diagnosis.fitted_time / length)))
    one_in = recording.machine.diagnosis.held_out_one_in
    place = _places(recording)
    seen = np.zeros(PLACES, dtype=np.bool_)

    def new_places(rows: slice) -> float:
        return float(np.count_nonzero(~seen[np.unique(place[rows])]))

    turn = (*_riches(recording), new_places)
    pieces = []
    for k, stretch in enumerate(np.array_split(np.array(sorted(leads)), count)):
        # As large a share of them as of the record is held out.
        same = [b for b in stretch.tolist() if bool(recording.held_out[b]) == (k % one_in == 1)] or stretch.tolist()
        rich = {b: turn[k % len(turn)](span[b]) for b in same}
        best = max(same, key=lambda b: rich[b])
        seen[place[span[best]]] = True
        pieces.append(_Piece(best, leads[best]))
    return pieces


def _leads(recording: Recording) -> dict[int, int]:
    """Row the motion before a block begins at, of every block before which states forget."""
    step = recording.factor / recording.machine.sampling.rate
    path = np.concatenate(([0.0], np.cumsum(np.abs(recording.velocity)) * step))
    low, high = float(np.min(recording.position)), float(np.max(recording.position))
    forget = forget_extent(recording.machine)
    way = LEAD_TRAVEL * (high - low)
    least, most = (math.ceil(lead / step) for lead in (LEAD_MIN, LEAD_MAX))
    leads: dict[int, int] = {}
    for block in range(recording.blocks):
        start = int(np.flatnonzero(recording.block == block)[0])
        earliest = max(0, start - most)
        wiped = start - count_spanning(recording.position[earliest : start + 1][::-1], forget)
        begin = int(np.searchsorted(path, path[start] - way, side="right")) - 1
        begin = max(earliest, min(begin, start - least, wiped))
        if begin == 0 or wiped >= earliest:
            leads[block] = begin
    return leads


def _places(recording: Recording) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Return the part of the range of position each decimated sample is in (m)."""
    low, high = float(np.min(recording.position)), float(np.max(recording.position))
    return np.minimum(PLACES - 1, (recording.position - low) / max(high - low, 1e-12) * PLACES).astype(np.int64)


def _riches(recording: Recording) -> tuple[Callable[[slice], float], ...]:
    """Return measures of rows: reversals, acceleration, speed, slow motion."""
    velocity, speed = recording.velocity, np.abs(recording.velocity)
    fastest = float(speed.max())
    sign = np.sign(np.where(speed > REST_SPEED * fastest, velocity, 0.0))
    turns = np.append(sign[1:] * sign[:-1] < 0.0, False) | np.append((sign[1:] != 0.0) & (sign[:-1] == 0.0), False)
    slow = (sign != 0.0) & (speed < SLOW_SPEED * fastest)
    return (
        lambda rows: float(np.count_nonzero(turns[rows])),
        lambda rows: float(np.sum(recording.acceleration[rows] ** 2)),
        lambda rows: float(np.sum(velocity[rows] ** 2)),
        lambda rows: float(np.count_nonzero(slow[rows])),
    )
