"""Exports of an axis, read and moved by the tools that they are for."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sgms_mhe
from export_cases import (
    AMPLITUDE,
    BASES,
    FREQUENCY,
    OF_MEASUREMENT,
    SUFFIX,
    drive_force,
    machine_of_effect,
    machine_with,
    slave_of,
)
from package_variants import EFFECTS, GEARED
from sgms_mhe.api.exporting import FORMS
from sgms_mhe.configuration import load_machine, override_machine, step_every_sample
from sgms_mhe.evaluation.prediction import predict_signals
from sgms_mhe.signals.chain import Signals

mujoco = pytest.importorskip("mujoco")
rumoca = pytest.importorskip("rumoca")


# --- rigid bodies ------------------------------------------------------------------------------------------------


def loaded(form: str, base: str, folder: Path) -> Any:
    """The exported file as MuJoCo reads it; it reads URDF too."""
    path = folder / f"axis{SUFFIX[form]}"
    sgms_mhe.export(base, form, path)
    return mujoco.MjModel.from_xml_path(str(path))


@pytest.mark.parametrize("base", BASES)
@pytest.mark.parametrize("form", ["mujoco", "urdf"])
def test_mujoco_reads_the_numbers(form: str, base: str, tmp_path: Path) -> None:
    model, machine = loaded(form, base, tmp_path), load_machine(base)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    whole = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, whole) if mujoco.__version__ >= "4" else mujoco.mj_fullM(model, whole, data.qM)
    assert model.nv == 1 + (machine.friction.n_z if form == "mujoco" else 0)
    assert whole.sum() == pytest.approx(machine.plant.moved, rel=1e-12) and whole[0, 0] > 0.99 * machine.plant.moved
    assert model.dof_damping[0] == machine.friction.viscous
    assert model.dof_frictionloss[0] == (machine.friction.coulomb if form == "urdf" else 0.0)
    turns = machine.plant.kind == "rotary"
    assert model.jnt_type[0] == (mujoco.mjtJoint.mjJNT_HINGE if turns else mujoco.mjtJoint.mjJNT_SLIDE)


def moved_friction(model: Any, velocity: Any) -> Any:
    """Friction (n) that MuJoCo computes of a joint that is moved as said, one velocity a step."""
    data, place, found = mujoco.MjData(model), 0.0, []
    for v in velocity.tolist():
        data.qpos[0], data.qvel[0] = place, v
        mujoco.mj_step(model, data)
        place += v * model.opt.timestep
        data.qpos[0], data.qvel[0] = place, v
        mujoco.mj_forward(model, data)
        found.append(-data.qfrc_passive[0] - data.qfrc_actuator[0])
    return np.array(found)


@pytest.mark.parametrize(
    ("base", "stribeck_ratio", "most"),
    [
        *(("etel_xy", ratio, most) for ratio, most in ((0.0, 0.04), (0.12, 0.04), (0.3, 0.09), (1.0, 0.28))),
        ("etel_xy_rotary", 0.12, 0.04),
        ("etel_xy_switching", 0.12, 0.1),
    ],
)
def test_slow_motion_in_mujoco_has_the_friction_of_the_law(base: str, stribeck_ratio: float, most: float) -> None:
    """Small reversals at some mm/s, within and beyond break-away, run in MuJoCo beside the law and the stated error."""
    machine = override_machine(machine_with(base=base), {"friction": {"stribeck_ratio": stribeck_ratio}})
    time = np.arange(20000) * machine.sampling.step
    velocity = sum(
        size * np.sin(2.0 * np.pi * rate * time) for size, rate in ((1e-3, 0.7), (8e-4, 1.9), (3e-4, 0.23), (2e-4, 7.0))
    )
    position = np.concatenate([[0.0], np.cumsum(velocity)[:-1]]) * machine.sampling.step
    none, every = np.zeros(len(time)), np.ones(len(time), dtype=bool)
    signals = Signals(time, position, velocity, none, none, none, every, ~every)
    law = predict_signals(step_every_sample(machine), signals, "made").friction_N
    written = FORMS["mujoco"].write(machine, "axis")
    assert written.simple is not None
    found = moved_friction(mujoco.MjModel.from_xml_string(written.content.decode()), velocity)
    stated = written.simple.friction(velocity, none, machine.sampling.step)
    size = float(np.sqrt(np.mean(law**2)))
    assert np.sqrt(np.mean((found - law) ** 2)) < most * size
    assert np.sqrt(np.mean((found - stated) ** 2)) < 0.03 * size


@pytest.mark.parametrize("form", ["mujoco", "urdf"])
def test_gravity_moves_the_joint_in_mujoco(form: str, tmp_path: Path) -> None:
    """Its torque at rest over a turn is the effect's, and it falls as `simulate`'s axis does but for presliding."""
    effects: list[dict[str, Any]] = [{"name": "unbalance", "amplitude_Nm": 60.0, "phase_rad": 0.7}]
    if form == "mujoco":
        effects += [
            {"name": "position_spring", "stiffness_Nm_rad": 5.0, "centre_rad": 0.3},
            {"name": "constant_offset", "torque_Nm": 0.5},
        ]
    path = tmp_path / f"axis{SUFFIX[form]}"
    machine = machine_with(*effects, base="etel_xy_rotary")
    exported = sgms_mhe.export(machine, form, path)
    assert not any("unbalance" in sentence for sentence in exported.lost)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    for q in np.linspace(-6.0, 6.0, 13):
        spring = 5.0 * (q - 0.3) + 0.5 if form == "mujoco" else 0.0
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        found = data.qfrc_bias[0] - data.qfrc_passive[0] - data.qfrc_actuator[0]
        assert found == pytest.approx(60.0 * np.sin(q + 0.7) + spring, rel=1e-9, abs=1e-9)
    mujoco.mj_resetData(model, data)
    model.opt.timestep = machine.sampling.step
    sgms_mhe.export(machine, "fmu3", tmp_path / "axis.fmu")
    with slave_of(tmp_path / "axis.fmu", tmp_path / "unpacked") as slave:
        plant = slave.run(np.zeros(5000), ("position",))[:, 0]
    moved = []
    for _ in plant:
        mujoco.mj_step(model, data)
        moved.append(data.qpos[0])
    assert np.ptp(plant) > 0.1 and np.abs(moved - plant).max() < 0.03 * np.ptp(plant)


@pytest.mark.parametrize("base", BASES)
def test_mujoco_moves_as_the_plant_does(base: str, tmp_path: Path) -> None:
    """Under the same force, through break-away and reversals; and below break-away it holds the axis like a spring."""
    machine = machine_with(base=base)
    model = mujoco.MjModel.from_xml_string(sgms_mhe.export(machine, "mujoco").text)
    data, moved, force = mujoco.MjData(model), [], drive_force(machine, 1.0)
    sgms_mhe.export(machine, "fmu3", tmp_path / "axis.fmu")
    with slave_of(tmp_path / "axis.fmu", tmp_path / "unpacked") as slave:
        plant = slave.run(force, ("position",))[:, 0]
    for value in force:
        data.ctrl[0] = value
        mujoco.mj_step(model, data)
        moved.append(data.qpos[0])
    assert np.ptp(plant) > 1e-3 and np.abs(moved - plant).max() < 0.015 * np.ptp(plant)
    mujoco.mj_resetData(model, data)
    data.ctrl[0], held = 2.0, []
    while data.time < 2.0:
        mujoco.mj_step(model, data)
        held.append(data.qpos[0])
    assert max(held) < 7e-4 and abs(np.mean(held[15000:]) - np.mean(held[5000:15000])) < 3e-6


@pytest.mark.parametrize("pitch", [0.004, 0.7])
def test_ripple_is_cogging_in_mujoco(pitch: float) -> None:
    ripples = [{"name": "force_ripple", "amplitude_N": 0.6, "pitch_m": pitch, "phase_rad": 0.7}]
    exported = sgms_mhe.export(machine_with(*ripples), "mujoco")
    assert "force_ripple" in exported.holds[1]
    model = mujoco.MjModel.from_xml_string(exported.text)
    data = mujoco.MjData(model)
    for place in np.linspace(-0.01, 0.01, 21):
        data.qpos[:] = place
        mujoco.mj_forward(model, data)
        wanted = -0.6 * np.sin(2.0 * np.pi * place / pitch + 0.7)
        assert data.qfrc_actuator[0] == pytest.approx(wanted, rel=1e-9, abs=1e-9)


def test_a_longer_sample_is_stepped_through_in_parts() -> None:
    """Sliders stay below a hundredth of the axis: at 1 kHz the file's timestep is a part of the sample."""
    machine = override_machine(load_machine("etel_xy"), {"sampling": {"rate": 1000.0, "velocity_cutoff": 50.0}})
    model = mujoco.MjModel.from_xml_string(sgms_mhe.export(machine, "mujoco").text)
    parts = 1e-3 / model.opt.timestep
    assert parts == pytest.approx(round(parts)) and parts > 2
    assert 0.0 < model.body_mass[2:].sum() < 0.01 * machine.plant.moved


