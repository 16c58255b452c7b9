"""Geared axes: torque transmitted, what tells their effects apart, and that a diagnosis finds them by name."""

from functools import cache
from pathlib import Path
from typing import Any, Literal

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from diagnosis_cases import Within, assert_found
from package_variants import GEARED
from record_cases import simulate_log
from sgms_bench.diagnosis.causes import Hidden, prescribed_signals
from sgms_bench.diagnosis.visibility import sensitivities, visible_share
from sgms_mhe.configuration import load_machine, make_machine, override_machine
from sgms_mhe.diagnosis import Diagnosis, diagnose
from sgms_mhe.diagnosis.plan import make_plan
from sgms_mhe.evaluation.comparison import compare_signals
from sgms_mhe.machine import Machine
from sgms_mhe.model import build_model
from sgms_mhe.model.effects import EFFECT_NAMES, effect_definition, effect_names
from sgms_mhe.plant.trajectories import Motion, Trajectory
from sgms_mhe.recordings.excitation import measure_excitation
from sgms_mhe.signals.chain import signals_from_log
from sgms_mhe.support.errors import InputError

Array = NDArray[np.float64]
Law = Literal["sgms", "maxwell_slip"]

RATE = 4000.0


@cache
def joint(law: Law = "sgms") -> Machine:
    """The joint of an arm behind a gear: friction and loads of several newton metres."""
    friction: dict[str, Any] = {
        "stiffness": [9e3, 3e3, 1.2e3],
        "fraction": [0.2, 0.3, 0.5],
        "viscous": 2.0,
        "coulomb": 6.0,
        "stribeck_ratio": 0.15,
        "stribeck_velocity": 0.02,
    }
    content = {
        "name": "joint",
        "plant": {"kind": "rotary", "inertia": 0.8},
        "friction": friction | ({"law": "switching"} if law == "maxwell_slip" else {}),
        "sampling": {"rate": RATE, "update_rate": 100.0, "velocity_cutoff": 100.0, "max_velocity": 6.0},
        "estimator": {"kind": "mhe", "horizon": 10, "parameters": ["stiffness"]},
    }
    return make_machine(content, Path("joint.toml"))


def with_effects(machine: Machine, *names: str, **changes: Any) -> Machine:
    return override_machine(machine, {"effects": [{"name": name, **GEARED[name]} for name in names], **changes})


# --- the model ----------------------------------------------------------------------------------------------------


def test_loads_are_what_acts_from_outside() -> None:
    loads = {name for name in EFFECT_NAMES if effect_definition(name).loads}
    assert loads == {
        "constant_offset", "mass_mismatch", "periodic_disturbance", "position_spring", "step_disturbance", "unbalance"
    }  # fmt: skip


def level_of(machine: Machine, w: list[float]) -> float:
    model = build_model(machine)
    return float(model.function("level")(np.zeros(model.n_x), w, np.ones(model.n_p)))


def output_of(machine: Machine, w: list[float]) -> float:
    model = build_model(machine)
    return float(model.function("output")(np.zeros(model.n_x), w, np.ones(model.n_p)))


def test_the_level_is_that_of_the_torque_known_from_motion_and_load() -> None:
    """|T| and the sign of T v, from q, v and a alone: the drive's own torque is not asked for."""
    machine = joint()
    position, coulomb = 0.4, 6.0
    for v, a in ((2.0, 30.0), (2.0, -30.0), (-2.0, 30.0), (0.5, 0.0), (0.01, 20.0)):
        share = float(np.exp(-((v / 0.02) ** 2)))
        stribeck, ratio = coulomb * (1.0 + 0.15 * share), 0.1 + 0.05 * share
        torque = 0.8 * a + 1.5 * float(np.sin(position + 0.7))
        eta = 0.8
        for names, added in (
            (("unbalance",), 0.0),
            (("load_dependent_friction",), ratio * abs(0.8 * a)),
            (("load_dependent_friction", "unbalance"), ratio * abs(torque)),
            (("unbalance", "drive_efficiency"), abs((torque / eta if torque * v > 0.0 else torque * eta) - torque)),
        ):
            for force in (-50.0, 70.0):
                found = level_of(with_effects(machine, *names), [position, v, a, force, 1.0])
                assert coulomb * found == pytest.approx(stribeck + added, rel=1e-12)


