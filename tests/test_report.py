"""The report of a diagnosis: whole, valid, without a network, and right in what it says."""

import base64
import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import diagnosis_cases as cases
from cli_cases import done
from record_cases import simulate_log
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.diagnosis import Alternative, BaseParameter, Cause, Diagnosis, Rms
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import BASE_CAUSES, cause, cause_names, effect_definition, reported_name
from sgms_mhe.report import closed_loop_gain, write_report
from sgms_mhe.report.series import MISSING, pack, since_reversal, views
from sgms_mhe.report.units import SPACE, force, probability, quantity, split_name
from sgms_mhe.report.words import base_words, capital, sentence
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.statements import Rule, Statement, list_open

CASES: dict[str, Callable[[Machine], Diagnosis]] = {
    "explained": cases.explained,
    "adequate": cases.adequate,
    "ambiguous": cases.ambiguous,
    "unexplained": cases.unexplained,
    "motionless": cases.motionless,
}
VOID = {"meta", "br", "img", "link", "input", "hr"}


class Page(HTMLParser):
    """Checks that tags nest; collects text, links, sources and the embedded data."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.text: list[str] = []
        self.addresses: list[str] = []
        self.canvases: list[str] = []
        self.identifiers: list[str] = []
        self.data = ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.addresses += [value for name, value in attrs if name in ("href", "src", "srcset", "action") and value]
        if given.get("id"):
            self.identifiers.append(str(given["id"]))
        if tag == "canvas":
            self.canvases.append(str(given["data-plot"]))
            assert given["role"] == "img"
            assert given["aria-label"]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open[-1:] == ["script"]:
            self.data = self.data or data
        elif self.open[-1:] != ["style"]:
            self.text.append(data)

    @property
    def words(self) -> str:
        return " ".join(" ".join(self.text).replace(SPACE, " ").split())


def read(path: Path) -> Page:
    return Page(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", CASES)
def test_report_is_one_valid_page_without_a_network(name: str, machine: Machine, tmp_path: Path) -> None:
    path = write_report(CASES[name](machine), tmp_path / "new" / "folder")
    assert path == tmp_path / "new" / "folder" / "report.html"
    source = path.read_text(encoding="utf-8")
    assert not re.search(r"https?://|//cdn|@import|url\(", source)
    page = Page(source)
    for address in page.addresses:  # whatever it links to lies beside it
        assert (path.parent / address).is_file(), address
    assert len(set(page.identifiers)) == len(page.identifiers)
    plots = json.loads(page.data)["plots"]
    assert set(page.canvases) == set(plots)
    assert all(plot["series"] and plot["xLabel"] and plot["yLabel"] for plot in plots.values())
    assert (name if name != "motionless" else "not excited") in page.words
    assert "nan" not in page.words.lower().split()


def test_same_diagnosis_gives_the_same_bytes(machine: Machine, tmp_path: Path) -> None:
    first, second = (write_report(cases.explained(machine), tmp_path / k).parent for k in "ab")
    for path in first.iterdir():
        assert path.read_bytes() == (second / path.name).read_bytes(), path.name


def test_failure_leaves_the_old_report(machine: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_report(cases.adequate(machine), tmp_path)
    before = path.read_bytes()

    def fail(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("sgms_mhe.report.page.plots", fail)
    with pytest.raises(KeyboardInterrupt):
        write_report(cases.explained(machine), tmp_path)
    assert path.read_bytes() == before
    assert not list(tmp_path.glob(".*"))


def test_explained_says_cause_numbers_and_file(machine: Machine, tmp_path: Path) -> None:
    diagnosis = cases.explained(machine)
    page = read(write_report(diagnosis, tmp_path))
    words = page.words
    assert "Found: force periodic in position (0.797 ± 0.012 N)." in words
    assert diagnosis.summary == diagnosis.statements[0].sentence and diagnosis.summary in words
    assert "Confirm it on another record" in words
    assert "sgms-mhe predict etel_xy_force_ripple.toml ANOTHER_LOG" in words
    assert "0.797 ± 0.012 N" in words
    assert "32.003 ± 0.042 mm" in words
    assert "Force periodic in position" in words
    assert "0.548 to 0.577 N" in words
    assert "120 of 6000 samples are missing" in words
    assert "etel_xy_force_ripple.toml" in page.addresses
    toml = diagnosis.extended_file(tmp_path)
    assert toml is not None
    assert " ".join(toml.split()) in words
    assert (tmp_path / "etel_xy_force_ripple.toml").read_text() == toml


def test_a_cause_that_noise_looks_like_is_not_found(machine: Machine, tmp_path: Path) -> None:
    sure = cases.explained(machine)
    doubted = replace(sure, causes=tuple(replace(cause, p_value=0.98) for cause in sure.causes))
    assert doubted.standing == "limited" and not any(map(doubted.identifies, doubted.causes))
    words = read(write_report(doubted, tmp_path)).words
    number = "force periodic in position (0.797 ± 0.012 N)"
    assert f"Not certain: {number}." in words and "Found:" not in words
    assert "noise looks like it with a chance of 0.98" in words and "Chance that noise looks like this: 0.98" in words
    assert "explained, with limits" in words


def test_ambiguous_shows_the_rival_and_the_next_step(machine: Machine, tmp_path: Path) -> None:
    words = read(write_report(cases.ambiguous(machine), tmp_path)).words
    assert "axis.csv Constant force, independent of motion or Coulomb level different in the two directions?" in words
    assert "Found:" not in words
    choice = "Constant force, independent of motion, or Coulomb level different in the two directions?"
    move = "Loops below break-away: an offset shifts them, an asymmetric level does not."
    command = "sgms-mhe plan etel_xy --separate constant_offset asymmetric_coulomb --out plan.csv"
    assert f"What this record cannot decide {choice} {move} {command}" in words
    assert "constant_offset: another cause fits as well." in words
    assert "In place of constant force, independent of motion: ratio 10.2 %" in words
    assert "Next step Record one of the moves above" in words


def test_a_rival_is_shown_with_its_fit_and_what_it_leaves(machine: Machine, tmp_path: Path) -> None:
    diagnosis = cases.ambiguous(machine)
    (rival,) = diagnosis.rival_fits
    page = read(write_report(diagnosis, tmp_path))
    assert "In place of constant force, independent of motion: ratio 10.2 %" in page.words
    for words, left in (
        ("constant force, independent of motion", diagnosis.rms.held_out_after),
        ("Coulomb level different in the two directions", rival.held_out_rms_N),
    ):
        assert f"With {words} {force(left)}".replace(SPACE, " ") in page.words
    plots = json.loads(page.data)["plots"]
    shown = plots["rival_1_residual"]["series"]
    packed = next(series["packed"] for series in shown if series["role"] == "rival")
    integers = np.frombuffer(base64.b64decode(packed["data"]), dtype="<i2")
    used = diagnosis.traces.used
    back = packed["offset"] + packed["scale"] * integers
    np.testing.assert_allclose(back[used], rival.residual_N[used], atol=packed["scale"])
    assert (integers[~used] == MISSING).all()
    means = {series["role"]: series for series in plots["rival_1_velocity"]["series"] if "x" in series}
    # What the rival gets wrong follows the sign of velocity; the cause's residual does not.
    assert np.mean(np.sign(means["rival"]["x"]) * means["rival"]["y"]) > 0.015
    assert abs(np.mean(np.sign(means["after"]["x"]) * means["after"]["y"])) < 0.01


@pytest.mark.parametrize("name", CASES)
def test_nothing_is_called_significant_that_is_nothing(name: str, machine: Machine, tmp_path: Path) -> None:
    words = read(write_report(CASES[name](machine), tmp_path)).words
    assert "No candidate was tried" not in words
    assert "Depends on" not in words or name != "adequate"
    assert not re.search(r"(?<![\d.])0\.000 N(?! RMS)", words)


def test_limits_of_any_wording_are_shown(machine: Machine, tmp_path: Path) -> None:
    words = read(write_report(cases.explained(machine), tmp_path)).words
    assert "What this record cannot decide Stiffness of element 4: the record does not show it." in words
    assert "cannot decide" not in read(write_report(cases.certain(cases.explained(machine)), tmp_path)).words


def vague_cause(name: str, machine: Machine, rms: Rms) -> Cause:
    """A cause none of whose numbers the record determines."""
    elements = machine.friction.n_z
    if name in BASE_CAUSES:
        numbers = [reported_name(c) for n in BASE_CAUSES[name].numbers for c in n.columns(elements)]
    else:
        numbers = [p.name for p in effect_definition(name).parameters]
    nominal = dict.fromkeys(numbers, 1.0) if name in BASE_CAUSES else {}
    std = dict.fromkeys(numbers, math.nan)
    return Cause(
        name,
        f"{name}_2",
        dict.fromkeys(numbers, 0.7),
        std,
        nominal,
        rms,
        0.4,
        (0.3, 0.5),
        1e-9,
        vague=tuple(numbers),
        stands_for="curve over speed" if cause(name).over_speed else "",
    )


@pytest.mark.parametrize("axis", ["etel_xy", "etel_xy_rotary"])
def test_every_cause_with_limits_and_rivals_has_a_report(axis: str, tmp_path: Path) -> None:
    machine = load_machine(axis)
    first = cases.ambiguous(machine)
    names = cause_names(machine.plant.kind)
    found = tuple(vague_cause(name, machine, first.rms) for name in names)
    rivals = [
        Alternative(r, f"fits as {name}", True, name, {}, 0.0) for name in names for r in cause(name).confused_with
    ]
    columns = [c for base in BASE_CAUSES.values() for n in base.numbers for c in n.columns(machine.friction.n_z)]
    said = [*(f"{name}: may begin a sentence" for name in (*names, *columns)), "no name: here", ": nor here"]
    diagnosis = replace(
        first,
        verdict="unexplained",
        causes=found,
        alternatives=tuple(rivals),
        rival_fits=(),
        base=tuple(BaseParameter(c, 1.0, 1.0, math.nan) for c in columns),
        undecided=tuple(Statement(Rule.ONE_SPEED, text) for text in said),
    )
    words = read(write_report(diagnosis, tmp_path)).words
    for statement in list_open(diagnosis.statements):
        if statement.rule is not Rule.UNSEEN and statement.kind != "choice":
            assert sentence(statement.sentence) in words
    words = read(write_report(replace(diagnosis, causes=()), tmp_path)).words
    for column in columns:
        assert f"{capital(base_words(column))}: the record does not show it." in words


@pytest.mark.parametrize("name", ["plots", "views"])
def test_a_report_that_fails_costs_no_verdict(
    name: str, machine: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(*_: Any) -> None:
        raise ZeroDivisionError("of a plot")

    monkeypatch.setattr(f"sgms_mhe.report.page.{name}", fail)
    monkeypatch.setattr("sgms_mhe.diagnosis.diagnose", lambda *_, **__: cases.explained(machine))
    time = np.arange(2000) / 1e3
    log = tmp_path / "log.csv"
    np.savetxt(
        log,
        np.column_stack((time, 0.01 * np.sin(9.0 * time), 5.0 * np.cos(9.0 * time))),
        delimiter=",",
        header="time_s,position_m,force_N",
        comments="",
    )
    monkeypatch.setattr("sgms_mhe.logfiles.plausibility.check_plausible", lambda *_: None)
    (tmp_path / "axis.toml").write_text(
        'extends = "etel_xy"\nname = "axis"\n[sampling]\nrate = 1000.0\nvelocity_cutoff = 100.0\n'
    )
    arguments = ("--quiet", "diagnose", tmp_path / "axis.toml", log, "--out", tmp_path / "out")
    with caplog.at_level("DEBUG", "sgms_mhe.report"):
        result = done(*arguments)
    assert result.stdout.startswith("explained: force_ripple: the residual")
    assert "report:" not in result.stdout
    assert "no report: ZeroDivisionError: of a plot" in result.stderr
    assert "Traceback" not in result.stderr
    assert caplog.records[0].exc_info is not None
    assert json.loads((tmp_path / "out" / "diagnosis.json").read_text())["verdict"] == "explained"
    assert json.loads(done(*arguments, "--json").stdout)["verdict"] == "explained"


@pytest.mark.parametrize("standalone", [False, True])
def test_an_extended_machine_stands_alone_if_asked(
    standalone: bool, machine: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file and its text on the page, through the command."""
    found = cases.explained(machine)
    monkeypatch.setattr("sgms_mhe.diagnosis.diagnose", lambda *_, **__: found)
    monkeypatch.setattr("sgms_mhe.logfiles.plausibility.check_plausible", lambda *_: None)
    time = np.arange(20_000) / 1e4
    log = np.column_stack((time, 0.01 * np.sin(9.0 * time), 5.0 * np.cos(9.0 * time)))
    np.savetxt(tmp_path / "log.csv", log, delimiter=",", header="time_s,position_m,force_N", comments="")
    done("diagnose", "etel_xy", tmp_path / "log.csv", "--out", tmp_path, *["--standalone"][: int(standalone)])
    toml = (tmp_path / "etel_xy_force_ripple.toml").read_text()
    assert ("extends" not in toml) is standalone
    assert found.extended is not None
    assert load_machine(tmp_path / "etel_xy_force_ripple.toml").digest == found.extended.digest
    assert " ".join(toml.split()) in read(tmp_path / "report.html").words


