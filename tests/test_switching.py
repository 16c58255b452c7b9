"""Elements that switch: the clip, its derivatives, merged samples, the emitted C, what does not go with it."""

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from c_packages import elements, machine
from diagnosis_cases import assert_found
from package_variants import EFFECTS
from record_cases import simulate_log
from reference_cases import arrays, estimate_once, moving, variant
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.diagnosis import diagnose
from sgms_mhe.diagnosis.parametrisation import SHARP_SMOOTHING
from sgms_mhe.emission.package import emit_package
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.machine import Machine, merge_tables
from sgms_mhe.model import build_model
from sgms_mhe.model.axis import StateSpec, SymbolicAxis
from sgms_mhe.model.friction import Elements
from sgms_mhe.model.switching import check_switching
from sgms_mhe.reference import ReferenceIntegrator
from sgms_mhe.signals.chain import chain_delay, signals_from_log
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import InputError

Array = NDArray[np.float64]
LAW: dict[str, Any] = {"friction": {"law": "switching"}}
KAPPA = np.array([120e3, 25e3, 7.1e3, 7.9e3])
NU = np.array([0.067, 0.056, 0.047, 0.83])
LEVEL, BETA, STRIBECK, RATE = 4.0, 0.12, 1e-3, 1e4
RHO = KAPPA / (NU * LEVEL)
ALL = ["stiffness", "fraction", "coulomb", "viscous", "stribeck_ratio", "stribeck_velocity"]
THETA = np.array([1.05, 1.1, 0.9, 1.02, 1.04, 0.95, 1.1, 0.98, 1.1, 0.97, 1.01])


def switching(**changes: Any) -> Machine:
    """etel_xy under the switching law, with changes."""
    return machine(**merge_tables(LAW, changes))


def five(**changes: Any) -> dict[str, Any]:
    """Five samples a step, with other changes."""
    return merge_tables({"sampling": {"integrator": {"substeps": 20}}}, changes)


def entries(*names: str) -> dict[str, Any]:
    return {"effects": [{"name": name, **EFFECTS[name]} for name in names]}


# --- the law -----------------------------------------------------------------------------------------------------


def clipped(chi: Array, distance: float, level: float) -> Array:
    """Elements moved by `distance` [m]: in its direction none gets beyond its level, against it all stick."""
    moved = chi + RHO * distance
    if distance > 0.0:
        return np.minimum(moved, level)
    return np.maximum(moved, -level) if distance < 0.0 else moved


def level_at(v: float) -> float:
    return 1.0 + BETA * float(np.exp(-((v / STRIBECK) ** 2)))


def strokes(samples: int, peak: float, seed: int = 0) -> Array:
    """Velocity [m/s] that turns round many times, between creep and `peak`, with samples that stand."""
    rng = np.random.default_rng(seed)
    t = np.arange(samples + 1) / samples
    v = peak * np.sin(2.0 * np.pi * (0.1 + 5.0 * t + 3.0 * t * t)) * t**2 + 2e-4 * np.sin(90.0 * t)
    v[rng.integers(0, samples, 9)] = 0.0
    return v


@pytest.mark.parametrize("peak", [2e-3, 0.05, 1.0])
def test_an_interval_is_a_clip_per_sample(peak: float) -> None:
    integrator = ReferenceIntegrator(build_model(switching()))
    v = strokes(1000, peak)
    plan, chi = integrator.plan(moving(v)), np.array([0.3, -0.2, 1.3, -1.3])
    for k in range(10):
        found = integrator.intervals(plan, k, chi[None], np.ones(4)).x1[0]
        for speed in v[100 * k + 1 : 100 * k + 101].tolist():
            chi = clipped(chi, speed / RATE, level_at(speed))
        np.testing.assert_allclose(found, chi, rtol=0.0, atol=1e-13)