CURVE: dict[str, Any] = {
    "name": "friction_curve", "speed_rad_s": [0.2, 1.0], "end_rad_s": 6.0, "forward_Nm": [-2.0, -1.5],
    "backward_Nm": [-1.0, 0.5],
}  # fmt: skip


@pytest.mark.parametrize("curves", [(), (CURVE,)], ids=["law", "curve"])
@pytest.mark.parametrize("shares", [(0.0, 0.0), (0.5, 0.5), (1.0, 1.0), (0.3, 0.8)])
def test_a_mesh_amid_the_friction_carries_friction_that_it_makes_itself(
    shares: tuple[float, float], curves: tuple[dict[str, Any], ...]
) -> None:
    """The level solves level = s(v) + r |load + a_J J a + a_f f|, f of the size level + sigma_v |v| + curve."""
    inertial, frictional = shares
    effect = {"name": "load_dependent_friction", "ratio": 0.3, "rise_ratio": 0.1}
    effect |= {"inertia_ratio": inertial, "friction_ratio": frictional}
    bare, bent = joint(), override_machine(joint(), {"effects": list(curves)})
    machine = override_machine(joint(), {"effects": [{"name": "unbalance", **GEARED["unbalance"]}, effect, *curves]})
    for v, a, q in ((2.0, 30.0, 0.4), (2.0, -30.0, 0.4), (-2.0, 30.0, 1.0), (0.5, 0.0, -2.0), (0.01, -20.0, 0.0)):
        w, share = [q, v, a, 3.0, 1.0], float(np.exp(-((v / 0.02) ** 2)))
        curve = output_of(bent, w) - output_of(bare, w)
        level = 6.0 * level_of(machine, w)
        friction = np.sign(v) * level + 2.0 * v + curve
        torque = 1.5 * float(np.sin(q + 0.7)) + inertial * 0.8 * a + frictional * friction
        assert level == pytest.approx(6.0 * (1.0 + 0.15 * share) + (0.3 + 0.1 * share) * abs(torque), rel=1e-9)
    assert not curves or abs(curve) > 1e-3


def test_friction_that_grows_with_itself_stays_finite() -> None:
    effect = {"name": "load_dependent_friction", "ratio": 0.9, "rise_ratio": 0.1, "friction_ratio": 1.0}
    level = level_of(override_machine(joint(), {"effects": [effect]}), [0.0, 1e-9, 1e-9, 0.0, 0.0])
    assert 6.0 * level == pytest.approx(6.0 * 1.15 * (1.0 + 1.0 / 0.05), rel=1e-6)


def test_friction_that_a_load_raises_is_fed_forward_as_it_is() -> None:
    """Elements whose level hangs on acceleration are no states that answer the drive."""
    model = build_model(with_effects(joint(), *GEARED))
    chi, w = np.linspace(-0.5, 0.5, model.n_x), [0.3, 1.0, 5.0, 9.0, 2.0]
    both = ca.Function("both", [model.chi, model.w, model.theta], [model.output, model.feed_forward])
    output, ahead = both(chi, w, np.ones(model.n_p))
    assert float(ahead) == pytest.approx(float(output), rel=1e-12)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"friction": {"law": "switching"}},
        {"friction": {"law": "switching"}, "sampling": {"integrator": {"substeps": 20}}},
        {"sampling": {"integrator": {"scheme": "flow", "substeps": 20}}, "estimator": {"relinearise": "auto"}},
        {"estimator": {"kind": "ekf"}},
        {
            "effects": [
                {"name": "unbalance", **GEARED["unbalance"]},
                {"name": "load_dependent_friction", "ratio": 0.2, "inertia_ratio": 0.4, "friction_ratio": 0.7},
            ]
        },
    ],
    ids=["flow", "switching", "switching, merged", "flow, merged, auto", "ekf", "mesh amid friction"],
)
def test_c_is_the_reference(changes: dict[str, Any]) -> None:
    parameters = ["stiffness", "unbalance.amplitude_Nm", "load_dependent_friction.ratio"]
    estimator = {"parameters": parameters, "bounds": {}, "horizon": 4, **changes.get("estimator", {})}
    machine = with_effects(load_machine("etel_xy_rotary"), *GEARED, **{**changes, "estimator": estimator})
    log = simulate_log(machine, seconds=0.8, scale={"stiffness": 1.2}, seed=3)
    comparison = compare_signals(machine, signals_from_log(log, machine))
    assert comparison.agrees, comparison
    assert "unbalance.amplitude_Nm" in {quantity.name for quantity in comparison.quantities}