def test_a_choice_is_told_once_whatever_its_sentence(machine: Machine, tmp_path: Path) -> None:
    """A cause by its label, and a limit that begins as the choice's sentence does."""
    first = cases.ambiguous(machine)
    cause, rival = next((a.instead_of, a.name) for a in first.alternatives if a.rival and a.instead_of)
    about = f"{cause} or {rival}"
    also = Statement(Rule.SMOOTHED, about, 0.4, numbers={"percent": 80.0, "size": "amplitude_N"})
    page = read(write_report(replace(first, undecided=(also,)), tmp_path))
    assert page.words.count(also.sentence[1:]) == 1
    (choice,) = (s for s in first.statements if s.kind == "choice")
    assert choice.about == about and choice.sentence in first.limits


def test_numbers_of_the_machine_file_are_named_in_words(machine: Machine, tmp_path: Path) -> None:
    # A cause is no rival of itself, and an effect that the machine has is not found: it has another value.
    first = cases.ambiguous(machine)
    offset = replace(first.causes[0], nominal={"force_N": -3.1648})
    name = offset.name
    spring = Alternative("position_spring", f"fits as well as {name}", True, name, {"stiffness_N_m": 3.3}, 0.0)
    itself = Alternative(name, "named; fits as well as position_spring", True, None, {}, 0.0)
    ripple = cases.explained(machine).causes[0]
    diagnosis = replace(first, causes=(ripple, offset), alternatives=(spring, itself))
    words = read(write_report(diagnosis, tmp_path)).words
    assert "Found: force periodic in position (0.797 ± 0.012 N)." in words
    assert "Constant force, independent of motion or force proportional to position?" in words
    assert words.count("Constant force, independent of motion, or force proportional to position?") == 1
    assert "another value than the machine file's" in words
    assert "−3.16 N 0.410 ± 0.040 N" in words
    assert "The same move at two ends of the travel." in words


