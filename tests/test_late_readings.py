"""Identification where a position is read off its stamp: noise of the acceleration, and none of the mass's.

The plant is written here: an inertia with sliding friction, driven by a torque of two sines.
"""

import re
from pathlib import Path

import numpy as np
import pytest

from sgms_bench.logs.faults import relay_truth
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.emission.package import emit_package, write_package
from sgms_mhe.identification import Identification, Wanted, identify
from sgms_mhe.machine import Machine
from sgms_mhe.signals.logs import Log

INERTIA, LEVEL, VISCOUS = 2e-4, 0.06, 4e-4
SUBSTEPS = 20


def spinning_axis(rate: float, lateness: float, seed: int, seconds: float = 12.0) -> Log:
    """Return the log of an axis that is read up to `lateness` samples after its stamps."""
    random, count = np.random.default_rng(seed), int(seconds * rate)
    h = 1.0 / rate / SUBSTEPS
    stamps = np.arange(count) / rate
    force = 0.35 * np.sin(2 * np.pi * 2.0 * stamps) + 0.1 * np.sin(2 * np.pi * 4.7 * stamps)
    speed, angle, way = 0.0, 0.0, np.empty((count, SUBSTEPS))
    for k in range(count):
        for j in range(SUBSTEPS):
            way[k, j] = angle
            rest = force[k] - VISCOUS * speed
            # Implicit in the direction: an axis that friction holds stands.
            free = speed + h * rest / INERTIA
            speed = np.sign(free) * max(abs(free) - h * LEVEL / INERTIA, 0.0)
            angle += h * speed
    late = random.integers(0, max(1, round(lateness * SUBSTEPS)), count)
    position = way[np.arange(count), np.minimum(late, SUBSTEPS - 1)]
    noise = 1e-3 * random.standard_normal(count)
    return Log(stamps, position, force + noise, rate, kind="rotary", source="late.csv")


def like(folder: Path, rate: float, cutoff: float) -> Machine:
    """Return a machine file of an axis that is like it, wrong in every number."""
    path = folder / "like.toml"
    path.write_text(
        f"""name = "like"
[plant]
kind = "rotary"
inertia = 1e-3
[friction]
coulomb = 0.5
viscous = 1e-3
stiffness = [100.0]
fraction = [1.0]
[sampling]
rate = {rate}
update_rate = {rate / 10}
velocity_cutoff = {cutoff}
max_velocity = 900.0
""",
        encoding="utf-8",
    )
    return load_machine(path)


def assert_true(found: Identification) -> None:
    """Every number is within three deviations of the truth, the inertia within 1 %, and nothing acts on the axis."""
    numbers = {number.name: number for number in found.numbers}
    for name, truth in (("mass", INERTIA), ("coulomb", LEVEL), ("viscous", VISCOUS)):
        number = numbers[name]
        assert abs(number.value - truth) <= 3.0 * number.std, (name, number)
    assert abs(numbers["mass"].value - INERTIA) <= 0.01 * INERTIA
    assert not [name for name in numbers if "." in name]


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "lateness", "cutoff", "seed"), [(1000.0, 0.9, 100.0, 1), (500.0, 0.5, 80.0, 2)])
def test_a_low_pass_that_biases_the_inertia_is_replaced_and_said(
    rate: float, lateness: float, cutoff: float, seed: int, tmp_path: Path
) -> None:
    log = spinning_axis(rate, lateness, seed)
    found = identify([log], Wanted("axis", like=like(tmp_path, rate, cutoff)))
    assert_true(found)
    said = [warning for warning in found.warnings if f"in place of {cutoff:g} Hz" in warning]
    assert len(said) == 1 and re.search(r"inertia \d+% too small", said[0])
    assert found.machine.sampling.velocity_cutoff < cutoff


@pytest.mark.slow
def test_a_low_pass_that_biases_nothing_is_kept_and_stated_errors_are_handed_on(tmp_path: Path) -> None:
    """Those of the model are no number of the fit, and the file that is written has them again."""
    stated = {"mass": 0.01, "gain": 0.02, "force": 0.1}
    machine = override_machine(like(tmp_path, 1000.0, 100.0), {"estimator": {"disturbance": stated}})
    found = identify([spinning_axis(1000.0, 0.0, 3)], Wanted("axis", like=machine))
    assert_true(found)
    assert found.machine.sampling.velocity_cutoff == 100.0
    assert not [warning for warning in found.warnings if "in place of" in warning]
    disturbance = found.machine.estimator.disturbance
    assert (disturbance.mass, disturbance.gain, disturbance.force) == (0.01, 0.02, 0.1)
    assert "[estimator.disturbance]" in found.toml


@pytest.mark.slow
def test_a_torque_that_a_drive_holds_is_no_friction_of_the_load() -> None:
    """It jumps between two values at 500 Hz; behind the low-pass that looked like a level that falls with the load."""
    truth = relay_truth(np.random.default_rng(7004))
    motion = truth.log
    assert motion.rate == 500.0
    log = Log(motion.time_s, motion.position_m, motion.force_N, motion.rate, kind="rotary", source="relay.csv")
    found = identify([log], Wanted("relay"))
    numbers = {number.name: number for number in found.numbers}
    assert not [name for name in numbers if "." in name]
    for name, true in (("mass", truth.axis.mass), ("coulomb", truth.axis.coulomb), ("viscous", truth.axis.viscous)):
        assert numbers[name].value == pytest.approx(true, rel=2e-3), name


@pytest.mark.slow
def test_elements_that_the_log_does_not_resolve_are_open(tmp_path: Path) -> None:
    """Friction that turns within a thousandth of a sample: the level is known, no stiffness, and the file generates."""
    random, rate = np.random.default_rng(3), 500.0
    time = np.arange(int(12.0 * rate)) / rate
    speed = 2.0 * np.sin(2.1 * time) * np.sin(0.37 * time + 0.5)
    torque = 0.05 * np.gradient(speed, time) + 0.8 * np.tanh(speed / 1e-3) + 0.1 * speed
    noise = 0.01 * random.standard_normal(len(time))
    log = Log(time, np.cumsum(speed) / rate, torque + noise, rate, kind="rotary", source="sharp.csv")
    found = identify([log], Wanted("sharp", mass=0.05))
    numbers = {number.name: number for number in found.numbers}
    assert abs(numbers["coulomb"].value - 0.8) <= 3.0 * numbers["coulomb"].std <= 0.01
    assert numbers["coulomb"].determined
    elements = [number for name, number in numbers.items() if name.startswith("stiffness_")]
    assert elements and not any(number.determined for number in elements)
    write_package(emit_package(found.machine, within_budget=True), tmp_path / "sharp")