def test_a_plan_separates_what_the_axis_may_have() -> None:
    assert "gravity" in make_plan(joint(), ("unbalance", "force_ripple")).reason
    with pytest.raises(InputError, match=r"separate = 'unbalance'.*as a linear axis has"):
        make_plan(load_machine("etel_xy"), ("unbalance", "force_ripple"))


# --- what tells them apart ----------------------------------------------------------------------------------------


def moves(*parts: tuple[float, float, float]) -> Trajectory:
    """Forth and back about angle 0.3, each part by (reach, speed, acceleration)."""
    motion = Motion(RATE, 0.3)
    motion.wait(0.1)
    for reach, speed, acceleration in parts:
        for end in (0.3 + reach, 0.3 - reach, 0.3):
            motion.move_to(end, speed, acceleration, 40.0 * acceleration)
    return motion.trajectory("moves")


SMALL = ((0.05, 0.2, 1.0), (0.05, 0.4, 1.0))
GENTLE = ((0.8, 0.5, 2.0), (0.8, 1.0, 2.0))
WIDE = ((1.6, 1.0, 2.0), (1.6, 2.0, 2.0))
HARD = ((0.8, 3.0, 90.0), (0.4, 3.0, 60.0), (0.8, 0.5, 20.0))
HELD = {"name": "constant_offset", "torque_Nm": 30.0}  # a weight on a rope
SIZES: dict[str, dict[str, float]] = {
    "unbalance": {"amplitude_N": 4.0, "phase_rad": 0.6},
    "load_dependent_friction": {"ratio": 0.2, "rise_ratio": 0.0},
    "drive_efficiency": {"efficiency_ratio": 0.7},
    "constant_offset": {"force_N": 1.0},
    "position_spring": {"stiffness_N_m": 1.0, "centre_m": 0.0},
    "mass_mismatch": {"mass_kg": 0.1},
    "force_gain": {"gain": 1.05},
}


def left(machine: Machine, motion: Trajectory, name: str, *rivals: str) -> float:
    """Share of an effect's force that neither the base model's numbers nor rivals take over."""

    def force(effect: str) -> Array:
        return prescribed_signals(machine, motion, Hidden(effect, SIZES[effect])).friction - plain.friction

    plain = prescribed_signals(machine, motion, Hidden(""))
    others = np.stack([force(rival) for rival in rivals], axis=1) if rivals else None
    return visible_share(machine, sensitivities(machine, plain), force(name), others)


@pytest.mark.parametrize(
    ("name", "rivals", "held", "without", "with_move", "least"),
    [
        ("unbalance", ("constant_offset",), False, SMALL, WIDE, 0.5),
        ("unbalance", ("constant_offset", "position_spring"), False, SMALL, WIDE, 0.3),
        ("load_dependent_friction", (), True, GENTLE, HARD, 0.2),  # what takes it over is the Coulomb level
        ("load_dependent_friction", ("mass_mismatch",), True, GENTLE, HARD, 0.2),
        ("load_dependent_friction", ("force_gain",), True, GENTLE, HARD, 0.2),
        ("drive_efficiency", ("force_gain",), True, GENTLE, HARD, 0.2),
    ],
)
def test_a_move_tells_rivals_apart(
    name: str, rivals: tuple[str, ...], held: bool, without: Any, with_move: Any, least: float
) -> None:
    machine = override_machine(joint(), {"effects": [HELD]}) if held else joint()
    assert left(machine, moves(*without), name, *rivals) < 0.1
    assert left(machine, moves(*with_move), name, *rivals) > least


def test_a_weight_let_down_tells_a_drive_from_a_friction() -> None:
    """Where the drive drives all the time a loss is a friction that the load raises; where the load drives, less."""
    machine, motion = override_machine(joint(), {"effects": [HELD]}), Motion(RATE, 0.3)
    motion.wait(0.1)
    for reach, speed, acceleration in GENTLE:
        motion.move_by(reach, speed, acceleration, 40.0 * acceleration)
    lifted = motion.trajectory("lifted")
    assert left(machine, lifted, "drive_efficiency", "load_dependent_friction") < 0.05
    assert left(machine, moves(*GENTLE), "drive_efficiency", "load_dependent_friction") > 0.15