def test_unexplained_names_the_coordinate_and_offers_no_file(machine: Machine, tmp_path: Path) -> None:
    page = read(write_report(cases.unexplained(machine), tmp_path))
    assert "Something is left that no known effect accounts for." in page.words
    assert "What is left depends most on position" in page.words
    assert "Extended machine file" not in page.words
    assert not list(tmp_path.glob("*.toml"))


def test_text_of_the_user_is_escaped(machine: Machine, tmp_path: Path) -> None:
    diagnosis = cases.explained(machine, source="</script><b>x.csv", warnings=("<img src=x>",))
    page = read(write_report(diagnosis, tmp_path))
    assert "</script><b>x.csv" in page.words
    assert "x" not in page.addresses


# --- series ---------------------------------------------------------------------------------------------------------


def test_packed_arrays_come_back() -> None:
    values = np.array([1.5, np.nan, -3.25, 7.0, 0.0])
    packed = pack(values)
    integers = np.frombuffer(base64.b64decode(packed["data"]), dtype="<i2")
    back = np.where(integers == MISSING, np.nan, packed["offset"] + packed["scale"] * integers)
    np.testing.assert_allclose(back, values, atol=10.25 / 65534)
    assert packed["scale"] > 0.0
    assert pack(np.full(3, np.nan))["scale"] == 1.0


