"""Causes whose columns are collinear: neither is identified, and their combination is a number."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import pytest

from diagnosis_cases import explained
from record_cases import simulate_log
from sgms_mhe.diagnosis.combinations import KnownCombination, find_combinations
from sgms_mhe.diagnosis.fits import Fit, Subject, fit_model
from sgms_mhe.diagnosis.parametrisation import CandidateEffect
from sgms_mhe.diagnosis.uncertainty import covariance, standard_deviations
from sgms_mhe.machine import Machine
from sgms_mhe.recordings.evidence import noise_floor
from sgms_mhe.recordings.recording import prepare

RIPPLE = {"amplitude_N": 0.5, "pitch_m": 0.0173, "phase_rad": 0.7}
OFFSET = {"force_N": 0.4}


def fit_hidden(
    machine: Machine, hidden: Sequence[tuple[str, Mapping[str, float]]], tried: Mapping[str, Mapping[str, float]]
) -> tuple[Subject, Fit]:
    """Fit of effects to a simulated record with every number of the machine free."""
    subject = Subject.of(machine, prepare(machine, simulate_log(machine, *hidden, seconds=6.0, seed=4)))
    effects = [CandidateEffect(name, values) for name, values in tried.items()]
    fit = fit_model(subject, effects)
    return replace(subject, noise=noise_floor(subject.recording, fit.residual)), fit


def test_of_mass_and_gain_a_record_tells_one_number(machine: Machine) -> None:
    subject, fit = fit_hidden(
        machine, [("force_gain", {"gain": 1.1})], {"mass_mismatch": {"mass_kg": 1.0}, "force_gain": {"gain": 1.05}}
    )
    groups = [(group, group.cause) for group in fit.candidate_groups]
    (known,) = find_combinations(subject, fit, None, groups)
    assert known.causes == ("mass_mismatch", "force_gain")
    assert known.parameters == ("mass_kg", "gain")
    # The quotient to first order: a gain of 1 % more is what a mass of 1 % of all that moves more looks like.
    moved = machine.plant.moved
    assert known.weight == pytest.approx(moved / 1.1, rel=0.1)
    assert known.value == pytest.approx(known.weight * 1.1, abs=0.01 * moved)
    deviations = standard_deviations(covariance(subject, fit), fit)
    (mass,) = (s for c, s in zip(fit.model.columns, deviations, strict=True) if c.name == "mass_kg")
    assert known.std < 0.01 * mass


def test_causes_that_the_motion_separates_stand_alone(machine: Machine) -> None:
    subject, fit = fit_hidden(
        machine,
        [("force_ripple", RIPPLE), ("constant_offset", OFFSET)],
        {"force_ripple": RIPPLE, "constant_offset": OFFSET},
    )
    groups = [(group, group.cause) for group in fit.candidate_groups]
    assert find_combinations(subject, fit, None, groups) == ()
    # Nor does anything stand for two causes of which one is there and the other is not.
    assert find_combinations(subject, fit, None, groups[:1]) == ()


def test_a_combination_is_stated_in_place_of_its_causes(machine: Machine) -> None:
    one = explained(machine)
    (ripple,) = one.causes
    spring = replace(ripple, name="position_spring", label="position_spring", parameters={"stiffness_N_m": 3.0})
    known = KnownCombination(("force_ripple", "position_spring"), ("amplitude_N", "stiffness_N_m"), -0.25, 0.05, 0.01)
    found = replace(one, causes=(ripple, spring), combinations=(known,))
    assert one.identifies(ripple)
    assert not found.identifies(ripple)
    assert not found.identifies(spring)
    (sentence,) = (limit for limit in found.limits if "alone" in limit)
    assert "force_ripple.amplitude_N -0.25 position_spring.stiffness_N_m = 0.050 +- 0.020" in sentence
    content = json.loads(json.dumps(found.to_json()))
    entry = content["causes"][1]["known_combination"]
    assert entry["weights"] == [1.0, -0.25]
    assert (entry["value"], entry["std"]) == (0.05, 0.01)
    assert json.loads(json.dumps(one.to_json()))["causes"][0]["known_combination"] is None
    assert math.isclose(known.value, 0.8 - 0.25 * 3.0)
