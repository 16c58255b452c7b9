"""Numbers with signs: registers that were recorded without theirs, and forces that were turned round."""

import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from cli_cases import refused, run
from sgms_mhe.api.inputs import read_log
from sgms_mhe.logfiles.plausibility import check_plausible
from sgms_mhe.signals.logs import Log, write_log
from sgms_mhe.support.errors import InputError
from test_log_forms import own, rotor, write

Array = NDArray[np.float64]


def register(log: Log, bits: int, counts: float, factor: float = 1.0) -> Array:
    """The force as a register of so many bits with a sign has it, recorded without."""
    return factor * np.mod(np.round(counts * log.force_N / np.abs(log.force_N).max()), 2.0**bits)


REGISTERS = [
    *((8, 10.0, 1.0), (8, 30.0, 0.001), (16, 12.0, 0.001), (16, 5000.0, 1.0), (16, 900.0, 0.0152587 / 7.0)),
    *((32, 400.0, 1.0), (32, 3e7, 1.0)),
    *((32, 400.0, 2.0**-31), (32, 2e5, 0.001), (32, 3e7, 100.0 * 2.0**-31), (32, 1e9, 0.001)),
]


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
    for keys in ({"wrap": 2.0**bits * factor}, {"signed": bits}):
        assert read_log(path, table={"torque_Nm": keys}).force_N == pytest.approx(true, abs=1e-6 * factor * counts)


@pytest.mark.parametrize("digits", [6, 9, 12])
@pytest.mark.parametrize("factor", [2.0**-31, 0.001, 100.0 * 2.0**-31, 0.0152587 / 7.0])
def test_a_scaled_register_with_few_digits_is_turned_rightly_or_not_at_all(
    digits: int, factor: float, tmp_path: Path
) -> None:
    """Digits too few for the step between two numbers tell its range where they come close to it, or nothing."""
    log = rotor(25)
    for counts in (400.0, 2e5, 3e7, 1e9):
        true = np.round(counts * log.force_N / np.abs(log.force_N).max()) * factor
        values = [float(f"{value:.{digits}g}") for value in np.mod(true, 2.0**32 * factor)]
        path = write(tmp_path / "log.csv", **{**own(log), "torque_Nm": np.array(values)})
        try:
            found = read_log(path, table={"torque_Nm": {"signed": 32}}).force_N
        except InputError as error:
            assert "wrap = 2^32 times the step" in str(error)
        else:
            assert found == pytest.approx(true, abs=2.0**32 * factor * 10.0 ** (1 - digits))


@pytest.mark.parametrize(
    "values",
    [
        lambda log: 255.0 * (log.force_N > 0.0),  # on and off
        lambda log: np.where(log.force_N > 0.0, 60.0, 196.0),  # two levels
        lambda log: np.round(100.0 + 90.0 * log.force_N / np.abs(log.force_N).max()),  # about an offset
        lambda log: np.round(np.random.default_rng(1).uniform(0.0, 65535.0, len(log))),
        lambda log: np.round(60000.0 + 200.0 * np.sin(log.time_s)),
        lambda log: (
            200.0 * (log.force_N > 0.0) + np.random.default_rng(1).uniform(0.0, 1.0, len(log))
        ),  # one way, noise
        lambda log: 500.0 * (1.0 - 2.0**-9 * np.abs(log.force_N) / np.abs(log.force_N).max()) * (log.force_N > 0.0),
    ],
)
def test_what_has_no_sign_is_not_said_to_have_one(values: Callable[[Log], Array], tmp_path: Path) -> None:
    path = write(tmp_path / "log.csv", **{**own(rotor(22)), "torque_Nm": values(rotor(22))})
    assert read_log(path).force_N.max() > 100.0


def test_a_range_is_that_of_the_recorded_number(tmp_path: Path) -> None:
    log = rotor(23)
    path = write(tmp_path / "log.csv", **{**own(log), "torque_Nm": register(log, 16, 500.0)})
    for keys in ({"signed": 8}, {"wrap": 65.536}):  # of scaled numbers below
        with pytest.raises(InputError, match="after which they start over"):
            read_log(path, table={"torque_Nm": keys})


@pytest.mark.parametrize(("unit", "times"), [("ms", 1e3), ("us", 1e6)])
def test_the_rate_is_why_a_time_in_another_unit_is_refused(unit: str, times: float, tmp_path: Path) -> None:
    log = rotor(24, rate=500.0)
    path = write(tmp_path / "log.csv", **{**own(log), "time_s": times * log.time_s})
    for said in (refused("identify", path, "--out", tmp_path / "m.toml"), run("inspect", path).stdout):
        assert f"{500.0 / times:g}" in said and f'time_s = {{ variable = "...", unit = "{unit}" }}' in said
        assert "usable samples" not in said


