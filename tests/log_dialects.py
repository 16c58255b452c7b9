"""A small machine and one simulated trace, which tests write in every dialect."""

from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from cli_cases import SMALL
from record_cases import simulate_log
from sgms_bench.logs.dialects import COUNTS_PER_METRE
from sgms_mhe.configuration import load_machine
from sgms_mhe.machine import Machine
from sgms_mhe.signals.logs import Log


@lru_cache
def machine() -> Machine:
    """Two elements at 1 kHz."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "small.toml"
        path.write_text(SMALL)
        return load_machine(path)


@lru_cache
def trace() -> Log:
    """Four seconds whose positions are whole counts and whose times are whole milliseconds."""
    log = simulate_log(machine(), seconds=4.0, fastest=0.05, encoder_resolution_m=1.0 / COUNTS_PER_METRE)
    return Log(np.arange(len(log)) / 1000.0, log.position_m, log.force_N, 1000.0)
