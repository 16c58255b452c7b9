"""What real records bring: two things wrong at once, low rates, gaps, saturation, hardly any motion, length."""

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pytest import approx

from cli_cases import done, refused
from diagnosis_cases import Causes, Within, assert_found
from record_cases import simulate_log, slow_axis
from sgms_bench.diagnosis.axes import DrawnAxis
from sgms_bench.diagnosis.causes import Hidden
from sgms_bench.diagnosis.draws import Draw, machine_of, simulate_draw
from sgms_mhe.configuration import load_machine, override_machine, switch_law
from sgms_mhe.diagnosis import Diagnosis, diagnose
from sgms_mhe.diagnosis.causes import _is_echo, _is_imitation, is_confirmed
from sgms_mhe.diagnosis.fits import Subject, fit_model
from sgms_mhe.diagnosis.laws import fit_chosen, make_laws
from sgms_mhe.diagnosis.models import CompiledFit, FitError, make_model
from sgms_mhe.diagnosis.parametrisation import CandidateEffect, ParameterGroup
from sgms_mhe.diagnosis.parts import Cause, Rms
from sgms_mhe.diagnosis.plan import make_plan
from sgms_mhe.diagnosis.rivals import Contest, Selection, find_rivals
from sgms_mhe.diagnosis.selection import Searched, select_causes
from sgms_mhe.diagnosis.uncertainty import covariance
from sgms_mhe.host.compiled import CompiledModel
from sgms_mhe.machine import Machine
from sgms_mhe.plant.trajectories import Motion, Trajectory, make_trajectory
from sgms_mhe.recordings.evidence import noise_floor
from sgms_mhe.recordings.excerpt import make_excerpt
from sgms_mhe.recordings.recording import Recording, count_spanning, prepare
from sgms_mhe.signals.logs import Log, write_log
from sgms_mhe.support.numbers import SIGMAS

Effects = Sequence[tuple[str, Mapping[str, float]]]

RIPPLE = {"amplitude_N": 0.5, "pitch_m": 0.0173, "phase_rad": 0.7}
SECONDS = 6.0
EXTRA_MASS = {"mass_kg": approx(0.1 * load_machine("etel_xy").plant.moved, rel=0.03)}
LONG_S = 120.0
STEP_N = 0.6
PITCH = approx(RIPPLE["pitch_m"], rel=2e-3)


@pytest.fixture(scope="module")
def quick() -> Machine:
    """The controller's own machine: 10 kHz."""
    return load_machine("etel_xy")


@pytest.fixture(scope="module")
def slow() -> Machine:
    """The same axis where only every tenth sample is logged."""
    return slow_axis()


def recorded(machine: Machine, hidden: Effects = (), path: Trajectory | None = None, **options: Any) -> Log:
    """What a controller at 10 kHz logs."""
    return simulate_log(machine, *hidden, path=path or "mixed", seconds=SECONDS, fastest=0.3, seed=1, **options)


def every_tenth(log: Log) -> Log:
    columns: dict[str, Any] = {name: np.ascontiguousarray(values[::10]) for name, values in log.columns.items()}
    return replace(log, rate=log.rate / 10.0, **columns)


@pytest.fixture(scope="module")
def rippled(quick: Machine) -> Log:
    """A record at 1 kHz of an axis with a force ripple."""
    return every_tenth(recorded(quick, [("force_ripple", RIPPLE)]))


def assert_finds_the_ripple(diagnosis: Diagnosis) -> None:
    assert_found(diagnosis, {"force_ripple": {"amplitude_N": approx(0.5, rel=0.1), "pitch_m": PITCH}})
    assert diagnosis.causes[0].gain_interval_N[0] > 0.2


def test_interval_knows_that_the_axis_switches(quick: Machine) -> None:
    # What the smooth law gets wrong at every reversal is in no scatter over blocks: the other law tells it.
    recording = prepare(quick, recorded(quick, law="maxwell_slip", force_noise_N=0.03))
    axis = switch_law(quick)
    assert axis is not None
    smooth, switching = Subject.of(quick, recording).with_final_steps(), Subject.of(axis, recording)
    smooth = replace(smooth, noise=noise_floor(recording, fit_model(smooth, (), refitted=()).residual))
    fit = fit_model(smooth, (), iterations=40)

    def errors(other: Subject | None) -> NDArray[np.float64]:
        std = np.sqrt(np.diag(covariance(smooth, fit, other)))
        return np.asarray(np.abs(fit.theta - 1.0)[fit.free] / std[fit.free])

    assert np.max(errors(None)) > 3.0
    assert np.max(errors(switching)) < 2.5
    assert np.median(errors(switching)) > 0.3  # no wider than it has to be