def test_bin_means_show_the_ripple_before_and_nothing_after() -> None:
    shown = {view.key: view for view in views(cases.traces())}
    position = shown["position"]
    assert position.unit == "mm"
    expected = cases.AMPLITUDE * np.sin(2e-3 * np.pi * position.centres / cases.PITCH + 0.6)
    # A bin is an eighth of a pitch wide: its mean is a little less than the ripple.
    np.testing.assert_allclose(position.mean_before, expected, atol=0.2)
    assert np.abs(position.mean_after).max() < 0.1
    spectrum = shown["frequency"]
    assert spectrum.mean_before.max() > 10.0 * spectrum.mean_after.max()


def test_way_since_reversal_restarts_at_every_turn() -> None:
    shown = cases.traces()
    way = since_reversal(shown)
    turns = np.flatnonzero(np.diff(np.sign(shown.velocity_m_s)) != 0)
    assert np.isnan(way[: turns[0]]).all()
    for turn in turns:
        assert np.nanmin(way[turn : turn + 4]) < 1e-4
    assert np.nanmax(way) == pytest.approx(np.ptp(shown.position_m), rel=0.2)


# --- units ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "std", "text"),
    [
        ("amplitude_N", 0.79, 0.012, "0.790 ± 0.024 N"),
        ("amplitude_N", 0.0042, math.nan, "4.20 mN"),
        ("pitch_m", 0.03201, 1e-5, "32.010 ± 0.020 mm"),
        ("gap_m", 3.2e-6, 1e-7, "3.20 ± 0.20 µm"),
        ("delay_s", 4.7e-5, 2e-6, "47.0 ± 4.0 µs"),
        ("stiffness_1_N_m", 120e3, 2e3, "120.0 ± 4.0 N/mm"),
        ("stiffness_2", 25e3, math.nan, "25.0 N/mm"),
        ("coefficient_N_s2_m2", -1.5, 0.1, "−1.50 ± 0.20 N s²/m²"),
        ("ratio", 0.081, 0.004, "8.10 ± 0.80 %"),
        ("phase_rad", math.pi / 2, 0.01, "90.0 ± 1.1 °"),
        ("corner_velocity_m_s", 0.5, 0.01, "500 ± 20 mm/s"),
        ("viscous", 203.5, 1.2, "203.5 ± 2.4 N s/m"),
        ("gain", 1.05, 0.01, "1.050 ± 0.020"),
        ("mass_kg", 0.0, 0.5, "0.0 ± 1.0 kg"),
        ("force_N", math.nan, 0.5, "–"),
    ],
)
def test_quantities_read_as_an_engineer_writes_them(name: str, value: float, std: float, text: str) -> None:
    assert str(quantity(name, value, std)).replace(SPACE, " ") == text


