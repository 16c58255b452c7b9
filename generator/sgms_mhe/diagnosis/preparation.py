"""Logs along a machine, as a diagnosis needs them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from sgms_mhe.diagnosis.final_fit import RecordResidual
from sgms_mhe.diagnosis.fits import Fit, Subject, fit_model
from sgms_mhe.diagnosis.laws import list_compilations
from sgms_mhe.diagnosis.models import FitError
from sgms_mhe.machine import Machine
from sgms_mhe.recordings.excerpt import SEAM, make_excerpt
from sgms_mhe.recordings.joining import drop_rows, join_recordings
from sgms_mhe.recordings.recording import REMEMBERED_MIN, Recording, add_encoder, count_spanning, forget_extent, prepare
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.parallel import beside

Intervals = Sequence[tuple[float, float]]


@dataclass(frozen=True, eq=False)
class Prepared:
    """Logs along a machine: all of them, the part that models are fitted to, the machine as it is."""

    record: Recording
    recording: Recording
    nominal: Fit

    @property
    def machine(self) -> Machine:
        """Whose signal chain the logs went through."""
        return self.record.machine

    def residual_along(self, record: Recording, sampled: Array) -> RecordResidual:
        """Return the residual of this machine as it is on the rows of another one's record of the same log.

        `sampled`: as of an alignment.
        """
        rows = {name: getattr(record, name) for name in ("used", "block", "fold", "held_out")}
        return RecordResidual.along(Subject.of(self.machine, replace(self.record, **rows)), self.nominal, sampled)


def prepare_log(machine: Machine, log: Log, held_out_s: Intervals | None = None) -> Recording:
    """Return a log along a machine, of a long one the segments that models are fitted to."""
    return make_excerpt(add_encoder(prepare(machine, log, held_out_s), log))


def prepare_logs(machine: Machine, logs: Sequence[Log], held_out_s: Intervals | None) -> Prepared:
    """Return logs of one axis as one record; of several long ones the segments that models are fitted to.

    `held_out_s`: as of `diagnose`, of the first one.

    Raises:
        InputError: a log does not fit the machine, or has too few usable samples.
        FitError: the machine's own model is not finite, or several logs are too long to be one.
    """
    if len(logs) > 1:
        parts = [prepare_log(machine, log, None if i else held_out_s) for i, log in enumerate(logs)]
        if len({part.factor for part in parts}) > 1:
            raise FitError("the records are so long that their rows differ")
        record = recording = join_recordings([_drop_ends(part) for part in parts])
    else:
        record = prepare(machine, logs[0], held_out_s)
        record = beside(partial(add_encoder, record, logs[0]), list_compilations(machine, make_excerpt(record)))
        recording = make_excerpt(record)
    return Prepared(record, recording, fit_model(Subject.of(machine, recording), (), refitted=()))


def _drop_ends(recording: Recording) -> Recording:
    """Return a recording whose neighbours in a joined one do not show: the beginning elements remember, and its end."""
    rows = np.arange(len(recording.time))
    ends = (rows < count_spanning(recording.position, forget_extent(recording.machine))) | (rows >= len(rows) - SEAM)
    kept = np.count_nonzero(recording.used & ~ends)
    return drop_rows(recording, ends) if kept >= REMEMBERED_MIN * np.count_nonzero(recording.used) else recording