@pytest.mark.parametrize("substeps", [100, 20, 1])
@pytest.mark.parametrize("speed", [1e-5, 1e-3, 0.02, 1.0])
def test_many_clips_are_one(speed: float, substeps: int) -> None:
    """Whatever the displacement, in one direction at one level: the closed form, and with it the derivatives."""
    settings = switching(friction={"stribeck_ratio": 0.0}, sampling={"integrator": {"substeps": substeps}})
    integrator = ReferenceIntegrator(build_model(settings))
    x = np.random.default_rng(3).uniform(-1.0, 0.95, (1, 4))
    for direction in (1.0, -1.0):
        plan = integrator.plan(moving(np.full(101, direction * speed)))
        found, distance = integrator.intervals(plan, 0, x, np.ones(4)), direction * speed * 0.01
        moved = x[0] + RHO * distance
        slips = direction * moved > 1.0
        np.testing.assert_allclose(found.x1[0], np.where(slips, direction, moved), rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(found.A[0], np.diag(~slips), rtol=0.0, atol=0.0)
        np.testing.assert_allclose(found.B[0], np.diag(np.where(slips, 0.0, RHO * distance)), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("state_as", ["force", "deflection"])
@pytest.mark.parametrize("changes", [{}, five(), entries("dwell_dependence")], ids=["samples", "merged", "upstream"])
def test_derivatives_are_differences_where_nothing_switches(changes: dict[str, Any], state_as: str) -> None:
    settings = switching(**merge_tables(changes, {"estimator": {"parameters": ALL, "noise": {"state_as": state_as}}}))
    integrator = ReferenceIntegrator(build_model(settings))
    n_x = integrator.model.n_x
    x = np.random.default_rng(5).uniform(-0.9, 0.9, (8, n_x)) * np.where(np.arange(n_x) < 4, 1.0, 0.3)
    plan = integrator.plan(moving(strokes(800, 4e-3)))
    exact = integrator.intervals(plan, 0, x, THETA)
    compared, e = [], 1e-7
    for j in range(n_x + len(THETA)):
        d = e * np.eye(n_x + len(THETA))[j]
        up, down = (integrator.intervals(plan, 0, x + s * d[:n_x], THETA + s * d[n_x:]).x1 for s in (1.0, -1.0))
        right, left = (up - exact.x1) / e, (exact.x1 - down) / e
        same = np.abs(right - left) < 1e-5  # no element goes over from sticking to slipping in between
        found = exact.A[:, :, j] if j < n_x else exact.B[:, :, j - n_x]
        np.testing.assert_allclose(found[same], 0.5 * (right + left)[same], rtol=0.0, atol=2e-6)
        compared.append(same)
    assert np.mean(compared) > 0.98
    assert np.any(exact.A[:, 0, 0] == 0.0) and np.any(np.diagonal(exact.A, axis1=1, axis2=2)[:, :4] == 1.0)


@pytest.mark.parametrize(
    "changes",
    [
        {"estimator": {"parameters": ALL}},
        five(estimator={"parameters": ALL}),
        five(**entries("dwell_dependence", "encoder_periodic_error", "hose_hysteresis")),
        entries("frictional_lag", "asymmetric_coulomb"),
    ],
    ids=["samples", "merged", "samples of merged ones", "states"],
)
def test_python_and_compiled_loops_agree(changes: dict[str, Any]) -> None:
    model = build_model(switching(**changes))
    compiled, plain = ReferenceIntegrator(model), ReferenceIntegrator(model, compiled=False)
    x = np.random.default_rng(2).uniform(-0.9, 0.9, (3, model.n_x))
    plan = compiled.plan(moving(strokes(300, 6e-3)))
    theta = np.linspace(0.9, 1.1, model.n_p)
    for a, b in zip(
        arrays(compiled.intervals(plan, 0, x, theta)), arrays(plain.intervals(plan, 0, x, theta)), strict=True
    ):
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(("beta", "tolerance"), [(0.0, 1e-5), (BETA, 4e-3)])
def test_a_step_of_merged_samples_follows_its_line(beta: float, tolerance: float) -> None:
    """Against the line in a thousand clips: displacement and reversals are exact, the level is that of the ends."""
    settings = switching(friction={"stribeck_ratio": beta}, **five())
    integrator = ReferenceIntegrator(build_model(settings))
    v = 3e-3 * np.sin(2.0 * np.pi * np.cumsum(np.linspace(5.0, 50.0, 2001)) / RATE)  # up to 1 m/s^2
    plan, turned = integrator.plan(moving(v)), 0
    mean = v[1:].reshape(-1, 5).mean(axis=1)
    tau = np.linspace(-0.8, 0.8, 5)
    change = (v[1:].reshape(-1, 5) @ tau) / (tau @ tau)
    inside = (np.arange(1000) + 0.5) / 500.0 - 1.0
    for k in range(20):
        chi = np.array([0.3, -0.2, 0.9, -0.6])
        found = integrator.intervals(plan, k, chi[None], np.ones(4)).x1[0]
        for m, c in zip(mean[20 * k : 20 * k + 20], change[20 * k : 20 * k + 20], strict=True):
            turned += abs(c) > abs(m)
            for speed in m + c * inside:
                chi = clipped(chi, float(speed) * 5e-4 / 1000, 1.0 + beta * float(np.exp(-((speed / STRIBECK) ** 2))))
        np.testing.assert_allclose(found, chi, rtol=0.0, atol=tolerance)
    assert turned > 8


# --- the emitted C -----------------------------------------------------------------------------------------------

STANDING = [name for name in EFFECTS if name not in ("backlash", "micro_viscous")]
CASES: dict[str, dict[str, Any]] = {
    "all": {},
    "auto": {"estimator": {"relinearise": "auto"}},
    "newest": {"estimator": {"relinearise": "newest"}},
    "ekf": {"estimator": {"kind": "ekf"}},
    "one element": {"friction": elements(1)},
    "ten elements, auto": {"friction": elements(10), "estimator": {"relinearise": "auto"}},
    "every parameter": {"estimator": {"parameters": ALL, "bounds": {}}},
    "viscous alone": {"estimator": {"parameters": ["viscous"], "bounds": {}}},
    "bound, auto": {"estimator": {"bounds": {"stiffness": [0.99, 1.1]}, "relinearise": "auto"}},
    "paper's weights": {"estimator": {"arrival_cost": {"update": "fixed"}, "noise": {"state_as": "deflection"}}},
    "merged": five(),
    "merged, auto": five(estimator={"relinearise": "auto"}),
    "merged, ekf": five(estimator={"kind": "ekf", "parameters": ALL, "bounds": {}}),
    "level in a parameter, merged": five(
        **entries("asymmetric_coulomb"),
        estimator={"parameters": ["stiffness", "asymmetric_coulomb.ratio"], "bounds": {}},
    ),
    "level of its own": entries("dwell_dependence"),
    "level of its own, estimated, auto": {
        **entries("dwell_dependence", "frictional_lag"),
        "estimator": {"parameters": ["stiffness", "dwell_dependence.ratio"], "bounds": {}, "relinearise": "auto"},
    },
    "level of its own, merged": five(**entries("frictional_lag")),
    "every effect": {**entries(*STANDING), "estimator": {"horizon": 3}},
    "every effect, merged, auto": five(**entries(*STANDING), estimator={"relinearise": "auto", "horizon": 3}),
    "every effect, ekf": {**entries(*STANDING), "estimator": {"kind": "ekf"}},
}


def log_of(settings: Machine, duration_s: float = 1.5) -> Log:
    """Log of the axis itself with its effects, whose stiffness is off."""
    scale = {"stiffness": (1.2, 0.8, 1.1, 0.97, 1.05, 0.9, 1.1, 0.85, 1.2, 0.9)[: settings.friction.n_z]}
    return simulate_log(settings, seconds=duration_s, scale=scale, seed=1)


def largest_difference(c: Estimates, reference: Estimates) -> float:
    """Of friction over its range, of parameters and their deviations relative to themselves."""
    return max(
        float(np.abs(c.friction_N - reference.friction_N).max() / np.ptp(reference.friction_N)),
        float(np.abs(c.parameters / reference.parameters - 1.0).max()),
        float(np.abs(c.std / reference.std - 1.0).max()),
    )


def compiled(settings: Machine) -> CompiledEstimator:
    return CompiledEstimator(settings, emit_package(settings, selftest=False))


@pytest.mark.parametrize("case", list(CASES))
def test_c_is_the_reference(case: str) -> None:
    settings = switching(**CASES[case])
    signals = signals_from_log(log_of(settings), settings)
    reference = estimate_once(settings, signals)
    c = compiled(settings).estimate(signals)
    assert largest_difference(c, reference) < 1e-11
    np.testing.assert_array_equal(c.status, reference.status)
    assert np.ptp(reference.parameters, axis=0).max() > 1e-3 * np.abs(reference.parameters).max()


@pytest.mark.parametrize("changes", [{}, {"estimator": {"kind": "ekf"}}, five(estimator={"relinearise": "auto"})])
def test_single_precision_follows_the_reference(changes: dict[str, Any]) -> None:
    settings = switching(**changes, code={"precision": "single"})
    signals = signals_from_log(log_of(settings), settings)
    c, reference = compiled(settings).estimate(signals), estimate_once(settings, signals)
    assert np.abs(c.friction_N - reference.friction_N).max() < 1e-4 * np.ptp(reference.friction_N)
    np.testing.assert_allclose(c.parameters, reference.parameters, rtol=1e-3)
    np.testing.assert_allclose(c.std, reference.std, rtol=2e-3)


def test_raw_samples_and_one_task_give_the_same() -> None:
    settings = switching(estimator={"relinearise": "auto"})
    estimator = compiled(settings)
    tasks, tick = (estimator.estimate_log(log_of(settings), mode=mode) for mode in ("tasks", "tick"))
    for name in ("friction_N", "z_m", "parameters", "std", "status"):
        np.testing.assert_array_equal(getattr(tick, name), getattr(tasks, name), err_msg=name)


def test_friction_ahead_is_the_law_over_lag_and_delay() -> None:
    """Before its first update the estimator is the model alone: clips along the motion, over lag and delay."""
    settings = switching(sampling={"update_rate": 10.0}, compensation={"delay": 400e-6}, estimator={"kind": "ekf"})
    time = np.arange(500) / RATE
    path = 80e-6 * np.sin(2.0 * np.pi * 55.0 * time * (1.0 + 12.0 * time)) * np.minimum(1.0, (time / 4e-3) ** 2)
    log = Log(time_s=time, position_m=path, force_N=np.zeros(500), rate=RATE, source="motion")
    signals, lag = signals_from_log(log, settings), chain_delay(settings)
    found = compiled(settings).estimate_log(log, mode="tick").extra["compensation_N"]
    chi, expected, behind = np.zeros(4), np.zeros(500), np.zeros(500)
    for k in range(500):
        v = float(signals.velocity[k])
        chi = clipped(chi, v / RATE, level_at(v)) if k else chi
        beyond = float(path[k] - signals.position[k])
        mean = beyond / lag
        ahead = v + (mean - v) * (lag + 0.5e-4 + 0.5 * 400e-6) / (0.5 * (lag + 1e-4))
        last = v + (mean - v) * (lag + 0.5e-4 + 400e-6) / (0.5 * (lag + 1e-4))
        moved = clipped(clipped(chi, beyond, level_at(mean)), ahead * 400e-6, level_at(ahead))
        expected[k] = LEVEL * float(NU @ moved) + 20.0 * last
        behind[k] = LEVEL * float(NU @ chi) + 20.0 * v
    assert np.ptp(expected) > 3.5 and np.abs(expected - behind)[40:].max() > 0.5
    np.testing.assert_allclose(found[40:], expected[40:], rtol=0.0, atol=1e-6)


@pytest.mark.slow
def test_a_diagnosis_takes_the_law_as_it_is() -> None:
    """Its emitted models switch."""
    settings = switching()
    hidden = ("force_ripple", {"amplitude_N": 0.5, "pitch_m": 0.0173, "phase_rad": 0.7})
    found = diagnose(settings, simulate_log(settings, hidden, seconds=8.0, seed=1))
    assert_found(found, {"force_ripple": {}}, "explained")
    assert found.extended is not None and found.extended.friction.switches
    assert found.law == "switching" and not any("[friction] law" in note for note in found.warnings)


@pytest.mark.slow
def test_an_effect_that_cannot_switch_is_found_on_an_axis_that_does() -> None:
    settings = switching()
    found = diagnose(settings, simulate_log(settings, ("backlash", {"gap_m": 3e-5}), seconds=5.0, seed=1))
    assert_found(found, {"backlash": {"gap_m": pytest.approx(3e-5, rel=0.1)}})
    assert found.law == "switching"
    # The file that has the gap has elements that slip almost at once: it stands with no others.
    assert found.extended is not None and not found.extended.friction.switches
    assert found.extended.friction.smoothed.zeta == SHARP_SMOOTHING["zeta"]


def test_the_error_of_the_smoothing_is_gone() -> None:
    """On an axis that switches, and of the stated stiffness: what the model alone leaves of the measured force."""
    log = simulate_log(switching(), seconds=1.5, seed=1, force_noise_N=0.0)
    left = {}
    for law, settings in (("switching", switching()), ("sgms", machine())):
        signals = signals_from_log(log, settings)
        # One reading per update: ten would correct the states more often than the smoothing is wrong.
        changes = {"sampling": {"measurement_rate": 100.0}, "estimator": {"kind": "ekf", "noise": {"parameter": 1e-6}}}
        known = override_machine(settings, changes)
        found = estimate_once(known, signals)
        left[law] = float(
            np.sqrt(np.mean((found.friction_N - signals.friction[100::100][: len(found.friction_N)]) ** 2))
        )
    assert left["switching"] < 0.5 * left["sgms"]


@pytest.mark.parametrize("kind", ["mhe", "ekf"])
def test_stiffness_of_an_axis_that_switches_is_found(kind: str) -> None:
    """Four stiffnesses 5 to 20 % off, twenty seconds of mixed motion: near, and never beyond two stated sigmas."""
    estimator = compiled(switching(estimator={"kind": kind, "noise": {"parameter": 0.4}}))
    true = np.array([1.2, 0.85, 1.1, 0.95])
    for seed in (0, 1):
        log = simulate_log(switching(), seconds=20.1, scale={"stiffness": tuple(true)}, seed=seed)
        found = estimator.estimate_log(log, mode="tasks")
        error = found.parameters / KAPPA - true
        assert np.abs(error[-1] / true).max() < 0.03
        assert np.abs(error / (found.std / KAPPA))[500:].max() < 2.0


# --- what does not go with it ------------------------------------------------------------------------------------

REFUSED: dict[str, tuple[dict[str, Any], str, str]] = {
    "smoothing": ({"friction": {"smoothing": {"zeta": 0.95}}}, "friction.smoothing", "no smoothing where law is"),
    "scheme": ({"sampling": {"integrator": {"scheme": "flow"}}}, "sampling.integrator.scheme", "clip, or nothing"),
    "damping": ({"friction": {"micro_viscous": [1.0, 0.0, 0.0, 0.0]}}, "friction.micro_viscous", "zeros where law is"),
    "gap": (entries("backlash"), "effects[1].name", "they have no displacement of their own"),
    "damping effect": (entries("micro_viscous"), "effects[1].name", "the damping of an element would jump"),
}


@pytest.mark.parametrize("case", list(REFUSED))
def test_what_the_law_does_not_bear_is_refused(case: str) -> None:
    changes, where, allowed = REFUSED[case]
    with pytest.raises(InputError) as caught:
        switching(**changes)
    assert f"{where} = " in str(caught.value) and allowed in str(caught.value)


def test_other_laws_have_no_clip() -> None:
    with pytest.raises(InputError, match=r"sampling\.integrator\.scheme = 'clip'.*\[friction\] law = switching"):
        machine(sampling={"integrator": {"scheme": "clip"}})
    with pytest.raises(InputError, match=r"friction\.law = 'steps'.*'sgms' or 'switching'"):
        machine(friction={"law": "steps"})
    with pytest.raises(InputError, match=r"friction\.smoothing: a table .*where law is sgms"):
        variant(friction={"smoothing": None})


def test_a_law_replaces_the_smoothing_and_the_integrator_of_another(tmp_path: Path) -> None:
    file = tmp_path / "axis.toml"
    file.write_text('extends = "etel_xy_controller"\nname = "axis"\n[friction]\nlaw = "switching"\n')
    read = load_machine(file)
    assert read.friction.switches and read.friction.smoothing is None
    assert (read.sampling.integrator.scheme, read.sampling.merged) == ("clip", 5)
    back = override_machine(read, {"friction": {"law": "sgms"}})
    assert back.sampling.integrator.scheme == "flow" and back.friction.smoothed.lambda_ == 35.0
    assert load_machine("etel_xy").friction.law == "sgms"
    with pytest.raises(ValueError, match="has no smoothing"):
        _ = read.friction.smoothed


def axis_of_two() -> tuple[SymbolicAxis, ca.SX]:
    """An axis with an element and a state of an effect's own."""
    axis = SymbolicAxis(1.0, 1.0, step=1e-4, gate_per_velocity=1.0)
    for name, element in (("z_1", 0), ("own", None)):
        axis.add_state(StateSpec(name, element, 1.0, 1.0, 1.0, 1.0)).rate = ca.SX(0)
    return axis, axis.states[1].chi


def test_contributions_of_others_are_refused_where_no_clip_would_be_right() -> None:
    def check(axis: SymbolicAxis, level: ca.SX) -> None:
        check_switching(switching(), axis, Elements(ca.SX(1), level, ca.SX(1)))

    axis, own = axis_of_two()
    axis.states[1].rate = axis.velocity - 2.0 * own
    check(axis, 1.0 + 0.1 * own)
    axis.states[1].rate = axis.velocity - own * own
    with pytest.raises(InputError, match=r"friction\.law = 'switching'.*level depends on own"):
        check(axis, 1.0 + 0.1 * own)
    check(axis, ca.SX(1.0))
    axis.engagement = 0.5 + 0.5 * own
    with pytest.raises(InputError, match="another velocity"):
        check(axis, ca.SX(1.0))
    axis, _ = axis_of_two()
    axis.micro_viscous = ca.SX(3.0)
    with pytest.raises(InputError, match="would jump"):
        check(axis, ca.SX(1.0))


def test_the_simulated_axis_obeys_the_file_unless_it_is_told_otherwise() -> None:
    axes: list[tuple[Machine, Any]]
    axes = [(switching(), None), (machine(), "maxwell_slip"), (machine(), None), (switching(), "sgms")]
    own, same, *others = (simulate_log(axis, seconds=1.0, law=law).force_N for axis, law in axes)
    np.testing.assert_array_equal(own, same)
    assert all(np.abs(own - other).max() > 1e-3 for other in others)
