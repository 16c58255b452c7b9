"""Exports of an axis, read and moved by the tools that they are for."""

from __future__ import annotations

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
from sgms_mhe.configuration import load_machine
from sgms_mhe.model.simple import SimpleAxis, simple_friction

mujoco = pytest.importorskip("mujoco")
rumoca = pytest.importorskip("rumoca")
MASSLESS = 'mass="1e-9" diaginertia="1e-12 1e-12 1e-12"'


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
    assert model.nv == 1 and whole[0, 0] == pytest.approx(machine.plant.moved, rel=1e-12)
    assert (model.dof_damping[0], model.dof_frictionloss[0]) == (machine.friction.viscous, machine.friction.coulomb)
    turns = machine.plant.kind == "rotary"
    assert model.jnt_type[0] == (mujoco.mjtJoint.mjJNT_HINGE if turns else mujoco.mjtJoint.mjJNT_SLIDE)


@pytest.mark.parametrize("base", BASES)
def test_the_error_is_of_the_friction_that_mujoco_computes(base: str, tmp_path: Path) -> None:
    model, machine = loaded("mujoco", base, tmp_path), load_machine(base)
    data = mujoco.MjData(model)
    axis = SimpleAxis(machine.plant.moved, machine.friction.coulomb, machine.friction.viscous)
    rng = np.random.default_rng(5)
    velocity, force = rng.choice([-1.0, 1.0], 200) * 10.0 ** rng.uniform(-6, -1, 200), rng.uniform(-8.0, 8.0, 200)
    found = []
    for v, u in zip(velocity, force, strict=True):
        data.qvel[0], data.ctrl[0] = v, u
        mujoco.mj_forward(model, data)
        found.append(-data.qfrc_constraint[0] - data.qfrc_passive[0])
    wanted = simple_friction("mujoco", axis, velocity, force)
    np.testing.assert_allclose(wanted, found, rtol=1e-9, atol=1e-9)
    level = np.abs(wanted - axis.viscous * velocity)
    assert 20 < np.sum(level < 0.999 * axis.coulomb) < 180


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
        data.qpos[0] = q
        mujoco.mj_forward(model, data)
        spring = 5.0 * (q - 0.3) + 0.5 if form == "mujoco" else 0.0
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


def test_armature_alone_leaves_mujoco_no_friction_below_the_level() -> None:
    """Why the body carries the inertia."""
    forces, text = [], sgms_mhe.export("etel_xy", "mujoco").text
    apart = text.replace('armature="0"', 'armature="20"').replace('mass="20.0" diaginertia="1 1 1"', MASSLESS)
    for content in (text, apart):
        model = mujoco.MjModel.from_xml_string(content)
        data = mujoco.MjData(model)
        data.ctrl[0] = 2.0
        mujoco.mj_forward(model, data)
        forces.append(-data.qfrc_constraint[0])
    assert forces[0] == pytest.approx(1.8) and forces[1] < 1e-6


def test_mujoco_slides_as_the_model_and_creeps_where_it_sticks(tmp_path: Path) -> None:
    """Motion as the file says: the sliding speed is right, and a force below the level moves the axis slowly."""
    model, machine = loaded("mujoco", "etel_xy", tmp_path), load_machine("etel_xy")
    data = mujoco.MjData(model)
    data.ctrl[0] = 10.0
    while data.time < 8.0:
        mujoco.mj_step(model, data)
    assert data.qvel[0] == pytest.approx((10.0 - machine.friction.coulomb) / machine.friction.viscous, rel=1e-3)
    mujoco.mj_resetData(model, data)
    data.ctrl[0] = 2.0
    while data.time < 2.0:
        mujoco.mj_step(model, data)
    assert 1e-6 < data.qvel[0] < 1e-3


# --- equations ---------------------------------------------------------------------------------------------------


def simulated(text: str, name: str, push: str, duration: float) -> Any:
    """Position and velocity each millisecond of an exported model that a sine drives, by an independent compiler."""
    source = (
        f"{text}\nmodel Driven\n  {name} axis;\nequation\n"
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
    found = simulated(exported.text, "Axis", machine.plant.units.push, 1.0)[:, 1:]
    difference, extent = np.abs(found - plant).max(axis=1), np.ptp(plant, axis=1)
    assert (difference < ROUNDED.get(case, 6e-5) * extent).all(), difference / extent
    assert extent[0] > 1e-3