def hard(machine: Machine, seconds: float = SECONDS) -> Trajectory:
    """The mixed motion at full speed."""
    return make_trajectory("mixed", machine.sampling.rate, duration_s=seconds)


DELAY, MASS = {"delay_s": 8e-5}, {"mass_kg": 0.06}  # of the order of a sample; half a sample of viscous friction: 1 g


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "options", "causes"),
    [
        # A mass that is wrong hides nothing.
        (
            ("force_ripple", RIPPLE),
            {"scale": {"mass": 1.1}},
            {"mass_mismatch": EXTRA_MASS, "force_ripple": {"amplitude_N": approx(0.5, rel=0.1)}},
        ),
        (
            ("asymmetric_coulomb", {"ratio": 0.2}),
            {"scale": {"mass": 1.1}},
            {"mass_mismatch": EXTRA_MASS, "asymmetric_coulomb": {"ratio": approx(0.2, rel=0.1)}},
        ),
        # The second difference of sparse samples loses a share of a hard acceleration: that is no cause.
        (None, {"fastest": 0.3}, {}),
        (None, {}, {}),
    ],
    ids=["ripple beside a mass", "level beside a mass", "clean", "clean and hard"],
)
def test_one_sample_in_ten_is_enough(
    quick: Machine, slow: Machine, hidden: Any, options: Mapping[str, Any], causes: Causes
) -> None:
    log = simulate_log(quick, *([hidden] if hidden else []), **{"seconds": SECONDS, "seed": 1, **options})
    diagnosis = diagnose(slow, every_tenth(log))
    assert_found(diagnosis, causes, *([] if causes else ["adequate"]))
    assert causes or diagnosis.learned is None


@pytest.mark.slow
@pytest.mark.parametrize(("name", "number", "rel"), [("mass_mismatch", MASS, 0.008), ("force_delay", DELAY, 0.05)])
def test_what_is_about_as_fast_as_a_sample_is_measured_right(
    quick: Machine, name: str, number: Mapping[str, float], rel: float
) -> None:
    diagnosis = diagnose(quick, recorded(quick, [(name, number)], hard(quick), force_noise_N=0.03))
    ((key, size),) = number.items()
    assert_found(diagnosis, {name: {key: approx(size, rel=rel)}})
    assert_found(diagnosis, {name: {key: Within(size)}})


# --- low rate, gaps, saturation ---------------------------------------------------------------------------------


