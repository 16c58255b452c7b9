"""The benchmark of diagnoses: fair draws, right scores, runs that go on, and a seeded part of it for real."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sgms_bench.diagnosis.axes import DrawnAxis, draw_axis, machine_file
from sgms_bench.diagnosis.causes import Hidden, prescribed_signals, sized_cause
from sgms_bench.diagnosis.draws import (
    KINDS,
    VISIBLE,
    Draw,
    _draw_unmodelled,
    _Frame,
    machine_of,
    make_draw,
    simulate_draw,
    unmodelled_force,
)
from sgms_bench.diagnosis.faults import FAULTS
from sgms_bench.diagnosis.motions import STYLES, WEAK_STYLES, draw_motion
from sgms_bench.diagnosis.running import diagnose_draw, run_diagnosis_benchmark, run_draw
from sgms_bench.diagnosis.scoring import (
    ScoredDiagnosis,
    confusion_table,
    half_found,
    is_confidently_wrong,
    outcome,
    parameter_errors,
    summarise,
    summary_json,
    summary_text,
)
from sgms_bench.diagnosis.unmodelled import CURVES, SMOOTH_CURVES, UNMODELLED, curves_over_speed
from sgms_mhe.configuration import load_machine
from sgms_mhe.diagnosis import verdict
from sgms_mhe.diagnosis.fits import fit_model
from sgms_mhe.diagnosis.rivals import Selection
from sgms_mhe.diagnosis.selection import Searched
from sgms_mhe.logfiles.plausibility import check_plausible
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import BASE_CAUSES, EFFECT_NAMES, cause
from sgms_mhe.model.scales import scales_of
from sgms_mhe.recordings.excitation import measure_excitation
from sgms_mhe.signals.chain import signals_from_log
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import ImplausibleError

SEED = 1


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("etel_xy")


@pytest.fixture(scope="module")
def draws(machine: Machine) -> list[Draw]:
    return [make_draw(machine, SEED, index) for index in range(20)]


# --- draws ----------------------------------------------------------------------------------------------------------


def test_a_draw_depends_on_seed_and_index_alone(machine: Machine, draws: list[Draw]) -> None:
    again = make_draw(machine, SEED, 12)
    assert again == draws[12]
    assert make_draw(machine, SEED + 1, 12) != again
    assert Draw.from_json(json.loads(json.dumps(again.to_json()))) == again


def test_kinds_are_balanced_and_every_name_comes_up(draws: list[Draw]) -> None:
    assert [d.kind for d in draws] == list(KINDS)
    assert {kind: KINDS.count(kind) for kind in KINDS} == {
        "single": 7, "clean": 4, "base": 2, "double": 2, "triple": 1, "unmodelled": 2, "weak": 1, "fault": 1,
    }  # fmt: skip
    for draw in draws:
        counts = {"single": 1, "base": 1, "double": 2, "triple": 3, "unmodelled": 1, "clean": 0, "fault": 1}
        assert len(draw.hidden) == counts.get(draw.kind, len(draw.hidden))
        others = {"base": tuple(BASE_CAUSES), "unmodelled": tuple(UNMODELLED), "fault": tuple(FAULTS)}
        names = others.get(draw.kind, EFFECT_NAMES)
        assert all(h.name in names for h in draw.hidden)
    # Of one kind no name comes twice before all have come once.
    singles = [d.hidden[0].name for d in draws if d.kind == "single"]
    assert len(set(singles)) == len(singles)


def test_hidden_causes_are_sized_excited_and_visible(machine: Machine, draws: list[Draw]) -> None:
    for draw in draws:
        if draw.kind not in ("single", "double"):
            continue
        axis = machine_of(machine, draw)
        log, _ = simulate_draw(machine, draw)
        found = measure_excitation(signals_from_log(log, axis), axis)
        for hidden in draw.hidden:
            assert 0.01 < hidden.size < 0.6
            assert hidden.visible >= VISIBLE
            assert cause(hidden.name).excitation.unmet(found, hidden.parameters) == ()


def test_size_of_a_ripple_is_its_amplitude(machine: Machine) -> None:
    random = np.random.default_rng(4)
    motion = draw_motion("strokes", machine, 8.0, random)
    plain = prescribed_signals(machine, motion, Hidden(""))
    for size in (0.05, 0.3):
        sized = sized_cause(machine, motion, plain, "force_ripple", size, random)
        assert sized is not None
        amplitude = sized[0].parameters["amplitude_N"] / machine.friction.coulomb
        assert sized[0].size == pytest.approx(amplitude, rel=0.03)
        assert sized[0].size == pytest.approx(size, rel=0.1)


@pytest.mark.parametrize("style", [*STYLES, *WEAK_STYLES])
def test_motions_do_what_their_style_says(machine: Machine, style: str) -> None:
    motion = draw_motion(style, machine, 8.0, np.random.default_rng(3))
    assert motion.duration_s == pytest.approx(8.2, abs=0.01)
    assert np.abs(motion.velocity_m_s).max() <= machine.sampling.max_velocity
    forward, back = motion.velocity_m_s.max(), -motion.velocity_m_s.min()
    if style == "still":
        assert forward == back == 0.0
    elif style == "presliding":
        assert np.ptp(motion.position_m) < 0.5 * scales_of(machine).deflection
    elif style in ("one_way", "crawl"):
        assert forward > 2.0 * machine.friction.stribeck_velocity
        assert back < 1e-9
        if style == "crawl":  # position and time are one clock
            moving = motion.velocity_m_s[round(0.5 * motion.rate) : -round(0.3 * motion.rate)]
            assert np.ptp(moving) < 1e-6 * forward
    else:
        assert min(forward, back) > 0.2 * machine.sampling.max_velocity
        assert np.abs(motion.acceleration_m_s2[:-1]).max() < 15.0 * machine.sampling.max_velocity


@pytest.mark.parametrize("name", UNMODELLED)
def test_unmodelled_forces_have_their_size_and_stay_out_of_the_motion(
    machine: Machine, draws: list[Draw], name: str
) -> None:
    draw = replace(next(d for d in draws if d.kind == "unmodelled"), hidden=(Hidden(name, size=0.2),), seconds=6.0)
    force = unmodelled_force(machine, draw, draw.hidden[0])
    peak = np.quantile(np.abs(force[len(force) // 50 :]), 0.98)
    assert peak == pytest.approx(0.2 * machine.friction.coulomb, rel=1e-9)
    log, _ = simulate_draw(machine, draw)
    clean, _ = simulate_draw(machine, replace(draw, kind="clean", hidden=()))
    np.testing.assert_array_equal(log.position_m, clean.position_m)
    np.testing.assert_allclose(log.force_N - clean.force_N, force, atol=1e-12)
    assert draw.truth == (("friction_curve",) if name in CURVES else ())


@pytest.mark.parametrize("name", SMOOTH_CURVES)
def test_unmodelled_curves_over_speed_are_none_of_the_catalogue(machine: Machine, name: str) -> None:
    """What no sum of its curves takes over has to be seen, or nothing but the sum could be right."""
    random = np.random.default_rng(5)
    number = list(UNMODELLED).index(name)
    frame = _Frame(machine, SEED, number, random)
    draws = (_draw_unmodelled(frame, frame.draw("unmodelled", "workout"), number) for _ in range(25))
    draw = next(draw for draw in draws if draw)
    (hidden,) = draw.hidden
    axis = machine_of(machine, draw)
    left = hidden.visible * float(np.sqrt(np.mean(unmodelled_force(machine, draw, hidden) ** 2)))
    assert left >= max(0.01 * axis.friction.coulomb, 0.5 * draw.force_noise_N)
    v = np.geomspace(1e-3, 0.8, 500)
    v = np.concatenate((-v[::-1], v))
    force = UNMODELLED[name](np.random.default_rng(1), v, v, v)
    X = np.column_stack((np.sign(v), v, curves_over_speed(v)))
    rest = force - X @ np.linalg.lstsq(X, force, rcond=None)[0]
    assert 0.002 < np.std(rest) / np.std(force) < 0.2  # nearly a sum of them, and none


def test_noise_is_known_where_nothing_distorts_the_log(machine: Machine, draws: list[Draw]) -> None:
    clean = next(d for d in draws if d.kind == "clean")
    _, noise = simulate_draw(machine, clean)
    assert 0.0 < noise < 0.1 * machine.friction.coulomb
    _, unknown = simulate_draw(machine, next(d for d in draws if d.kind == "single"))
    assert math.isnan(unknown)


# --- scores ---------------------------------------------------------------------------------------------------------


def drawn(kind: str, *names: str, size: float = 0.2) -> Draw:
    hidden = tuple(Hidden(name, {"force_N": 0.5} if name == "constant_offset" else {}, size=size) for name in names)
    return Draw(0, kind, DrawnAxis("linear", False, "sgms"), hidden, {}, "workout", 10.0, 1, 0.1, 0.0, 1e-9, 1)


def said(verdict: str, *names: str, rivals: Sequence[tuple[str, str | None]] = ()) -> ScoredDiagnosis:
    return ScoredDiagnosis(
        verdict, tuple((name, {}, {}) for name in names), tuple(rivals), has_experiment=verdict == "ambiguous"
    )


OFFSET, COULOMB = "constant_offset", "asymmetric_coulomb"


@pytest.mark.parametrize(
    ("draw", "found", "how"),
    [
        (drawn("single", OFFSET), said("explained", OFFSET), "named"),
        (drawn("single", OFFSET), said("explained", COULOMB), "misnamed"),
        (drawn("single", OFFSET), said("explained", OFFSET, COULOMB), "extra"),
        (drawn("single", OFFSET), said("unexplained", OFFSET), "named"),
        (drawn("single", OFFSET), said("adequate"), "missed"),
        (drawn("single", OFFSET), said("unexplained"), "unexplained"),
        (drawn("single", OFFSET), said("ambiguous", OFFSET, rivals=[(COULOMB, OFFSET)]), "ambiguous"),
        (drawn("single", OFFSET), said("ambiguous", COULOMB, rivals=[(OFFSET, COULOMB)]), "ambiguous"),
        (drawn("single", OFFSET), said("ambiguous", COULOMB, rivals=[("coulomb", COULOMB)]), "misnamed"),
        # To list everything is to tell nothing.
        (drawn("single", OFFSET), said("ambiguous", COULOMB, rivals=[(n, None) for n in EFFECT_NAMES]), "misnamed"),
        # Without an experiment it is no honest ambiguity.
        (
            drawn("single", OFFSET),
            replace(said("ambiguous", COULOMB, rivals=[(OFFSET, None)]), has_experiment=False),
            "misnamed",
        ),
        (drawn("double", OFFSET, "force_ripple"), said("explained", "force_ripple", OFFSET), "named"),
        (drawn("double", OFFSET, "force_ripple"), said("explained", OFFSET), "partial"),
        (drawn("double", OFFSET, "force_ripple"), said("explained", OFFSET, "viscous"), "misnamed"),
        (
            drawn("double", OFFSET, "force_ripple"),
            said("ambiguous", COULOMB, "force_ripple", rivals=[(OFFSET, COULOMB)]),
            "ambiguous",
        ),
        (drawn("clean"), said("adequate"), "right"),
        (drawn("clean"), said("unexplained"), "unexplained"),
        (drawn("clean"), said("explained", "viscous"), "invented"),
        (drawn("unmodelled", "bursts"), said("unexplained"), "unexplained"),
        (drawn("unmodelled", "bursts"), said("adequate"), "missed"),
        (drawn("unmodelled", "bursts"), said("unexplained", "force_ripple"), "misnamed"),
        (drawn("unmodelled", "log_of_speed"), said("explained", "friction_curve"), "named"),
        (drawn("unmodelled", "log_of_speed"), said("explained", "friction_curve", "viscous"), "misnamed"),
        (drawn("unmodelled", "bursts"), said("explained", "friction_curve"), "misnamed"),
        # What may stand for something else is not named for certain, whether it is there or not.
        (
            drawn("unmodelled", "log_of_speed"),
            replace(said("unexplained", "viscous"), doubted=("viscous",)),
            "unexplained",
        ),
        (
            drawn("single", "quadratic_drag"),
            replace(said("unexplained", "viscous"), doubted=("viscous",)),
            "unexplained",
        ),
        (drawn("weak", OFFSET), said("ambiguous", COULOMB, rivals=[(OFFSET, COULOMB)]), "right"),
        (drawn("weak", OFFSET), said("explained", OFFSET), "overclaimed"),
        (drawn("weak", OFFSET), said("explained", COULOMB), "misnamed"),
        (drawn("weak"), said("adequate"), "right"),
        (drawn("triple", OFFSET, COULOMB, "force_ripple"), said("explained", OFFSET, COULOMB, "force_ripple"), "named"),
        (drawn("triple", OFFSET, COULOMB, "force_ripple"), said("explained", OFFSET, "force_ripple"), "partial"),
        (drawn("fault", "force_of_other_sign"), ScoredDiagnosis("unexplained", refused="position.csv: force"), "right"),
        (drawn("fault", "force_of_other_sign"), said("unexplained"), "right"),
        (drawn("fault", "force_of_other_sign"), said("explained", "mass_mismatch"), "misnamed"),
        (drawn("fault", "force_of_other_sign"), said("adequate"), "missed"),
        (drawn("clean"), ScoredDiagnosis("unexplained", refused="position.csv: force"), "refused"),
        (drawn("single", OFFSET), ScoredDiagnosis("", error="ValueError: no"), "error"),
    ],
)
def test_outcomes(draw: Draw, found: ScoredDiagnosis, how: str) -> None:
    assert outcome(draw, found) == how


@pytest.mark.parametrize(
    ("draw", "found", "wrong"),
    [
        (drawn("single", OFFSET), said("explained", OFFSET), False),
        (drawn("single", OFFSET), said("explained", COULOMB), True),
        (drawn("single", OFFSET), said("explained", OFFSET, COULOMB), True),
        (drawn("single", OFFSET), said("ambiguous", COULOMB, rivals=[("coulomb", COULOMB)]), False),
        (drawn("single", OFFSET), said("unexplained", COULOMB), False),
        (drawn("double", OFFSET, "force_ripple"), said("explained", OFFSET), False),
        (drawn("clean"), said("explained", "viscous"), True),
        (drawn("unmodelled", "bursts"), said("explained", "force_ripple"), True),
        (drawn("weak", OFFSET), said("explained", OFFSET), True),  # by luck
        (drawn("weak", OFFSET), said("adequate"), False),
        (drawn("fault", "force_of_other_sign"), said("adequate"), True),
        (drawn("fault", "force_of_other_sign"), said("unexplained"), False),
    ],
)
def test_what_is_confidently_wrong(draw: Draw, found: ScoredDiagnosis, wrong: bool) -> None:
    assert is_confidently_wrong(draw, found) == wrong


def test_axes_are_of_both_kinds_and_laws(machine: Machine) -> None:
    random = np.random.default_rng(0)
    axes = [draw_axis(random, machine) for _ in range(200)]
    assert len(set(axes)) == 8
    for axis in set(axes):
        file = machine_file(machine, axis)
        assert (file.plant.kind, file.plant.moved) == (axis.kind, machine.plant.moved)
        assert file.friction.switches == axis.other_law
        assert machine_of(machine, replace(drawn("clean"), axis=axis)).digest == file.digest


@pytest.mark.parametrize("name", FAULTS)
def test_faults_are_seen_before_anything_is_fitted(machine: Machine, name: str) -> None:
    log, _ = simulate_draw(machine, replace(drawn("fault", name), seconds=3.0))
    with pytest.raises(ImplausibleError):
        check_plausible(log, machine)


def test_a_refused_log_is_a_result(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    at = KINDS.index("fault")
    draw, found = run_draw(machine, SEED, at, lambda *_: pytest.fail("diagnosed"))
    assert found.refused
    assert outcome(draw, found) == "right"
    assert ScoredDiagnosis.from_json(json.loads(json.dumps(found.to_json()))).refused == found.refused


def test_rates_and_confusion(machine: Machine) -> None:
    results = [
        *[(drawn("single", OFFSET), said("explained", OFFSET))] * 7,
        *[(drawn("single", OFFSET), said("ambiguous", COULOMB, rivals=[(OFFSET, COULOMB)]))] * 2,
        (drawn("single", OFFSET), said("explained", COULOMB)),
        (drawn("single", OFFSET, size=0.03), said("adequate")),  # too small to count
        *[(drawn("clean"), said("adequate"))] * 9,
        (drawn("clean"), said("explained", "viscous")),
        *[(drawn("double", OFFSET, "force_ripple"), said("explained", OFFSET, "force_ripple"))] * 3,
        (drawn("double", OFFSET, "force_ripple"), said("explained", OFFSET)),
        (drawn("unmodelled", "bursts"), said("unexplained")),
        (drawn("unmodelled", "chirp"), said("explained", "force_ripple")),
        (drawn("triple", OFFSET, COULOMB, "force_ripple"), said("explained", OFFSET, COULOMB, "force_ripple")),
        (drawn("fault", "force_of_other_sign"), ScoredDiagnosis("unexplained", refused="of the other sign")),
        (drawn("clean"), ScoredDiagnosis("unexplained", refused="of the other sign")),
        (drawn("clean"), replace(said("adequate"), law="sgms")),
        (drawn("clean"), replace(said("adequate"), law="switching")),
    ]
    summary = summarise(machine, results)
    assert (summary.rates["recovery"].hits, summary.rates["recovery"].total) == (9, 10)
    assert summary.rates["recovery"].interval[0] < 0.9 < summary.rates["recovery"].interval[1]
    assert summary.rates["ambiguous"].hits == 2
    assert summary.rates["misnamed"].hits == 1
    assert (summary.rates["false_alarms"].hits, summary.rates["false_alarms"].total) == (1, 13)
    assert (summary.rates["doubles"].hits, summary.rates["doubles"].total) == (3, 4)
    assert (summary.rates["triples"].hits, summary.rates["triples"].total) == (1, 1)
    assert (summary.rates["faults"].hits, summary.rates["refused"].hits) == (1, 1)
    # An offset called another name, a clean and an unmodelled log with a name.
    assert (summary.rates["confidently_wrong"].hits, summary.rates["confidently_wrong"].total) == (3, len(results))
    assert (summary.rates["laws"].hits, summary.rates["laws"].total) == (1, 2)
    assert (summary.rates["unmodelled_unexplained"].hits, summary.rates["unmodelled_misnamed"].hits) == (1, 1)
    rows, columns, counts = confusion_table(summary.confusion)
    table = {(r, c): n for r, line in zip(rows, counts, strict=True) for c, n in zip(columns, line, strict=True)}
    # A correct ambiguity counts as itself.
    assert table[OFFSET, OFFSET] == 14
    assert table[OFFSET, COULOMB] == 1
    assert table[OFFSET, "(nothing)"] == 1
    assert table["force_ripple", "(nothing)"] == 1
    assert table["clean", "viscous"] == 1
    assert table["unmodelled: chirp", "force_ripple"] == 1
    assert sum(summary.confusion.values()) == len(results) + 4 + 2
    text = summary_text(summary)
    assert "9 of 10    90.0 %" in text
    assert json.loads(json.dumps(summary_json(summary)))["recovery"]["hits"] == 9


def test_parameter_errors_and_coverage(machine: Machine) -> None:
    ripple = {"amplitude_N": 0.5, "pitch_m": 0.03, "phase_rad": 1.0}
    draw = replace(drawn("single"), hidden=(Hidden("force_ripple", ripple, size=0.125),))
    # Half a turn of the phase makes up for the sign.
    values = {"amplitude_N": -0.52, "pitch_m": 0.03003, "phase_rad": 1.0 - math.pi}
    found = ScoredDiagnosis(
        "explained", (("force_ripple", values, {"amplitude_N": 0.015, "pitch_m": 1e-6, "phase_rad": 0.1}),)
    )
    errors = {e.name: e for e in parameter_errors(machine, draw, found)}
    assert set(errors) == {"force_ripple.amplitude_N", "force_ripple.pitch_m"}
    assert errors["force_ripple.amplitude_N"].relative == pytest.approx(0.04)
    summary = summarise(machine, [(draw, found)])
    assert (summary.rates["within"].hits, summary.rates["within"].total) == (2, 2)
    assert (summary.rates["covered"].hits, summary.rates["covered"].total) == (1, 2)

    wrong = replace(drawn("base"), hidden=(Hidden("viscous", factors={"viscous": 1.2}, size=0.2),))
    found = ScoredDiagnosis("explained", (("viscous", {"viscous_N_s_m": 25.2}, {"viscous_N_s_m": 1.0}),))
    (error,) = parameter_errors(machine, wrong, found)
    assert error.relative == pytest.approx(0.05)

    gain = replace(drawn("single"), hidden=(Hidden("force_gain", {"gain": 1.02}, size=0.2),))
    found = ScoredDiagnosis("explained", (("force_gain", {"gain": 1.021}, {"gain": 0.001}),))
    (error,) = parameter_errors(machine, gain, found)
    assert error.relative == pytest.approx(0.05)


def test_smallest_size_found_half_of_the_time() -> None:
    random = np.random.default_rng(2)
    sizes = np.exp(random.uniform(math.log(0.01), math.log(0.5), 60))
    found = random.uniform(size=60) < 1.0 / (1.0 + (sizes / 0.05) ** -6)
    threshold = half_found("force_ripple", sizes.tolist(), found.tolist())
    assert threshold.low < 0.05 < threshold.high
    assert threshold.size == pytest.approx(0.05, rel=0.3)
    # With everything found, or nothing, it is beyond what was tried.
    assert half_found("x", [0.05, 0.1, 0.2], [True] * 3).size < 0.05
    assert half_found("x", [0.05, 0.1, 0.2], [False] * 3).size > 0.2


# --- runs -----------------------------------------------------------------------------------------------------------


def refuse(machine: Machine, log: Log) -> None:
    raise ValueError(f"not today: {log.source}")


def test_an_interrupted_run_goes_on(machine: Machine, tmp_path: Path) -> None:
    class Interrupt(KeyboardInterrupt):
        pass

    def stop(done: int, total: int) -> None:
        if done == 2:
            raise Interrupt

    options = {"draws": 4, "seed": SEED, "jobs": 1, "diagnose": refuse}
    with pytest.raises(Interrupt):
        run_diagnosis_benchmark(machine, tmp_path, progress=stop, **options)  # type: ignore[arg-type]
    kept = tmp_path / "results"
    assert [folder.name[:5] for folder in sorted(kept.iterdir())] == ["00000", "00001"]
    calls: list[tuple[int, int]] = []
    summary = run_diagnosis_benchmark(
        machine,
        tmp_path,
        progress=lambda done, total: calls.append((done, total)),
        **options,  # type: ignore[arg-type]
    )
    assert calls == [(k, 4) for k in range(5)]
    assert summary.rates["errors"].hits == 4
    folders = sorted(kept.iterdir())
    assert [folder.name[:5] for folder in folders] == ["00000", "00001", "00002", "00003"]
    first = json.loads((folders[0] / "result.json").read_text())
    assert first["found"]["error"] == "ValueError: not today: draw_0.csv"
    assert (tmp_path / "summary.txt").read_text() == summary_text(summary) + "\n"
    assert json.loads((tmp_path / "summary.json").read_text())["draws"] == 4
    assert (tmp_path / "confusion.csv").read_text().startswith("hidden,")
    # Another seed's are others.
    run_diagnosis_benchmark(machine, tmp_path, draws=1, seed=SEED + 1, jobs=1, diagnose=refuse)  # type: ignore[arg-type]
    assert len(list(kept.iterdir())) == 5


@pytest.mark.slow
def test_processes_give_what_one_gives(machine: Machine, tmp_path: Path) -> None:
    for jobs in (1, 2):
        run_diagnosis_benchmark(machine, tmp_path / str(jobs), draws=2, seed=SEED, jobs=jobs, diagnose=refuse)  # type: ignore[arg-type]

    def results(jobs: int) -> list[Draw]:
        kept = sorted((tmp_path / str(jobs) / "results").glob("*/result.json"))
        return [Draw.from_json(json.loads(path.read_text())["draw"]) for path in kept]

    assert [d.motion_seed for d in results(1)] == [d.motion_seed for d in results(2)]


@pytest.mark.parametrize(
    ("seed", "index", "kind", "hidden", "right"),
    [
        (21, 2, "single", ("force_ripple",), {"named"}),
        (21, 4, "single", ("micro_viscous",), {"named", "ambiguous"}),
        (21, 7, "single", ("periodic_disturbance",), {"named"}),  # of an axis whose elements slip at once
        (21, 35, "single", ("quadratic_drag",), {"named", "ambiguous"}),  # of one that turns
        (21, 5, "clean", (), {"right"}),  # its file states the other law
        (21, 28, "unmodelled", ("telegraph",), {"unexplained"}),
        # A number of the machine beside a curve of any shape is a part of it, and no cause of its own.
        pytest.param(211, 96, "unmodelled", ("log_of_speed",), {"named"}, marks=pytest.mark.slow),
        (21, 33, "fault", ("position_of_other_sign",), {"right"}),
        (21, 39, "weak", ("eddy_current_damping",), {"right"}),
    ],
)
def test_part_of_the_benchmark(
    machine: Machine, seed: int, index: int, kind: str, hidden: tuple[str, ...], right: set[str]
) -> None:
    """A few draws for real: what is hidden is found with its numbers, what is not is not named."""
    draw, found = run_draw(machine, seed, index)
    assert (draw.kind, tuple(h.name for h in draw.hidden)) == (kind, hidden)
    assert outcome(draw, found) in right, (draw, found)
    assert not is_confidently_wrong(draw, found)
    if kind in ("single", "double", "base"):
        errors = parameter_errors(machine, draw, found)
        assert errors
        assert all(abs(e.relative) < 0.1 for e in errors), errors
        assert all(abs(e.error) < 4.0 * e.std for e in errors if math.isfinite(e.std)), errors
    if kind not in ("unmodelled", "fault"):
        # Down to the noise, under either law.
        assert found.held_out_after_N < 1.3 * found.noise_floor_N


def test_two_causes_that_differ_by_less_than_matters_are_not_told_apart(machine: Machine) -> None:
    """A force 0.75 samples early, for which a lag leaves less, by t = 2.5 and more."""
    draw, found = run_draw(machine, 307, 4)
    assert [h.name for h in draw.hidden] == ["force_delay"]
    assert outcome(draw, found) in ("named", "ambiguous"), found


def test_what_other_numbers_explain_is_not_adequate(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine with a level that is wrong, where no cause is found: as it is it leaves 24 noise floors."""
    monkeypatch.setattr(verdict, "select_causes", without_causes)
    draw, found = run_draw(machine, 105, 219)
    assert draw.truth == ("asymmetric_coulomb",)
    assert not found.names
    assert found.verdict == "unexplained", found


