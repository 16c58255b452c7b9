"""Numbers with signs: registers that were recorded without theirs, and forces that were turned round."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from cli_cases import refused, run
from sgms_mhe.api.inputs import read_log
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import InputError
from test_log_forms import own, rotor, write

Array = NDArray[np.float64]


def register(log: Log, bits: int, counts: float, factor: float = 1.0) -> Array:
    """The force as a register of so many bits with a sign has it, recorded without."""
    return factor * np.mod(np.round(counts * log.force_N / np.abs(log.force_N).max()), 2.0**bits)


REGISTERS = [(8, 10.0, 1.0), (8, 30.0, 0.001), (16, 12.0, 0.001), (16, 5000.0, 1.0), (32, 400.0, 1.0), (32, 3e7, 1.0)]


@pytest.mark.parametrize(("bits", "counts", "factor"), REGISTERS)
def test_a_number_with_a_sign_that_was_recorded_without_is_said(
    bits: int, counts: float, factor: float, tmp_path: Path
) -> None:
    """Such a torque was read as one of the other sign, and scale = -1 advised."""
    log = rotor(21)
    true = np.round(counts * log.force_N / np.abs(log.force_N).max()) * factor
    path = write(tmp_path / "log.csv", **{**own(log), "torque_Nm": register(log, bits, counts, factor)})
    scale = {"torque_Nm": {"unit": "mA", "scale": 0.5}}
    for table, times in (({}, 1.0), (scale, 0.5e-3 / 1e-3), ({"resample": True}, 1.0)):
        with pytest.raises(InputError, match=rf"jumps by .*signed number of {bits} bits") as caught:
            read_log(path, table=table)
        line = tomllib.loads(caught.value.allowed.partition("turns back: ")[2])
        key, value = ("signed", bits) if factor == 1.0 else ("wrap", 2.0**bits * factor)
        assert line["torque_Nm"][key] == pytest.approx(value, rel=1e-9)
        assert read_log(path, table={**table, **line}).force_N == pytest.approx(
            times * true, abs=1e-6 * factor * counts
        )
    assert read_log(path, table={"torque_Nm": {"wrap": 2.0**bits * factor}}).force_N == pytest.approx(true, rel=1e-6)


@pytest.mark.parametrize(
    "values",
    [
        lambda log: 255.0 * (log.force_N > 0.0),  # on and off
        lambda log: np.where(log.force_N > 0.0, 60.0, 196.0),  # two levels
        lambda log: np.round(100.0 + 90.0 * log.force_N / np.abs(log.force_N).max()),  # about an offset
        lambda log: np.round(np.random.default_rng(1).uniform(0.0, 65535.0, len(log))),
        lambda log: np.round(60000.0 + 200.0 * np.sin(log.time_s)),
    ],
)
def test_what_has_no_sign_is_not_said_to_have_one(values: Callable[[Log], Array], tmp_path: Path) -> None:
    path = write(tmp_path / "log.csv", **{**own(rotor(22)), "torque_Nm": values(rotor(22))})
    assert read_log(path).force_N.max() > 100.0


def test_a_range_is_that_of_the_recorded_number(tmp_path: Path) -> None:
    log = rotor(23)
    path = write(tmp_path / "log.csv", **{**own(log), "torque_Nm": register(log, 16, 500.0)})
    for keys in ({"signed": 8}, {"wrap": 65.536}):
        with pytest.raises(InputError, match="after which they start over"):
            read_log(path, table={"torque_Nm": keys})


@pytest.mark.parametrize(("unit", "times"), [("ms", 1e3), ("us", 1e6)])
def test_the_rate_is_why_a_time_in_another_unit_is_refused(unit: str, times: float, tmp_path: Path) -> None:
    log = rotor(24, rate=500.0)
    path = write(tmp_path / "log.csv", **{**own(log), "time_s": times * log.time_s})
    for said in (refused("identify", path, "--out", tmp_path / "m.toml"), run("inspect", path).stdout):
        assert f"{500.0 / times:g}" in said and f'time_s = {{ variable = "...", unit = "{unit}" }}' in said
        assert "usable samples" not in said