def with_gaps(log: Log) -> tuple[Log, int]:
    """Up to 40 samples missing at 24 places, of position or force, and a fiftieth of the record of both."""
    random = np.random.default_rng(3)
    position, force = log.position_m.copy(), log.force_N.copy()
    for channel in (position, force):
        for start in random.integers(0, len(log) - 60, 12):
            channel[start : start + int(random.integers(1, 40))] = np.nan
    middle = slice(len(log) // 2, len(log) // 2 + len(log) // 50)
    position[middle] = force[middle] = np.nan
    return replace(log, position_m=position, force_N=force), int((np.isnan(position) | np.isnan(force)).sum())


def test_gaps_hide_nothing(slow: Machine, rippled: Log) -> None:
    """Nor does it take more than a tenth of an axis's samples."""
    log, missing = with_gaps(rippled)
    diagnosis = diagnose(slow, log)
    assert_finds_the_ripple(diagnosis)
    assert any(f"{missing} of {len(log)} samples are missing" in warning for warning in diagnosis.warnings)
    middle = len(log) // 2 * len(diagnosis.traces.used) // len(log)
    assert not diagnosis.traces.used[middle : middle + 50].any()


def test_saturated_measurement_is_left_out(slow: Machine, rippled: Log) -> None:
    limit = 0.15 * float(np.abs(rippled.force_N).max())
    diagnosis = diagnose(slow, replace(rippled, force_N=np.clip(rippled.force_N, -limit, limit)))
    assert_finds_the_ripple(diagnosis)
    assert any("saturated" in warning for warning in diagnosis.warnings)


@pytest.mark.slow
def test_saturated_drive_is_no_cause(quick: Machine, slow: Machine, rippled: Log) -> None:
    # The axis does not follow its reference then; what it does is measured all the same.
    limit = 0.4 * float(np.abs(rippled.force_N).max())
    assert_finds_the_ripple(diagnose(slow, every_tenth(recorded(quick, [("force_ripple", RIPPLE)], max_force_N=limit))))


@pytest.mark.slow
def test_a_force_that_is_held_is_no_resonance(quick: Machine) -> None:
    """A drive of 1 kHz: its force acts half a sample later, by the mean of two; what that leaves has no mass."""
    sampling = {"rate": 1000.0, "update_rate": 50.0, "velocity_cutoff": 100.0}
    friction = {"stiffness": [3e4, 1e4], "fraction": [0.25, 0.75], "micro_viscous": [0.0, 0.0], "stribeck_ratio": 0.0}
    axis = override_machine(quick, {"sampling": sampling, "friction": friction, "estimator": {"horizon": 5}})
    ripple = {"amplitude_N": 1.5, "pitch_m": 0.02, "phase_rad": 0.6}
    diagnosis = diagnose(axis, recorded(axis, [("force_ripple", ripple)], hard(axis, 12.0)))
    assert_found(diagnosis, {"force_ripple": {"amplitude_N": approx(1.5, rel=0.03)}})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("delay_s", "causes", "said"),
    [
        (0.0, {}, "older than the position"),
        (2e-3, {"force_delay": {"delay_s": Within(2e-3)}}, ""),  # more than that is one
        (-8e-4, {}, "younger than the position"),  # a command that the drive obeys within the sample
    ],
    ids=["held", "late", "young"],
)
def test_a_force_that_is_held_is_no_delay(delay_s: float, causes: Causes, said: str) -> None:
    """At 1 kHz: what the drive's force is old by is of the sampling, which is said and not named."""
    axis = load_machine("emps")
    path = Motion(axis.sampling.rate)
    path.wait(0.3)
    for to, speed in ((0.1, 0.03), (0.15, 0.06), (0.2, 0.1)):
        for target in (to, 0.0):
            path.move_to(target, speed, 1.0, 40.0)
            path.wait(0.1)
    hidden = [("force_delay", {"delay_s": delay_s})] if delay_s else []
    diagnosis = diagnose(axis, recorded(axis, hidden, path.trajectory("strokes")))
    assert_found(diagnosis, causes, *(["adequate"] if not delay_s else []))
    assert any("samples" in warning and said in warning for warning in diagnosis.warnings) or not said


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "number", "other"),
    [("force_delay", {"delay_s": -5e-4}, "actuator_lag"), ("actuator_lag", {"time_constant_s": 5e-4}, "force_delay")],
)
def test_a_drive_that_obeys_late_and_one_that_lags_are_rivals(
    quick: Machine, name: str, number: Mapping[str, float], other: str
) -> None:
    """Either is named for itself, and the other one is tried in its place."""
    found = diagnose(quick, recorded(quick, [(name, number)]))
    assert_found(found, {name: {key: Within(value, 3.0) for key, value in number.items()}}, "explained", "ambiguous")
    assert other in {alternative.name for alternative in found.alternatives}


# --- hardly any motion ------------------------------------------------------------------------------------------


def presliding(rate: float) -> Trajectory:
    """Loops of a few micrometres, below break-away."""
    motion = Motion(rate)
    for k in range(12):
        for side in (1.0, -1.0):
            motion.move_to(side * 4e-6 * (1.0 + (7 * k % 5) / 4.0), 2e-4, 0.5, 500.0)
    return motion.trajectory("presliding")


@pytest.mark.slow
@pytest.mark.parametrize("stiffer", [1.0, 1.3])
def test_presliding_alone(quick: Machine, stiffer: float) -> None:
    diagnosis = diagnose(quick, recorded(quick, path=presliding(quick.sampling.rate), scale={"stiffness": stiffer}))
    number = {"stiffness_1_N_m": approx(stiffer * quick.friction.stiffness[0], rel=0.05)}
    assert_found(diagnosis, {"stiffness": number} if stiffer > 1.0 else {}, *(["adequate"] if stiffer == 1.0 else []))