def without_causes(searched: Searched) -> Selection:
    """A selection that has nothing in it."""
    fit = fit_model(searched.laws.chosen, (), refitted=(), warm=searched.fit)
    return Selection(fit=fit, refitted=(), scores=(), rivals=(), rejected={}, p_values={}, free=searched.fit)


@pytest.mark.parametrize(
    ("seed", "index", "style", "hidden", "listed"),
    [
        # In one direction a level that is asymmetric is a level that is wrong.
        (77, 59, "one_way", "asymmetric_coulomb", {"coulomb", "asymmetric_coulomb"}),
        # At one speed what comes again in time comes again in place.
        (77, 79, "crawl", "periodic_disturbance", {"periodic_disturbance", "force_ripple"}),
        # One fold of this record holds all that it tells of some numbers.
        (105, 219, "one_way", "asymmetric_coulomb", {"coulomb", "asymmetric_coulomb"}),
        (101, 239, "crawl", "force_constant_ripple", {"force_constant_ripple", "position_map"}),
    ],
)
def test_what_the_motion_makes_one_is_ambiguous(
    machine: Machine, seed: int, index: int, style: str, hidden: str, listed: set[str]
) -> None:
    draw, found = run_draw(machine, seed, index)
    assert (draw.style, draw.truth) == (style, (hidden,))
    assert found.verdict == "ambiguous", found
    assert listed <= {*found.names, *(name for name, _ in found.rivals)}
    assert found.has_experiment
    assert outcome(draw, found) == "right"


