"""The newest runs of models along a record: what was asked for a moment ago is not run again."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Run = tuple[Array, Array | None]
"""Friction (m) and its derivatives (m, n_p), None where not asked for."""

KEPT: Final = 12  # runs: a fit begins where another one ended, an alignment runs what a fit ended with


class Runs:
    """Results by the code that ran, the signals it ran along (both by identity), and theta."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: OrderedDict[tuple[int, int, bytes], tuple[object, object, Run]] = OrderedDict()

    def get(self, code: object, signals: object, theta: Array, derivatives: bool, run: Callable[[], Run]) -> Run:
        """What `run` returns, from before where it is known; one with derivatives serves where none are asked for."""
        key = (id(code), id(signals), np.ascontiguousarray(theta, dtype=np.float64).tobytes())
        with self._lock:
            known = self._kept.get(key)
            if known is not None and (known[2][1] is not None or not derivatives):
                self._kept.move_to_end(key)
                return known[2] if derivatives else (known[2][0], None)
        found = run()
        for array in found:
            if array is not None:
                array.setflags(write=False)
        with self._lock:
            # With what identities stand for, so that they stay its own.
            self._kept[key] = code, signals, found
            self._kept.move_to_end(key)
            while len(self._kept) > KEPT:
                self._kept.popitem(last=False)
        return found