def standing(quick: Machine, rest: str) -> Log:
    """Two seconds of an axis that holds its place."""
    path = Trajectory("rest", quick.sampling.rate, np.zeros(20_000))
    disturbances: dict[str, Effects] = {
        "held": (),
        "loaded": [("constant_offset", {"force_N": 1.0})],
        "humming": [("periodic_disturbance", {"amplitude_N": 0.5, "frequency_Hz": 13.0, "phase_rad": 0.0})],
    }
    if rest != "dead":
        return recorded(quick, disturbances[rest], path)
    zero: NDArray[np.float64] = np.zeros(20_000)
    return replace(recorded(quick, (), path), position_m=zero, force_N=zero)


@pytest.mark.parametrize("rest", ["held", "loaded", "humming", "dead"])
def test_record_without_motion_says_so(quick: Machine, rest: str) -> None:
    diagnosis = diagnose(quick, standing(quick, rest))
    assert not diagnosis.excited and diagnosis.extended is None
    assert "no excitation" in diagnosis.summary
    assert diagnosis.separating_experiment
    # Nothing may be confirmed where a newton is left that the model does not know.
    assert_found(diagnosis, {}, "adequate" if rest in ("held", "dead") else "unexplained")


@pytest.mark.slow
def test_a_record_of_one_speed_is_no_record_without_motion(quick: Machine) -> None:
    """Friction does not change, but every element slips."""
    rate = quick.sampling.rate
    path = Trajectory("one way", rate, 0.02 * np.arange(30_000) / rate)
    log = recorded(quick, (), path).part(1.0)
    diagnosis = diagnose(quick, replace(log, time_s=log.time_s - log.time_s[0]))
    assert diagnosis.excited
    assert not any("hardly moves" in sentence for sentence in (diagnosis.summary, *diagnosis.warnings))


def test_command_on_a_record_without_motion(quick: Machine, tmp_path: Path) -> None:
    held = standing(quick, "held")
    flicker = 1e-9 * (np.arange(len(held)) % 7 == 0)  # of the encoder's last digit
    write_log(tmp_path / "rest.csv", replace(held, position_m=held.position_m + flicker))
    result = done("diagnose", "etel_xy", tmp_path / "rest.csv", "--out", tmp_path / "out")
    assert "no excitation" in result.stdout
    content = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert (content["causes"], content["extended_machine"]) == ([], None)
    assert "the axis hardly moves" in (tmp_path / "out" / "report.html").read_text()
    # Where the encoder never moves at all, it may be the wrong column as well.
    write_log(tmp_path / "held.csv", held)
    assert "position_m" in refused("diagnose", "etel_xy", tmp_path / "held.csv", "--out", tmp_path / "none")
    assert not (tmp_path / "none").exists()


# --- length -----------------------------------------------------------------------------------------------------

