"""The status of an update: its flags and their names, as the emitted C has them (docs/estimation.md)."""

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

FLAGS: Final[Mapping[str, int]] = {
    "filling": 1,
    "missing": 2,
    "hold": 4,
    "bound": 8,
    "speed": 16,
    "overrun": 32,
    "doubt": 64,
}
"""Flags of an update's status that is not negative; 0 is good."""

STALE: Final = 128
"""A flag by time, of an estimate that is asked for long after its update; no update has it."""

REFUSED: Final = "refused"
"""A negative status: the last good estimate was kept."""

MOST_DOUBT: Final = 0.05
"""Share of the updates up to which doubt is as of the logs that a machine was made from."""


def select_flags(status: NDArray[np.int64]) -> dict[str, NDArray[np.bool_]]:
    """Return the updates that have each flag; `refused` are those of negative status. Arrays (u)."""
    usable = status >= 0
    return {name: usable & (status & flag != 0) for name, flag in FLAGS.items()} | {REFUSED: ~usable}


def measure_doubt(status: NDArray[np.int64]) -> float:
    """Return the share of the updates (u) that doubt the model."""
    return float(select_flags(status)["doubt"].mean())


def has_measurement(status: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Updates that took a measurement in (u)."""
    taken: NDArray[np.bool_] = (status >= 0) & (status & FLAGS["missing"] == 0)
    return taken
