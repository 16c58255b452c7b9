"""Curves over speed add up to nearly any other one: what they miss says that they only stand in for it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.diagnosis import Diagnosis, diagnose, write_diagnosis
from sgms_mhe.diagnosis.parametrisation import CandidateEffect, ModelStructure, extended_machine, nominal_values
from sgms_mhe.machine import Machine
from sgms_mhe.model import SIGNAL_NAMES
from sgms_mhe.model.building import plain_force
from sgms_mhe.model.effects import BASE_CAUSES, cause, own_effects
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import make_trajectory
from sgms_mhe.report import write_report

Array = NDArray[np.float64]

EVEN = ("asymmetric_viscous",)
"""Of another sign in the other direction: no part of a curve that is the same in both."""


@cache
def machine() -> Machine:
    return override_machine(load_machine("etel_xy"), {"sampling": {"rate": 1000.0, "velocity_cutoff": 100.0}})


@cache
def diagnosed(curve: str) -> Diagnosis:
    """A log of an axis with one more friction over speed than its file says."""
    forces: dict[str, Callable[[Array], Array]] = {
        "power": lambda v: 18.0 * np.sign(v) * np.abs(v) ** 0.5,
        "eddy currents": lambda v: 30.0 * v / (1.0 + (v / 0.15) ** 2),
    }
    axis = machine()
    path = make_trajectory("mixed", axis.sampling.rate, duration_s=10.0, max_velocity=0.4)
    run = simulate_axis(axis, path, AxisConfig(seed=2, force_noise_N=0.05))
    # The controller holds the reference against it: it shows in the force alone.
    log = replace(run.log, force_N=run.log.force_N + forces[curve](path.velocity_m_s))
    return diagnose(axis, log)


def test_a_curve_of_another_form_is_not_explained_by_its_imitations(tmp_path: Path) -> None:
    diagnosis = diagnosed("power")
    assert diagnosis.verdict == "unexplained"
    assert diagnosis.causes
    assert not any(diagnosis.identifies(c) for c in diagnosis.causes), diagnosis.summary
    names = {c.name for c in diagnosis.causes}
    assert any(all(name in limit for name in names) and "curve" in limit for limit in diagnosis.limits)
    assert "constant speeds" in str(diagnosis.separating_experiment)
    # They are none the less what predicts best: the extended machine has them.
    assert diagnosis.rms.held_out_after < 0.3 * diagnosis.rms.held_out_before
    assert diagnosis.extended is not None
    content = json.loads((write_diagnosis(diagnosis, tmp_path) / "diagnosis.json").read_text())
    assert not any(c["identified"] for c in content["causes"])
    page = write_report(diagnosis, tmp_path).read_text()
    assert "Friction over speed has a form that no known effect has" in page
    assert page.count('class="badge open"') == len(names)


def test_a_curve_of_the_catalogue_is_itself() -> None:
    diagnosis = diagnosed("eddy currents")
    assert diagnosis.verdict == "explained"
    assert [c.name for c in diagnosis.causes] == ["eddy_current_damping"]
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
        assert cause(name).over_speed == (over_speed(name) and name not in EVEN), name
    assert {c.name for c in BASE_CAUSES.values() if c.over_speed} == {"coulomb", "viscous", "stribeck"}