def test_numbers_in_words() -> None:
    assert split_name("coefficient_N_s2_m2") == ("coefficient", "N s²/m²")
    assert force(-0.1234).replace(SPACE, " ") == "−0.123 N"
    assert force(math.nan) == "–"
    assert [probability(p) for p in (0.3, 2.4e-4, 1e-30, math.nan)] == ["0.30", "2·10⁻⁴", "< 10⁻¹²", "–"]


# --- the loop closed ------------------------------------------------------------------------------------------------


def test_extended_estimator_predicts_better_where_the_effect_is(machine: Machine) -> None:
    ripple = {"amplitude_N": 0.8, "pitch_m": 0.032, "phase_rad": 0.6}
    log = simulate_log(machine, ("force_ripple", ripple), path="trapezoids", seconds=5.0, seed=4)
    extended = override_machine(machine, {"name": "extended", "effects": [{"name": "force_ripple", **ripple}]})
    gain = closed_loop_gain(machine, extended, log)
    assert gain.extended.predicted_rms_N < 0.5 * gain.base.predicted_rms_N
    assert 0.5 < gain.reduction_interval[0] <= gain.reduction <= gain.reduction_interval[1] < 1.0
    assert gain.base.filtered_rms_N < gain.base.predicted_rms_N
    assert [p.name for p in gain.base.parameters] == [f"stiffness_{k}" for k in (1, 2, 3, 4)]
    assert gain.base.refused == 0.0
    same = closed_loop_gain(machine, machine, log)
    assert same.reduction == 0.0


def test_log_that_no_estimator_can_use_is_refused(machine: Machine) -> None:
    with pytest.raises(InputError, match="at least one second"):
        closed_loop_gain(machine, machine, simulate_log(machine, path="paper", seconds=0.5, seed=4))
