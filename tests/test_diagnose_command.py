"""`diagnose` and `plan` from end to end: a part of a log, an estimator on an unseen log, a plan that separates."""

import json
import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cli_cases import done, files, refused
from diagnosis_cases import assert_found, explained
from record_cases import simulate_log
from sgms_mhe.commands.diagnose import _text
from sgms_mhe.configuration import load_machine
from sgms_mhe.diagnosis import diagnose
from sgms_mhe.diagnosis.criteria import ProgressReport
from sgms_mhe.machine import Machine
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import Trajectory
from sgms_mhe.signals.logs import write_log

RIPPLE = {"amplitude_N": 0.5, "pitch_m": 0.0173, "phase_rad": 0.7}


def write_record(
    path: Path, machine: Machine, hidden: tuple[str, Mapping[str, float]], seconds: float, seed: int
) -> Path:
    write_log(path, simulate_log(machine, hidden, seconds=seconds, seed=seed))
    return path


def check_trace(folder: Path) -> None:
    """The way to the verdict can be followed: found, no rival as good, not doubted, within what may be left."""
    stages = {path.stem[3:]: json.loads(path.read_text())["decisions"] for path in sorted(folder.iterdir())}
    assert list(stages) == ["beginning", "record", "law", "search", "reduction", "rivals", "confirmation", "verdict"]
    first = stages["search"][0]
    assert first["added"] == "force_ripple"
    ripple = next(c for c in first["candidates"] if c["name"] == "force_ripple")
    assert ripple["p_value"] < first["significance"]
    assert ripple["refit_gain_N"] == max(c["refit_gain_N"] or 0.0 for c in first["candidates"])
    assert {d["outcome"] for d in stages["rivals"] if d.get("instead_of") == "force_ripple"} <= {"worse"}
    confirmed = {cause["name"]: cause["doubt"] for cause in stages["confirmation"][-1]["causes"]}
    assert confirmed == {"force_ripple": None}
    last = stages["verdict"][-1]
    assert last["outcome"] == "explained"
    assert last["beyond_noise_after_N"] < last["allowed_N"] < last["beyond_noise_before_N"]


@pytest.mark.slow
def test_diagnose_a_part_and_try_the_estimator_on_another_log(machine: Machine, tmp_path: Path) -> None:
    hidden = ("force_ripple", RIPPLE)
    log = write_record(tmp_path / "log.npz", machine, hidden, 9.0, 1)
    unseen = write_record(tmp_path / "unseen.npz", machine, hidden, 4.0, 2)
    out = tmp_path / "out"
    trace = ("--trace", out / "trace")
    result = done("diagnose", "etel_xy", log, "--to", "6", "--unseen", unseen, "--out", out, *trace)
    text = result.stdout
    assert text.startswith("explained: force_ripple")
    assert not result.stderr
    reduction = re.search(rf"estimator on {re.escape(str(unseen))}: .* N rms, (\d+) % less", text)
    assert reduction
    assert int(reduction[1]) > 50
    check_trace(out / "trace")
    extended = "etel_xy_force_ripple.toml"
    assert {"report.html", "diagnosis.json", extended} <= files(out)
    report = (out / "report.html").read_text()
    assert f"{log}, 0 to 6 s" in report
    assert "Estimator on a log it has not seen" in report
    assert "unseen.npz" in report
    assert re.search(r"Its error falls by \d\d[^\d]*% \(95[^\d]*%: \d", report)
    # What was learnt from the first six seconds holds in the last three.
    part = ("--out", tmp_path / "p.csv", "--from", "6", "--json")
    before = json.loads(done("predict", "etel_xy", log, *part).stdout)["residual_rms_N"]
    after = json.loads(done("predict", out / extended, log, *part).stdout)["residual_rms_N"]
    assert after < 0.3 * before


def test_shares_of_the_work_only_grow() -> None:
    told: list[float] = []
    course = ProgressReport(lambda _, share: told.append(share))
    course.report_start()
    course.report_base()
    for number in range(1, 5):
        course.report_search(number)
        course.report_refits(number, ["force_ripple"])
    for number in range(1, 4):
        for share in (0.0, 0.5):
            course.report_rivals(number, share, "viscous", ["force_ripple"])
    course.report_judgement()
    assert told[0] == 0.0
    assert told == sorted(set(told))
    assert told[-1] < 1.0


def test_diagnose_refuses_a_part_that_is_none(machine: Machine, tmp_path: Path) -> None:
    log = write_record(tmp_path / "log.npz", machine, ("force_ripple", RIPPLE), 1.0, 1)
    message = refused("diagnose", "etel_xy", log, "--from", "2", "--out", tmp_path / "out")
    assert "rows from 2 to 0.9999 s = 0: at least 2 rows within 0 to 0.9999 s" in message
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        pytest.param("constant_offset", {"force_N": 0.4}, id="offset"),
        pytest.param("asymmetric_coulomb", {"ratio": 0.1}, id="level"),
    ],
)
def test_plan_separates_an_offset_from_an_asymmetric_level(
    machine: Machine, tmp_path: Path, name: str, parameters: dict[str, float]
) -> None:
    path = tmp_path / "plan.csv"
    text = done("plan", "etel_xy", "--separate", "constant_offset", "asymmetric_coulomb", "--out", path).stdout
    assert "loops below break-away: an offset shifts them, an asymmetric level does not" in text
    time, position = np.loadtxt(path, delimiter=",", skiprows=1, unpack=True)
    np.testing.assert_allclose(np.diff(time), machine.sampling.step, rtol=1e-6)
    run = simulate_axis(
        machine,
        Trajectory("planned", machine.sampling.rate, position),
        AxisConfig(seed=3),
        hidden_effects=[(name, parameters)],
        truth=False,
    )
    diagnosis = diagnose(machine, run.log)
    assert_found(diagnosis, {name: {k: pytest.approx(value, rel=0.02) for k, value in parameters.items()}}, "explained")


def test_a_number_that_was_chosen_has_no_interval(small: Path) -> None:
    diagnosis = explained(load_machine(small))
    cause = diagnosis.causes[0]
    chosen, *others = cause.parameters
    shown = replace(diagnosis, causes=(replace(cause, std={**cause.std, chosen: math.nan}), *diagnosis.causes[1:]))
    said, fitted = _text(shown, Path("out"), None, None), _text(diagnosis, Path("out"), None, None)
    assert "nan" not in said and f"{chosen} = " in said and others
    assert said.count("+-") == fitted.count("+-") - 1