MEASURE = """
import resource, sys
from sgms_mhe.diagnosis.fits import Subject, fit_model
from sgms_mhe.recordings.recording import prepare
from sgms_mhe.logfiles.reading import read_log
from sgms_mhe.configuration import load_machine
machine = load_machine(sys.argv[1])
recording = prepare(machine, read_log(sys.argv[2], machine))
fit_model(Subject.of(machine, recording), (), refitted=())
print(len(recording.time), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


@pytest.mark.slow
def test_memory_grows_with_the_log_alone(quick: Machine, tmp_path: Path) -> None:
    # Twelve times as much data: what grows is a few columns per sample, not the model's derivatives or states.
    path = make_trajectory("mixed", quick.sampling.rate, duration_s=5.0)
    once = recorded(quick, path=path)
    peaks, samples = [], []
    for copies in (1, 12):
        n = copies * len(once)
        columns: dict[str, Any] = {
            "time_s": np.arange(n) / once.rate,
            "position_m": np.tile(once.position_m, copies),
            "force_N": np.tile(once.force_N, copies),
        }
        write_log(tmp_path / "log.npz", replace(once, **columns))
        script = [sys.executable, "-c", MEASURE, "etel_xy", str(tmp_path / "log.npz")]
        rows, peak = subprocess.run(script, check=True, capture_output=True, text=True).stdout.split()
        assert int(rows) <= 150_000
        samples.append(n)
        peaks.append(1024 * int(peak))
    assert (peaks[1] - peaks[0]) / (samples[1] - samples[0]) < 400.0  # bytes a sample


@pytest.fixture(scope="module")
def long(quick: Machine) -> Log:
    """Two minutes at 1 kHz of an axis with a force ripple, and a step after a third of it."""
    path = make_trajectory("mixed", quick.sampling.rate, duration_s=LONG_S, max_velocity=0.3)
    step = {"force_N": STEP_N, "time_s": LONG_S / 3.0}
    return every_tenth(recorded(quick, [("force_ripple", RIPPLE), ("step_disturbance", step)], path))


def test_excerpt_is_spread_over_the_record(slow: Machine, rippled: Log, long: Log) -> None:
    whole = prepare(slow, long)
    part = make_excerpt(whole)
    short = prepare(slow, rippled)
    assert make_excerpt(short) is short
    assert len(part.signals) <= 1.1 * slow.diagnosis.fitted_time * slow.sampling.rate
    time = part.time[part.used]
    stretch = whole.time[-1] / len(np.unique(np.floor(time / 2.0)))
    assert time[0] < 2.0 * stretch and time[-1] > whole.time[-1] - 2.0 * stretch
    assert np.max(np.diff(time)) < 4.0 * stretch
    assert np.ptp(part.position[part.used]) > 0.9 * np.ptp(whole.position[whole.used])
    assert 0.15 < part.held_out.mean() < 0.6
    # The same rows as in the record, at their own time.
    place = np.searchsorted(whole.time, time - 1e-6)
    np.testing.assert_allclose(part.friction[part.used], whole.friction[place], atol=1e-12)
    np.testing.assert_allclose(part.clock[:: part.factor], part.time, atol=part.factor / slow.sampling.rate)
    # A third of the pieces is held out, and nothing that is held out was not.
    held = whole.held_out[whole.block[place]]
    np.testing.assert_array_equal(part.held_out[part.block[part.used]], held)


@pytest.mark.slow
def test_pieces_of_a_long_record_do_not_begin_where_elements_remember(slow: Machine) -> None:
    """Loops below break-away forget nothing, whatever their way: what was before them would look like an effect."""
    axis = load_machine("etel_xy")
    path = make_plan(axis, ("position_spring", "constant_offset")).trajectory
    log = every_tenth(recorded(axis, path=path))
    assert log.time_s[-1] > slow.diagnosis.fitted_time
    diagnosis = diagnose(slow, log)
    assert diagnosis.verdict == "adequate", diagnosis.summary
    assert diagnosis.rms.after < 1.3 * diagnosis.noise_floor_N


def test_spring_far_from_its_centre_is_found_in_few_steps(
    quick: Machine, slow: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Linear in stiffness and in stiffness times centre, so a fit is there in a step, however far the centre is."""
    spring = {"stiffness_N_m": 0.5, "centre_m": 2.0}
    subject = Subject.of(slow, prepare(slow, every_tenth(recorded(quick, [("position_spring", spring)]))))
    run, runs = CompiledFit.run, []

    def counted(*args: Any, **options: Any) -> Any:
        runs.append(args)
        return run(*args, **options)

    monkeypatch.setattr(CompiledFit, "run", counted)
    fit = fit_model(subject, [CandidateEffect("position_spring", {"stiffness_N_m": 6.0, "centre_m": 0.0})], refitted=())
    assert len(runs) <= 4
    assert fit.effects[0].parameters["centre_m"] == pytest.approx(spring["centre_m"], rel=0.05)
    assert fit.effects[0].parameters["stiffness_N_m"] == pytest.approx(spring["stiffness_N_m"], rel=0.05)


@pytest.mark.parametrize(("stiffer", "largest"), [(1.0, 1e-5), (10.0, 1e-3)])
def test_steps_of_a_fit_are_short_enough(slow: Machine, rippled: Log, stiffer: float, largest: float) -> None:
    """Coarser than a controller's below the gate, and far below any noise, also where the file is wrong by far."""
    code = make_model(slow, ()).code
    fine = CompiledModel(override_machine(code.machine, {"sampling": {"integrator": {"slow_displacement": 2e-3}}}))
    theta = np.where(["stiffness" in p.column for p in code.model.parameters], stiffer, 1.0)
    signals = prepare(slow, rippled).signals
    ours, theirs = (model.predict(signals, theta) for model in (code, fine))
    assert np.max(np.abs(ours - theirs)) < largest * slow.friction.coulomb


