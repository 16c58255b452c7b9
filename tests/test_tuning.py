"""Weights out of a log: those of the noise that is there, nothing where the file is right, and what `estimate` says."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli_cases import SMALL, done, refused, run
from record_cases import simulate_log
from sgms_mhe.api import tuning
from sgms_mhe.api.tuning import tune as tune_log
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.evaluation.tuning import Trial, Tuned, tune
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.machine import Machine
from sgms_mhe.recordings.output_error import Objective
from sgms_mhe.signals.chain import signals_from_log
from sgms_mhe.signals.innovations import (
    LEAST_UPDATES,
    counted_innovations,
    innovation_loss,
    integrate_innovations,
    moving_updates,
    stated_noise,
)
from sgms_mhe.signals.logs import Log, write_log
from statement_cases import check_statements


def moved(machine: Machine, noise: float, seconds: float = 8.0) -> Log:
    return simulate_log(machine, path="paper", seconds=seconds, force_noise_N=noise, seed=1)


def stated(path: Path, measurement: float) -> Machine:
    return override_machine(load_machine(path), {"estimator": {"noise": {"measurement": measurement}}})


@pytest.mark.slow
@pytest.mark.parametrize("measurement", [2.0, 0.003])
def test_the_noise_that_is_there_is_found(small: Path, measurement: float) -> None:
    machine = stated(small, measurement)
    log = moved(machine, 0.3)
    # Behind the chain: what is left of white noise of the force.
    quiet, noisy = (signals_from_log(moved(machine, noise), machine) for noise in (0.0, 0.3))
    both = quiet.valid & noisy.valid
    true = float(np.std((noisy.friction - quiet.friction)[both]))
    tuned = tune(machine, log)
    found = tuned.best.changes["measurement"]
    assert true / 1.5 < found < 1.5 * true
    assert tuned.best.ratio == pytest.approx(1.0, abs=0.6)
    assert abs(math.log(tuned.start.ratio)) > 1.5
    assert tuned.best.better_by(tuned.start) > 5.0
    assert set(tuned.changes()) == {"estimator"}
    if measurement > 1.0:  # tuned once more there is nothing left that the log could tell, wherever it began
        again = tune(override_machine(machine, tuned.changes()), log)
        assert again.best.better_by(again.start) < 3.0
        assert again.best.changes.get("measurement", found) == pytest.approx(found, rel=0.5)
    # Each curve is of the likeliest trials, so it is least where the chosen weight is.
    for name, tried in tuned.trials.items():
        if name != "horizon" and len(tried) > 1:
            chosen = tuned.best.changes.get(name, getattr(machine.estimator.noise, name))
            assert min(trial.mean for _, trial in tried) == dict(tried)[chosen].mean <= tuned.best.mean


@pytest.mark.slow
def test_the_file_that_is_written_extends_the_machine(
    small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loud = tmp_path / "loud.toml"
    loud.write_text(SMALL + "[estimator.noise]\nmeasurement = 3.0\n")
    machine = load_machine(loud)
    write_log(tmp_path / "log.csv", moved(machine, 0.1))
    found: list[Tuned] = []
    monkeypatch.setattr(tuning, "tune", lambda *log, **words: found.append(tune_log(*log, **words)) or found[0])
    result = run("tune", loud, tmp_path / "log.csv", "--out", tmp_path / "tuned.toml", "--json")
    assert result.exit_code == 0, result.output
    content = json.loads(result.stdout)
    assert {entry["kind"] for entry in check_statements(content)} == {"weight", "error"}
    tuned = load_machine(tmp_path / "tuned.toml")
    assert tuned.estimator.noise.measurement == content["changes"]["estimator"]["noise"]["measurement"] < 1.0
    assert tuned.friction == machine.friction
    assert 'extends = "loud.toml"' in (tmp_path / "tuned.toml").read_text()
    (tmp_path / "new").mkdir()
    monkeypatch.setattr(tuning, "tune", lambda *_, **__: found[0])  # of the same log
    alone = run("tune", loud, tmp_path / "log.csv", "--out", tmp_path / "new" / "tuned.toml", "--standalone")
    assert alone.exit_code == 0, alone.output
    assert load_machine(tmp_path / "new" / "tuned.toml").digest == tuned.digest
    assert "extends" not in (tmp_path / "new" / "tuned.toml").read_text()
    assert content["loss"]["after"] < content["loss"]["before"]
    # What the file states is said by estimate until then.
    said = run("estimate", loud, tmp_path / "log.csv", "--out", tmp_path / "e.csv").stderr
    assert "the file states noise of 3 N" in said and "sgms-mhe tune" in said
    assert (
        "states noise"
        not in run("estimate", tmp_path / "tuned.toml", tmp_path / "log.csv", "--out", tmp_path / "e.csv").stderr
    )


def test_a_log_without_motion_is_refused(small: Path, tmp_path: Path) -> None:
    machine = load_machine(small)
    write_log(tmp_path / "short.csv", moved(machine, 0.1, 1.0))
    said = refused("tune", small, tmp_path / "short.csv", "--out", tmp_path / "t.toml")
    assert f"at least {LEAST_UPDATES}" in said
    assert not (tmp_path / "t.toml").exists()


def test_wild_readings_do_not_count_for_more_than_they_are(small: Path) -> None:
    machine = stated(small, 0.1)
    log = moved(machine, 0.1)
    wild = log.force_N.copy()
    wild[np.random.default_rng(0).integers(1000, len(wild), 5)] += 50.0
    estimator = CompiledEstimator(
        override_machine(machine, {"estimator": {"kind": "ekf", "noise": {"self_scaling": False}}})
    )
    changes: dict[str, Any] = vars(log) | {"force_N": wild}
    clean, dirty = estimator.estimate_log(log), estimator.estimate_log(Log(**changes))
    assert stated_noise(dirty) == pytest.approx(stated_noise(clean), rel=0.3)
    innovation, variance = counted_innovations(dirty, moving_updates(dirty))
    assert np.all(np.isfinite(innovation_loss(innovation, variance)))
    assert np.all(innovation**2 <= 25.0 * (1.0 + 1e-9) * variance)


def test_what_goes_on_alike_counts_in_the_motion() -> None:
    """The predicted motion is that of the innovations as forces; independent ones are as likely in either norm."""
    rng, n, updates = np.random.default_rng(4), 20000, 20
    white = rng.standard_normal(n)
    moved, variance = integrate_innovations(white, np.ones(n), updates)
    speed = np.cumsum(white[:updates])
    assert moved[0] == pytest.approx(np.sum(speed))  # semi-implicit Euler, period and mass of 1
    assert np.mean(moved**2 / variance) == pytest.approx(1.0, abs=0.1)
    coloured = np.convolve(white, np.full(10, 0.1**0.5), "same")
    moved, variance = integrate_innovations(coloured, np.ones(n), updates)
    assert np.mean(moved**2 / variance) > 4.0


@pytest.mark.slow
@pytest.mark.parametrize("objective", ["motion", "both"])
def test_weights_are_chosen_in_the_norm_that_is_asked(small: Path, tmp_path: Path, objective: Objective) -> None:
    """The likeliest weights of a norm are so in it; both errors are stated, with the units of the axis."""
    machine, path = stated(small, 2.0), tmp_path / "log.csv"
    log = moved(machine, 0.3)
    write_log(path, log)
    by_force, asked = (tune_log(machine, log, objective=norm) for norm in ("force", objective))
    assert asked.best.better_by(asked.start) > 2.0
    other = override_machine(machine, by_force.changes())
    again = tune(other, log, objective=objective)  # from the likeliest by the force
    assert again.best.mean <= again.start.mean
    said = json.loads(done("tune", small, path, "--objective", objective, "--json").stdout)
    about = [statement["about"] for statement in said["statements"]]
    assert {"error of the force, an update ahead", "error of the motion, 0.1 s ahead"} <= set(about)


def test_statements_have_the_files_weights_whatever_was_tried(small: Path) -> None:
    """A weight that is likelier at the file's value beside another one's change is still the file's."""
    machine = load_machine(small)
    loss = np.array([1.0, 1.0])
    start, best = Trial({}, loss, 1.0), Trial({"measurement": 0.3}, 0.5 * loss, 1.0)
    noise = machine.estimator.noise
    trials = {
        "measurement": ((0.3, best), (noise.measurement, start)),
        "state": ((noise.state, best), (2.0 * noise.state, start)),
        "horizon": ((float(machine.estimator.horizon), best), (40.0, best)),
    }
    tuned = Tuned(machine, start, best, None, trials, ("state",))
    stated = [(s.about, s.value, s.numbers["file"], s.sure) for s in tuned.statements if s.kind == "weight"]
    assert stated == [
        ("measurement", 0.3, noise.measurement, "yes"),
        ("state", noise.state, noise.state, "open"),
        ("horizon", float(machine.estimator.horizon), float(machine.estimator.horizon), "yes"),
    ]


def test_stretches_say_how_sure_a_gain_is() -> None:
    random = np.random.default_rng(2)
    loss = random.standard_normal(4000)
    a, b = Trial({}, loss, 1.0), Trial({}, loss + 0.1 * random.standard_normal(4000), 1.0)
    c = Trial({}, loss - 0.1 + 0.1 * random.standard_normal(4000), 1.0)
    assert abs(b.better_by(a)) < 3.0
    assert c.better_by(a) > 10.0 > -10.0 > a.better_by(c)


def test_too_few_updates_say_so(small: Path) -> None:
    machine = load_machine(small)
    estimates = CompiledEstimator(machine).estimate_log(moved(machine, 0.1, 1.0))
    assert math.isnan(stated_noise(estimates))


def test_help_names_the_command() -> None:
    assert "Noise weights and horizon from a log" in done("--help").stdout
