"""Residual and noise floor of one log: the same numbers under these names, whichever command states them."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from cli_cases import done, run

Array = NDArray[np.float64]

RATE = 1000.0


def motion(t: Array) -> Array:
    """Sines of several sizes, then loops below break-away, then a crawl (n) [m]."""
    wide = 0.02 * np.sin(2.0 * np.pi * 0.45 * t) + 0.003 * np.sin(2.0 * np.pi * 4.1 * t)
    small = 4e-5 * np.sin(2.0 * np.pi * 0.8 * t)
    slow = 2e-3 * np.sin(2.0 * np.pi * 0.1 * t)
    found = np.zeros_like(t)
    for part, begin, end in ((wide, 0.0, 10.0), (small, 10.0, 13.0), (slow, 13.0, 18.0)):
        ramp = np.clip(np.minimum(t - begin, end - t) / 0.5, 0.0, 1.0)
        found += part * ramp**3 * (10.0 - 15.0 * ramp + 6.0 * ramp**2)
    return found


def write_log(path: Path, *, step: float, rotary: bool, gap: bool, seed: int) -> None:
    """A switching axis of three elements, its encoder's step [m, rad], gravity of a joint, lost samples."""
    random, fine = np.random.default_rng(seed), 8
    t = np.arange(int(18.0 * RATE) * fine) / (RATE * fine)
    scale = 20.0 if rotary else 1.0  # a joint turns further
    way = scale * motion(t)
    speed = np.gradient(way, t)
    acceleration = np.gradient(speed, t)
    mass, coulomb, viscous = (0.5, 6.0, 4.0) if rotary else (20.0, 25.0, 60.0)
    levels, distances = np.array([0.4, 0.35, 0.25]) * coulomb, np.array([2e-6, 1e-5, 6e-5]) * scale
    friction = np.zeros_like(t)
    for level, distance in zip(levels, distances, strict=True):
        deflection, spring = 0.0, np.empty_like(t)
        for k, moved in enumerate(np.diff(way, prepend=way[0])):
            deflection = min(max(deflection + moved, -distance), distance)
            spring[k] = deflection
        friction += level / distance * spring
    gravity = 12.0 * np.sin(way) if rotary else 0.0
    force = (mass * acceleration + friction + viscous * speed + gravity)[::fine]
    force = force + 0.01 * coulomb * random.standard_normal(len(force))
    names = ("position_rad", "torque_Nm") if rotary else ("position_m", "force_N")
    position = np.round(way[::fine] / step) * step
    rows = [f"{k / RATE:.6f},{x:.12g},{f:.9g}" for k, (x, f) in enumerate(zip(position, force, strict=True))]
    if gap:
        rows[9000:9050] = [f"{k / RATE:.6f},," for k in range(9000, 9050)]
    path.write_text("\n".join((f"time_s,{names[0]},{names[1]}", *rows)) + "\n")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("step", "rotary", "gap"), [(2.0 * np.pi / 2**16, True, False), (3e-7, False, True)], ids=["geared joint", "gap"]
)
def test_one_number_has_one_name(step: float, rotary: bool, gap: bool, tmp_path: Path) -> None:
    """The file's head has two thirds of the log fitted; what comes after has all of it, along the same record."""
    log, file = tmp_path / "log.csv", tmp_path / "found.toml"
    write_log(log, step=step, rotary=rotary, gap=gap, seed=7)
    unit = "Nm" if rotary else "N"
    found = json.loads(done("identify", log, "--out", file, "--elements", "3", "--json").stdout)
    rms = found[f"residual_rms_{unit}"]
    text = re.sub(r"\n#\s+", " ", file.read_text())
    head = re.search(r"held-out residual (\S+) N[ m]* rms of \S+, noise floor (\d[\d.e-]*\d)", text)
    assert head is not None
    assert float(head[1]) == pytest.approx(rms["held_out"], rel=0.006)
    assert float(head[2]) == pytest.approx(rms["noise_floor"], rel=0.006)

    (of_file,) = found["residual_of_file"]
    predicted = json.loads(done("predict", file, log, "--out", tmp_path / "p.csv", "--json").stdout)["residual"]
    assert of_file == pytest.approx(predicted, rel=1e-3)  # the file's numbers are rounded
    diagnosis = json.loads(run("diagnose", file, log, "--out", tmp_path / "d", "--json").stdout)
    stated = diagnosis[f"residual_rms_{unit}"]
    # A diagnosis also takes out what a sample's length makes of friction, and its residual of a good file is small.
    assert predicted[f"rms_{unit}"] == pytest.approx(stated["before"], rel=0.15)
    assert predicted[f"held_out_{unit}"] == pytest.approx(stated["held_out_before"], rel=0.15)
    # Of stiff elements an encoder makes most of it, in a file behind the signal chain.
    assert predicted[f"noise_floor_{unit}"] == pytest.approx(rms["noise_floor"], rel=0.15)
    # A diagnosis assumes stiffnesses as high as its log prefers, and states the floor of those.
    has_assumed = any("assumed" in (number["note"] or "") for number in found["numbers"])
    if not (diagnosis["causes"] or has_assumed):
        assert stated["noise_floor"] == pytest.approx(predicted[f"noise_floor_{unit}"], rel=0.1)