# --- equations ---------------------------------------------------------------------------------------------------


def run_equations(text: str, name: str, push: str, duration: float, start: str = "") -> Any:
    """Position and velocity each millisecond of an exported model that a sine drives, by an independent compiler."""
    source = (
        f"{text}\nmodel Driven\n  {name} axis{start};\nequation\n"
        f"  axis.{push} = {AMPLITUDE} * sin({2.0 * np.pi * FREQUENCY!r} * time);\nend Driven;\n"
    )
    model = rumoca.Session().loads(source, model="Driven", filename="driven.mo")
    settings = rumoca.SimConfig(solver="bdf", rtol=1e-8, atol=1e-12)
    found = model.simulate(t=(0.0, duration), dt=1e-3, config=settings)
    return np.array([found["axis.position"], found["axis.velocity"]])


WHOLE = [*BASES, *EFFECTS, *GEARED, "force_delay, drive"]
ROUNDED = {"etel_xy_switching": 5e-4, "backlash": 1e-3}
"""Largest difference over the range of motion where the model rounds a corner off that the plant has; else 6e-5, what
the plant's substeps of 12.5 us leave where a load or a resonance feeds back through the acceleration, and a delay of
the drive by Pade's formula."""


@pytest.mark.slow
@pytest.mark.parametrize("case", WHOLE)
def test_modelica_moves_as_the_plant_does(case: str, tmp_path: Path) -> None:
    """Two descriptions written apart: the symbolic model, compiled by Rumoca, and the plant's C in the FMU."""
    if case in BASES:
        machine = machine_with(base=case)
    elif case == "force_delay, drive":
        machine = machine_with({"name": "force_delay", "delay_s": -0.002})
    else:
        machine = machine_of_effect(case)
    exported = sgms_mhe.export(machine, "modelica", tmp_path / "Axis.mo")
    assert (case in OF_MEASUREMENT) == any("what is measured" in sentence for sentence in exported.lost)
    sgms_mhe.export(machine, "fmu3", tmp_path / "axis.fmu")
    with slave_of(tmp_path / "axis.fmu", tmp_path / "unpacked") as slave:
        plant = slave.run(drive_force(machine, 1.0), ("position", "velocity"))[9::10].T
    found = run_equations(exported.text, "Axis", machine.plant.units.push, 1.0)[:, 1:]
    difference, extent = np.abs(found - plant).max(axis=1), np.ptp(plant, axis=1)
    assert (difference < ROUNDED.get(case, 6e-5) * extent).all(), difference / extent
    assert extent[0] > 1e-3


