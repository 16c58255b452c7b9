"""Effects that are plain forces: beside a compiled model they give what it gives with them compiled in."""

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from record_cases import simulate_log
from sgms_mhe.configuration import load_machine
from sgms_mhe.diagnosis import models
from sgms_mhe.diagnosis.alignment import decimate
from sgms_mhe.diagnosis.fits import Subject
from sgms_mhe.diagnosis.models import CompiledFit, compile_once, make_model
from sgms_mhe.diagnosis.parametrisation import CandidateEffect
from sgms_mhe.host.evaluation import Evaluation
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import EFFECT_NAMES, cause_names, effect_definition
from sgms_mhe.recordings.recording import Recording, prepare

Array = NDArray[np.float64]

PLAIN = (
    "asymmetric_viscous",
    "constant_offset",
    "eddy_current_damping",
    "force_ripple",
    "friction_curve",
    "mass_mismatch",
    "periodic_disturbance",
    "position_map",
    "position_spring",
    "quadratic_drag",
    "step_disturbance",
    "unbalance",
)
"""Effects that are a force of the signals alone, written down once more."""


@pytest.fixture(scope="module", params=["etel_xy", "etel_xy_rotary"])
def machine(request: pytest.FixtureRequest) -> Machine:
    return load_machine(request.param)


@pytest.fixture(scope="module")
def recordings(machine: Machine) -> tuple[Recording, Recording]:
    """At the full rate, and thinned."""
    whole = prepare(machine, simulate_log(machine, seconds=1.5, seed=3))
    return whole, decimate(Subject.of(machine, whole)).recording


def extras_of(*names: str) -> list[CandidateEffect]:
    return [CandidateEffect(name, {}) for name in names]


def together(machine: Machine, extras: list[CandidateEffect], monkeypatch: pytest.MonkeyPatch) -> CompiledFit:
    """The model with every effect compiled in."""
    with monkeypatch.context() as patch:
        patch.setattr(models, "find_plain_forces", lambda *_: ())
        return make_model(machine, extras)


def assert_same(apart: CompiledFit, whole: CompiledFit, recording: Recording) -> None:
    """The same columns, friction and derivatives at random numbers, to rounding."""
    rng = np.random.default_rng(11)
    places = [apart.columns.index(column) for column in whole.columns]
    assert sorted(places) == list(range(len(apart.columns)))
    theta = 1.0 + 0.1 * rng.standard_normal(len(places))
    for i, column in enumerate(whole.columns):
        if column.name == "delay_s":
            theta[i] = column.theta(3.3e-4)
    shuffled = np.empty(len(theta))
    shuffled[places] = theta
    friction, slopes = apart.run(recording, shuffled)
    expected, expected_slopes = whole.run(recording, theta)
    assert slopes is not None and expected_slopes is not None
    np.testing.assert_allclose(friction, expected, rtol=0.0, atol=1e-12 * np.max(np.abs(expected)))
    asked = [not column.frozen for column in whole.columns]
    size = np.max(np.abs(expected_slopes), axis=0)
    assert np.all((np.max(np.abs(slopes[:, places] - expected_slopes), axis=0) <= 1e-12 * size)[asked])
    np.testing.assert_array_equal(apart.run(recording, shuffled, derivatives=False)[0], friction)


@pytest.mark.slow
def test_which_effects_are_plain_forces(machine: Machine) -> None:
    kind = machine.plant.kind
    names = [name for name in cause_names(kind) if name in EFFECT_NAMES]
    found = {name for name in names if make_model(machine, extras_of(name)).forces}
    assert found == {name for name in PLAIN if name in names}


