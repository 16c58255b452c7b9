"""Reference trajectories out of files: those of `plan`, and exports of motion controllers."""

from pathlib import Path
from typing import Final

import numpy as np

from sgms_mhe.logfiles.text import read_text
from sgms_mhe.machine import Machine
from sgms_mhe.plant.trajectories import MOST_SAMPLES, Trajectory, lasting
from sgms_mhe.support.errors import InputError

OFF_GRID: Final = 0.5
"""Of a sample: by how much a time may be off the grid of the rate."""


def read_trajectory(path: str | Path, machine: Machine, *, duration_s: float | None = None) -> Trajectory:
    """The trajectory of a CSV file, repeated or cut to `duration_s` where that is given.

    Args:
        path: columns `time_s` and `position_m` (`position_rad` of a rotary axis), a sample a row.
        machine: whose axis is to move.
        duration_s: None: as long as the file is.

    Raises:
        InputError: no such file or columns; times that are not those of the machine's rate; positions that are not
            finite or ask for more than the machine's largest speed.
    """
    source = Path(path)
    if not source.is_file():
        raise InputError(source, "trajectory", str(path), "a CSV file that exists, or the name of a trajectory")
    units, sampling = machine.plant.units, machine.sampling
    names = "time_s", units.named("position_m")
    table = read_text(source, None)
    found = {column.name for column in table.columns}
    for name in names:
        if name not in found:
            raise InputError(source, "columns", ", ".join(sorted(found)), f"{' and '.join(names)}")
    values = table.read(names)
    time, position = (np.asarray(values[name], dtype=np.float64) for name in names)
    if not 2 <= len(time) <= MOST_SAMPLES:
        raise InputError(source, "rows", len(time), f"2 to {MOST_SAMPLES}")
    for name, series in zip(names, (time, position), strict=True):
        bad = np.flatnonzero(~np.isfinite(series))
        if len(bad):
            raise InputError(source, f"{name}, {table.row(int(bad[0]))}", float(series[bad[0]]), "a finite number")
    off = np.abs((time - time[0]) * sampling.rate - np.arange(len(time)))
    worst = int(np.argmax(off))
    if not off[worst] < OFF_GRID:
        allowed = f"samples 1/{sampling.rate:g} s apart, as [sampling] rate of {machine.name} has it"
        raise InputError(source, f"time_s, {table.row(worst)}", float(time[worst]), allowed)
    speed = np.abs(np.diff(position)) * sampling.rate
    fastest = int(np.argmax(speed))
    if speed[fastest] > sampling.max_velocity:
        asked = f"{speed[fastest]:.4g} {units.velocity}"
        allowed = f"at most max_velocity = {sampling.max_velocity:g} {units.velocity}"
        raise InputError(source, f"{names[1]}, {table.row(fastest + 1)}", asked, allowed)
    return lasting(Trajectory(source.stem, sampling.rate, position), duration_s)