@pytest.mark.parametrize("base", BASES)
def test_modelica_starts_within_a_motion(base: str, tmp_path: Path) -> None:
    """By the same parameters as the FMU: position, velocity, deflections."""
    machine = machine_with(base=base)
    start = {"position": 0.003, "velocity": -0.02, "deflection_1": -2e-6, "deflection_4": 3e-4}
    exported = sgms_mhe.export(machine, "modelica", tmp_path / "Axis.mo")
    sgms_mhe.export(machine, "fmu3", tmp_path / "axis.fmu")
    with slave_of(tmp_path / "axis.fmu", tmp_path / "unpacked", started=False) as slave:
        slave.fmi.enterInitializationMode()
        for name, value in start.items():
            slave[f"start_{name}"] = value
        slave.fmi.exitInitializationMode()
        plant = slave.run(drive_force(machine, 0.2), ("position", "velocity"))[9::10].T
    given = ", ".join(f"start_{name} = {value!r}" for name, value in start.items())
    found = run_equations(exported.text, "Axis", machine.plant.units.push, 0.2, f"({given})")
    difference, extent = np.abs(found[:, 1:] - plant).max(axis=1), np.ptp(plant, axis=1)
    assert found[0, 0] == start["position"] and found[1, 0] == start["velocity"]
    assert (difference < ROUNDED.get(base, 1e-4) * extent).all(), difference / extent