@pytest.mark.slow
def test_force_beside_a_model_is_the_model_with_it(
    machine: Machine, recordings: tuple[Recording, Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    names = [name for name in PLAIN if machine.plant.kind in effect_definition(name).kinds]
    for recording in recordings:
        for name in names:
            extras = extras_of(name, "asymmetric_coulomb")
            apart = make_model(recording.machine, extras)
            assert len(apart.forces) == 1, name
            assert_same(apart, together(recording.machine, extras, monkeypatch), recording)


@pytest.mark.parametrize(
    "names",
    [
        ("force_ripple", "constant_offset", "position_spring"),
        ("force_delay", "force_ripple"),
        ("force_ripple", "frictional_lag", "force_delay", "quadratic_drag"),
    ],
)
def test_several_forces_and_a_delay_of_all_of_them(
    names: tuple[str, ...], machine: Machine, recordings: tuple[Recording, Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    recording, extras = recordings[0], extras_of(*names)
    apart = make_model(machine, extras)
    assert len(apart.forces) == sum(name in PLAIN for name in names)
    assert_same(apart, together(machine, extras, monkeypatch), recording)


def test_pieces_of_a_record_are_put_together(
    machine: Machine, recordings: tuple[Recording, Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    for recording in recordings:
        model = make_model(recording.machine, extras_of("force_ripple", "position_spring"))
        theta = np.full(len(model.columns), 1.1)
        whole = model.run(recording, theta)
        with monkeypatch.context() as patch:
            patch.setattr(models, "CHUNK", 700)
            patch.setattr("sgms_mhe.diagnosis.parametrisation.AT_A_TIME", 130)
            pieces = model.run(recording, theta)
        for found, expected in zip(pieces, whole, strict=True):
            assert found is not None and expected is not None
            np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("other", ["force_gain", "force_constant_ripple", "encoder_periodic_error", "actuator_lag"])
def test_what_changes_signals_or_forces_is_compiled_with_them(other: str, machine: Machine) -> None:
    assert make_model(machine, extras_of("force_ripple", other)).forces == ()
    assert len(make_model(machine, extras_of("force_ripple", "viscous_drift")).forces) == 1


def test_load_that_a_level_hangs_on_is_compiled() -> None:
    """A torque that friction grows with is no force beside it, one that does not act on the load is."""
    geared = load_machine("etel_xy_rotary")
    for level in ("load_dependent_friction", "drive_efficiency"):
        assert make_model(geared, extras_of("position_spring", level)).forces == ()
        assert len(make_model(geared, extras_of("eddy_current_damping", level)).forces) == 1
    assert len(make_model(geared, extras_of("position_spring", "asymmetric_coulomb")).forces) == 1


def test_one_compiled_model_serves_all_forces(machine: Machine) -> None:
    make_model(machine, ())
    before = compile_once.cache_info().misses
    for names in (("force_ripple",), ("constant_offset", "force_ripple"), ("position_map", "quadratic_drag")):
        make_model(machine, extras_of(*names))
    assert compile_once.cache_info().misses == before


def test_expressions_are_evaluated_as_casadi_does() -> None:
    w, p = ca.SX.sym("w", 2), ca.SX.sym("p", 2)
    a, b = w[0], w[1]
    outputs = ca.vertcat(
        a + b * p[0] - a / (2.0 + b * b),
        ca.fmax(a, b) * ca.fmin(a, p[1]) + (a < b) + (a <= p[0]) - ca.logic_not(a < b),
        -ca.exp(-a) + ca.log(1.0 + b * b) + ca.sqrt(ca.fabs(a)),
        ca.sin(a) * ca.cos(b) * ca.tanh(a * p[1]) + ca.sign(a) + ca.floor(3.0 * b),
        2.0 * (a + a) + 1.0 / (3.0 + b) + (ca.floor(a) == 1.0) - 2.5 * (ca.floor(a) == -1.0),
        ca.SX(7.0),
    )
    rng = np.random.default_rng(2)
    values, numbers = np.vstack([rng.uniform(-2.5, 2.5, (500, 2)), [[0.0, 0.0], [1.0, 1.0]]]), np.array([0.7, -1.3])
    found = Evaluation(outputs, {"w": w, "p": p}, {"w": ("a", "b"), "p": ("p0", "p1")}).at(
        {"a": values[:, 0], "b": values[:, 1], "p0": 0.7, "p1": -1.3}
    )
    expected = np.array(
        ca.Function("f", [w, p], [outputs]).map(len(values))(values.T, np.tile(numbers, (len(values), 1)).T)
    )
    for row, one in zip(found, expected, strict=True):
        np.testing.assert_allclose(np.broadcast_to(row, len(values)), one, rtol=1e-13, atol=1e-13)