# --- forces that were turned round ---------------------------------------------------------------------------------


def drawn(seed: int, load: str) -> Log:
    """An axis of inertia and one element of friction, in moves between places or in sines, with a load beside it."""
    rng = np.random.default_rng(seed)
    rate, travel = float(rng.choice([200.0, 500.0, 1000.0])), 10.0 ** rng.uniform(-1.5, 0.5)
    time = np.arange(int(rng.uniform(8.0, 14.0) * rate)) / rate
    if seed % 2:
        places = np.repeat(rng.uniform(-0.5, 0.5, 40), int(rng.uniform(0.4, 1.2) * rate))[: len(time)]
        time = time[: len(places)]
        width = int(0.3 * rate)
        position = np.convolve(np.pad(places, width, "edge"), np.hanning(2 * width + 1) / width, "valid")
    else:
        waves = zip(rng.uniform(0.1, 2.0, 3), rng.uniform(0.0, 6.0, 3), strict=True)
        position = sum(np.sin(2.0 * np.pi * f * time + phase) / f for f, phase in waves)
    position = travel * position / np.ptp(position)
    speed = np.gradient(position, 1.0 / rate)
    inertial = np.gradient(speed, 1.0 / rate)
    level, length = np.std(inertial) * 10.0 ** rng.uniform(-0.5, 1.0), travel * 10.0 ** rng.uniform(-4.0, -2.0)
    stretch, stretches = 0.0, []
    for step in np.diff(position, prepend=position[0]) / length:
        stretch = min(max(stretch + step, -1.0), 1.0)
        stretches.append(stretch)
    force = inertial + level * np.array(stretches) + 0.2 * level * speed / np.abs(speed).max()
    size, inside = float(np.std(force)), np.maximum(position - np.quantile(position, rng.uniform(0.3, 0.9)), 0.0)
    if load == "gravity":
        force = force + size * 10.0 ** rng.uniform(0.0, 1.3) * np.sin(position + rng.uniform(0.0, 6.0))
    if load == "contact":
        force = force + size * rng.uniform(1.0, 10.0) * inside / inside.max()
    if load == "held":  # against what moves it from outside, as a spring and a damper
        force = -size * (
            rng.uniform(0.5, 3.0) * position / np.std(position) + rng.uniform(0.1, 1.0) * speed / np.std(speed)
        )
    force = force + rng.normal(0.0, 0.02 * np.std(force), len(force))
    if load == "no sign":
        force = np.mod(force, 2.0 * np.abs(force).max() * rng.uniform(1.02, 20.0))
    grid = travel * 10.0 ** rng.uniform(-5.0, -3.3)
    return Log(time, np.round(position / grid) * grid, force, rate, kind="rotary")


def advises_to_turn(log: Log) -> bool:
    try:
        check_plausible(log, None)
    except InputError as error:
        return "scale = -" in str(error)
    return False


@pytest.mark.parametrize("load", ["none", "gravity", "contact", "held", "no sign"])
def test_a_force_is_to_be_turned_only_where_it_then_brakes_and_leaves_less(load: str) -> None:
    """Three of three such hints were false: a register without sign, gravity, and a contact."""
    logs = [drawn(seed, load) for seed in range(24)]
    assert [seed for seed, log in enumerate(logs) if advises_to_turn(log)] == []
    turned = sum(advises_to_turn(replace(log, force_N=-log.force_N)) for log in logs)
    assert turned >= 22 if load in ("none", "gravity", "contact") else turned == 0


@pytest.mark.parametrize(("scale", "said"), [("31.5", -31.5), ("-0.02", 0.02)])
def test_the_scale_that_is_advised_turns_the_one_that_was_given(scale: str, said: float, tmp_path: Path) -> None:
    log = drawn(1, "none")
    path = write(tmp_path / "log.csv", **{**own(log, "time_s", "position_rad"), "Iq [mA]": -log.force_N / float(scale)})
    flags = ("--force-scale", scale, "--unit", "force=A")
    for command in (("inspect", path), ("identify", path, "--out", tmp_path / "m.toml")):
        result = run(*command, *flags)
        line = tomllib.loads((result.stdout + result.stderr).partition("--log) has ")[2].partition(", or")[0])
        assert line == {"torque_Nm": {"variable": "Iq [mA]", "scale": said, "unit": "A"}}


def test_a_message_names_the_log_that_it_speaks_of(tmp_path: Path) -> None:
    log, paths = drawn(1, "none"), [tmp_path / name for name in ("a.csv", "b.csv", "c.csv")]
    for path, sign in zip(paths, (1.0, -1.0, 1.0), strict=True):
        write_log(path, replace(log, force_N=sign * log.force_N))
    assert f"{paths[1]}: column torque_Nm" in refused("identify", *paths, "--out", tmp_path / "m.toml")