def test_rows_until_a_motion_has_covered_an_extent() -> None:
    to_and_fro = np.tile([0.0, 0.4, 0.9, 0.4], 500)
    assert count_spanning(to_and_fro, 1.0) == len(to_and_fro)
    assert count_spanning(np.append(to_and_fro, [1.0, 2.0]), 1.0) == len(to_and_fro)
    assert count_spanning(to_and_fro, 0.9) == 2


@pytest.mark.slow
def test_work_on_a_long_record_is_bounded(slow: Machine, long: Log) -> None:
    # Models are fitted to as much of it as of a minute, and run along all of it a few times.
    runs: list[int] = []
    run = CompiledFit.run

    def counted(model: CompiledFit, recording: Recording, *args: Any, **options: Any) -> Any:
        runs.append(len(recording.signals))
        return run(model, recording, *args, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(CompiledFit, "run", counted)
        diagnosis = diagnose(slow, long)
    n = len(long)
    fitted = 1.1 * slow.diagnosis.fitted_time * slow.sampling.rate
    # Now and then with half the steps: what the length of a step does.
    assert max(k for k in runs if k < n) <= 2.0 * fitted
    assert sum(fitted < k < n for k in runs) <= 0.1 * len(runs)
    # Five of them tell what the encoder's steps leave: a trajectory without, and four that encoders make of it.
    assert 0 < sum(k == n for k in runs) <= 21
    assert 0 < sum(k == 2 * n for k in runs) <= 8
    assert len(diagnosis.traces.time_s) * slow.sampling.rate / diagnosis.traces.rate == pytest.approx(n, rel=1e-3)
    assert any("models are fitted to" in warning for warning in diagnosis.warnings)
    step = {"force_N": approx(STEP_N, rel=0.05), "time_s": approx(LONG_S / 3.0, abs=0.05)}
    assert_found(diagnosis, {"force_ripple": {"pitch_m": PITCH}, "step_disturbance": step})


def test_stand_ins_for_elements_that_switch_are_no_stribeck_effect(quick: Machine) -> None:
    """A gap is fitted with elements that do not switch. What they leave of an axis that does is no wrong number."""
    floor, stribeck = 0.05, ParameterGroup("base", "stribeck")
    gap = SimpleNamespace(effects=(CandidateEffect("backlash", {"gap_m": 1e-4}),))
    ripple = SimpleNamespace(effects=(CandidateEffect("force_ripple", {"amplitude_N": 1.0}),))

    def imitates(fit: object, gain: float, *, may_switch: bool = True, group: ParameterGroup = stribeck) -> bool:
        other = SimpleNamespace(machine=switch_law(quick)) if may_switch else None
        subject = SimpleNamespace(machine=quick)
        settled = SimpleNamespace(subject=subject, other=other, floor=floor)
        return _is_imitation(settled, fit, group, SimpleNamespace(gain_N=gain * floor))  # type: ignore[arg-type]

    assert not quick.friction.switches
    assert imitates(gap, 2.7)
    assert not imitates(gap, 3.1)
    assert not imitates(gap, 2.7, may_switch=False)
    assert not imitates(ripple, 2.7)
    assert not imitates(gap, 2.7, group=ParameterGroup("candidate", "backlash", index=0))


@pytest.mark.slow
def test_the_difference_of_the_laws_is_no_wrong_number(quick: Machine) -> None:
    """Where either law fits, the one stands that needs fewer wrong numbers: by the other one a Stribeck effect goes."""
    draw = Draw(
        index=0,
        kind="base",
        axis=DrawnAxis("linear", other_law=True, obeys="sgms"),
        hidden=(Hidden("coulomb", factors={"coulomb": 0.5121214720402487}),),
        machine_changes={},
        style="dies",
        seconds=10.593301230586455,
        motion_seed=1631138469,
        force_noise_N=0.037,
        encoder_noise_m=2.1e-9,
        encoder_resolution_m=1.8e-10,
        noise_seed=583605344,
    )
    log, _ = simulate_draw(quick, draw)
    found = diagnose(machine_of(quick, draw), log)
    assert_found(found, {"coulomb": {}}, "explained")
    assert found.law == "sgms"


def test_a_known_fit_stands_where_none_can_begin(slow: Machine, rippled: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside a gap the file's numbers may be none that a model runs through, though the search went round by others."""
    laws = make_laws(slow, prepare(slow, rippled), 0.05)
    criteria: Any = SimpleNamespace(material=0.02, excess=lambda fit: 0.0)
    extras = (CandidateEffect("force_ripple", RIPPLE),)
    known = fit_model(laws.chosen, extras)

    def refuse(*_: object) -> None:
        raise FitError("not finite")

    monkeypatch.setattr("sgms_mhe.diagnosis.laws.fit_model", refuse)
    assert fit_chosen(laws, extras, criteria, known=known) == (laws, known)
    with pytest.raises(FitError):
        fit_chosen(laws, extras, criteria)


def test_a_cause_without_which_no_model_is_finite_has_no_rivals(
    slow: Machine, rippled: Log, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A diagnosis ended there, of an arm's joint whose elements are far from its file's."""
    subject = make_laws(slow, prepare(slow, rippled), 0.05).chosen
    fit = fit_model(subject, (CandidateEffect("force_ripple", RIPPLE),))

    def refuse(*_: object, **__: object) -> None:
        raise FitError("not finite")

    monkeypatch.setattr("sgms_mhe.diagnosis.fits.fit_model", refuse)
    criteria: Any = None
    contest = find_rivals(subject, fit, (), (), criteria, 1)
    assert contest.better is None and not contest.rivals and not contest.rejected


@pytest.mark.slow
def test_an_effect_without_a_finite_model_is_left_out_and_said_to_be(
    slow: Machine, rippled: Log, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = select_causes

    def refuse(searched: Searched) -> Selection:
        if searched.fit.effects:
            raise FitError("not finite")
        return real(searched)

    monkeypatch.setattr("sgms_mhe.diagnosis.verdict.select_causes", refuse)
    # A place among the wrong numbers would bring it back.
    monkeypatch.setattr("sgms_mhe.diagnosis.selection.find_rivals", lambda *_: Contest(None, (), {}))
    found = diagnose(slow, rippled)
    assert found.verdict == "unexplained"
    assert "force_ripple" not in [cause.name for cause in found.causes]
    assert any(warning.startswith("force_ripple: it looked good") for warning in found.warnings)


def test_a_small_sine_with_the_period_of_a_large_one_is_none() -> None:
    """It comes again with what the form of the large one gets wrong."""

    def sine(name: str, gain: float, period: str, length: float) -> Any:
        return SimpleNamespace(name=name, gain_N=gain, parameters={period: length}, std={period: 2e-5})

    large = sine("position_dependent_friction", 0.4, "pitch_m", 0.037)
    level: Any = SimpleNamespace(name="coulomb", gain_N=9.0, parameters={"coulomb_N": 0.037}, std={"coulomb_N": 1e-3})

    def echoes(cause: Any) -> bool:
        return _is_echo(cause, (large, level, cause))

    assert echoes(sine("encoder_periodic_error", 0.03, "pitch_m", 0.03705))
    assert not echoes(sine("encoder_periodic_error", 0.05, "pitch_m", 0.03705))  # too large to be a flaw of the other
    assert not echoes(sine("encoder_periodic_error", 0.03, "pitch_m", 0.0372))
    assert not echoes(sine("periodic_disturbance", 0.03, "frequency_Hz", 0.037))
    assert not echoes(large)
    assert not echoes(level)


def test_a_wrong_number_differs_from_the_file_by_its_own_interval() -> None:
    """Two numbers of which neither is known to differ are no cause, however surely they differ together."""
    file = {"stribeck_ratio": 0.12, "stribeck_velocity_m_s": 2e-3}

    def held(ratio: float) -> bool:
        cause = Cause(
            name="stribeck",
            label="stribeck",
            parameters=file | {"stribeck_ratio": ratio},
            std={"stribeck_ratio": 0.11, "stribeck_velocity_m_s": 1e-2},
            nominal=file,
            rms=Rms(before=1.0, after=0.9, held_out_before=1.0, held_out_after=0.9),
            gain_N=0.3,
            gain_interval_N=(0.1, 0.5),
            p_value=1e-12,
        )
        return is_confirmed(cause)

    assert not held(0.17)
    assert held(0.12 + 1.01 * SIGMAS * 0.11)
