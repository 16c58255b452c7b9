"""Curves over speed add up to nearly any other one: what they miss says that they only stand in for it."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from diagnosis_cases import assert_found
from record_cases import simulate_log, slow_axis
from sgms_mhe.configuration import override_machine
from sgms_mhe.diagnosis import Diagnosis, diagnose, write_diagnosis
from sgms_mhe.diagnosis.parametrisation import CandidateEffect, ModelStructure, extended_machine, nominal_values
from sgms_mhe.machine import Machine
from sgms_mhe.model import SIGNAL_NAMES
from sgms_mhe.model.building import plain_force
from sgms_mhe.model.effects import BASE_CAUSES, cause, effect_definition, own_effects
from sgms_mhe.plant.trajectories import make_trajectory
from sgms_mhe.report import write_report

Array = NDArray[np.float64]

EVEN = ("asymmetric_viscous",)
"""Of another sign in the other direction: no part of a curve that is the same in both."""


@cache
def machine() -> Machine:
    return slow_axis()


def diagnose_curve(curve: str) -> Diagnosis:
    """A log of an axis with one more friction over speed than its file says."""
    forces: dict[str, Callable[[Array], Array]] = {
        "power": lambda v: 18.0 * np.sign(v) * np.abs(v) ** 0.5,
        "eddy currents": lambda v: 30.0 * v / (1.0 + (v / 0.15) ** 2),
    }
    axis = machine()
    path = make_trajectory("mixed", axis.sampling.rate, duration_s=10.0, max_velocity=0.4)
    log = simulate_log(axis, path=path, seed=2, force_noise_N=0.05)
    # The controller holds the reference against it: it shows in the force alone.
    return diagnose(axis, replace(log, force_N=log.force_N + forces[curve](path.velocity_m_s)))


@pytest.mark.slow
def test_a_curve_of_another_form_is_named_and_not_its_imitations(tmp_path: Path) -> None:
    diagnosis = diagnose_curve("power")
    certain = [c for c in diagnosis.causes if diagnosis.identifies(c)]
    assert [c.name for c in certain] == ["friction_curve"], diagnosis.summary
    (curve,) = certain
    # Beside its numbers only one of the machine's may be listed, as what may stand for a rest of the curve.
    others = [c for c in diagnosis.causes if c is not curve]
    assert all(c.name in BASE_CAUSES and c.stands_for for c in others)
    listed = diagnosis.summary.split(" (")[0].split(":")[0].split(", and more")[0].split(". ")[-1]
    assert listed == "friction_curve", diagnosis.summary
    for c in others:
        assert any(c.name in limit and "curve" in limit for limit in diagnosis.limits)
    assert diagnosis.rms.held_out_after < 0.02 * diagnosis.rms.held_out_before
    assert diagnosis.extended is not None
    assert override_machine(diagnosis.extended, {"learned": False}).effects[-1].name == "friction_curve"
    # Level, damping and curve are together the law's, however they share it.
    friction, knots = diagnosis.extended.friction, sum(name.startswith("speed_") for name in curve.parameters)
    for i in range(knots - 1, knots + 1):  # the fastest two
        v = curve.parameters[f"speed_{i}_m_s"]
        for way in ("forward", "backward"):
            found = friction.coulomb + friction.viscous * v + curve.parameters[f"{way}_{i}_N"]
            assert found == pytest.approx(4.0 + 20.0 * v + 18.0 * math.sqrt(v), rel=0.03)
    content = json.loads((write_diagnosis(diagnosis, tmp_path) / "diagnosis.json").read_text())
    assert {c["name"] for c in content["causes"] if c["identified"]} == {"friction_curve"}
    page = write_report(diagnosis, tmp_path).read_text()
    assert page.count('class="badge open"') == len(others)


@pytest.mark.slow
def test_a_curve_of_the_catalogue_is_itself() -> None:
    diagnosis = diagnose_curve("eddy currents")
    assert_found(diagnosis, {"eddy_current_damping": {}}, "explained")
    assert all(diagnosis.identifies(c) for c in diagnosis.causes)


def over_speed(name: str) -> bool:
    """Whether an effect is a plain force that reads the velocity and nothing else."""
    axis = machine()
    extended = extended_machine(ModelStructure(axis, ((name, nominal_values(axis, CandidateEffect(name, {}))),)))
    plain = plain_force(extended, extended.effects[-1].label)
    if plain is None:
        return False
    read = [signal for i, signal in enumerate(SIGNAL_NAMES) if ca.depends_on(plain.force, plain.w[i])]
    return read == ["velocity"]


def test_effects_that_are_curves_over_speed_say_so() -> None:
    for name in own_effects(machine().plant.kind):
        if effect_definition(name).learned:  # a table over anything, and no cause
            continue
        assert cause(name).over_speed == (over_speed(name) and name not in EVEN), name
    assert {c.name for c in BASE_CAUSES.values() if c.over_speed} == {"coulomb", "viscous", "stribeck"}