def test_no_number_is_wrong_that_is_within_its_interval(machine: Machine) -> None:
    """Of a Stribeck effect the ratio is not known: with the file's the velocity is the file's too."""
    draw, found = run_draw(machine, 112, 50)
    assert draw.truth == ("micro_viscous",)
    assert (found.verdict, found.names) == ("explained", ("micro_viscous",)), found


def test_what_is_known_to_look_alike_is_tried_where_a_derivative_tells_half(machine: Machine) -> None:
    """Beside a lag and an asymmetry the derivative of a friction that grows with the load has 0.65 of its gain."""
    draw = Draw(
        index=0,
        kind="triple",
        axis=DrawnAxis(kind="rotary", other_law=False, obeys="maxwell_slip"),
        hidden=(
            Hidden("asymmetric_viscous", {"difference_N_s_m": 0.3279551293968889}),
            Hidden("load_dependent_friction", {"ratio": 0.00785262763469043, "rise_ratio": 0.0}),
            Hidden("frictional_lag", {"time_constant_s": 0.005117992735122358}),
        ),
        machine_changes={"name": "specimen", "friction": {"stribeck_ratio": 0.4}},
        style="dies",
        seconds=13.713658464656962,
        motion_seed=805357180,
        force_noise_N=0.09561954679553064,
        encoder_noise_m=2.794347832918605e-10,
        encoder_resolution_m=1.1608982055278733e-09,
        noise_seed=470065265,
    )
    found = diagnose_draw(machine, draw)
    assert found.verdict == "ambiguous", found
    assert {"load_dependent_friction", "drive_efficiency"} <= {*found.names, *(name for name, _ in found.rivals)}
