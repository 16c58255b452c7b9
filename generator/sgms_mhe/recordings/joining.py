"""Several recordings as one: rows one log behind the other, blocks numbered through."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sgms_mhe.recordings.path import ENCODERS
from sgms_mhe.recordings.recording import Recording, Runs
from sgms_mhe.signals.chain import Signals
from sgms_mhe.support.arrays import Mask


def join_recordings(recordings: Sequence[Recording]) -> Recording:
    """Rows of several recordings behind one another, blocks numbered through; of one that itself.

    Time begins anew with each. Where an encoder's steps show in some logs, it adds nothing in the others.
    """
    first = recordings[0]
    if len(recordings) == 1:
        return first
    if any(r.noise is not None for r in recordings):
        recordings = [r if r.noise is not None else _add_no_steps(r) for r in recordings]
    offsets = np.cumsum([0, *(r.blocks for r in recordings)])

    def join(name: str) -> Any:
        parts = [getattr(r, name) for r in recordings]
        return None if any(part is None for part in parts) else np.concatenate(parts)

    signals: dict[str, Any] = {
        name: np.concatenate([getattr(r.signals, name) for r in recordings])
        for name, value in vars(first.signals).items()
        if isinstance(value, np.ndarray)
    }
    names = ("clock", "time", "position", "velocity", "acceleration", "force", "friction", "used", "fold", "held_out")
    arrays: dict[str, Any] = {name: join(name) for name in (*names, "noise", "unfiltered", "misread")}
    blocks = [np.where(r.block >= 0, r.block + k, -1) for r, k in zip(recordings, offsets[:-1], strict=True)]
    return replace(
        first,
        **arrays,
        signals=Signals(**signals, delay=first.signals.delay),
        block=np.concatenate(blocks),
        warnings=tuple(w for r in recordings for w in r.warnings),
        has_payload=any(r.has_payload for r in recordings),
        of_log=np.repeat(np.arange(len(recordings)), [len(r.time) for r in recordings]),
        runs=Runs(),
    )


def _add_no_steps(recording: Recording) -> Recording:
    """Return a recording whose encoder leaves nothing: every encoder reads its own velocity."""
    own = recording.unfiltered
    misread = None if own is None else np.repeat(own[:, 1:2], 1 + ENCODERS, axis=1)
    return replace(recording, noise=np.zeros((len(recording.signals), 3)), misread=misread)


def drop_rows(recording: Recording, rows: Mask) -> Recording:
    """Return a recording some of whose rows (m) do not count; blocks with no others are none."""
    used = recording.used & ~rows
    left = np.unique(recording.block[used])
    number = np.full(recording.blocks, -1)
    number[left] = np.arange(len(left))
    return replace(
        recording,
        used=used,
        block=np.where(used, number[recording.block], -1),
        fold=recording.fold[left],
        held_out=recording.held_out[left],
    )