def test_excitation_asks_for_loads_and_angles() -> None:
    machine = joint()
    names = ("unbalance", "load_dependent_friction", "drive_efficiency")

    def excited(*parts: tuple[float, float, float]) -> list[str]:
        found = measure_excitation(prescribed_signals(machine, moves(*parts), Hidden("")), machine)
        return [name for name in names if not effect_definition(name).excitation.unmet(found, {})]

    assert excited(*SMALL) == []
    assert excited(*WIDE) == ["unbalance"]
    assert excited(*HARD) == list(names)


# --- diagnoses ----------------------------------------------------------------------------------------------------


def exercise() -> Trajectory:
    """Fast, slow and hard moves over two thirds of a turn, loops below break-away, swings."""
    motion = Motion(RATE)
    motion.wait(0.2)
    for reach, speed, acceleration in ((2.4, 4.0, 60.0), (0.6, 0.4, 30.0), (1.2, 1.5, 90.0)):
        for end in (reach, -0.8 * reach, 0.3):
            motion.move_to(end, speed, acceleration, 15.0 * acceleration)
            motion.wait(0.05)
        motion.loops((0.01, 0.004), 0.2, 4.0, 160.0)
    motion.swing(0.25, 3.0, 3)
    motion.move_to(0.0, 2.0, 20.0, 300.0)
    motion.wait(0.2)
    return motion.trajectory("exercise")


def diagnosed(machine: Machine, law: Law, motion: Trajectory, name: str, hidden: dict[str, float]) -> Diagnosis:
    config: dict[str, Any] = {"law": law, "seed": 3, "force_noise_N": 0.05, "encoder_resolution_m": 1e-6}
    return diagnose(machine, simulate_log(machine, (name, hidden), path=motion, bandwidth_Hz=15.0, **config))


HIDDEN: dict[str, dict[str, float]] = {
    "unbalance": {"amplitude_N": 5.0, "phase_rad": 0.6},
    "load_dependent_friction": {"ratio": 0.12, "rise_ratio": 0.0},
    "drive_efficiency": {"efficiency_ratio": 0.75},
}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "law"), list(zip(HIDDEN, ("sgms", "maxwell_slip", "maxwell_slip"), strict=True)))
def test_a_diagnosis_finds_it_and_its_size(name: str, law: Law) -> None:
    """On the smooth law and on the one that switches, model and plant alike."""
    diagnosis = diagnosed(joint(law), law, exercise(), name, HIDDEN[name])
    known = {key: value for key, value in HIDDEN[name].items() if key != "rise_ratio"}  # which no fit frees
    assert_found(diagnosis, {name: {key: Within(value) for key, value in known.items()}})
    assert all(diagnosis.causes[0].std[key] < 0.02 * value for key, value in known.items())
    assert diagnosis.rms.held_out_after < 0.03 * diagnosis.rms.held_out_before
    entry = next(entry for entry in (diagnosis.extended or joint()).as_dict()["effects"] if entry["name"] == name)
    optional = {parameter.name for parameter in effect_definition(name).parameters if parameter.is_optional}
    assert set(entry) == {"name", *GEARED[name], *optional}


@pytest.mark.slow
def test_a_small_loss_is_no_certain_friction() -> None:
    """What a drive loses of 0.5 % differs by who drives in the second order only: far below the noise."""
    motion, loss = exercise(), {"efficiency_ratio": 0.995}
    diagnosis = diagnosed(joint("sgms"), "sgms", motion, "drive_efficiency", loss)
    assert diagnosis.verdict == "ambiguous", diagnosis.summary
    alike = {cause.name for cause in diagnosis.causes} | {a.name for a in diagnosis.alternatives if a.rival}
    assert alike == {"drive_efficiency", "load_dependent_friction"}


def test_only_axes_that_turn_have_them() -> None:
    assert set(effect_names("rotary")) - set(effect_names("linear")) == set(GEARED) == set(HIDDEN)
