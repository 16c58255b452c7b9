"""What a diagnosis says of the numbers that it found: how sure they are, and that a gap is as long as it is."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from record_cases import simulate_log
from sgms_bench.diagnosis.motions import draw_motion
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.diagnosis.causes import measure_causes
from sgms_mhe.diagnosis.final_fit import make_final_fit
from sgms_mhe.diagnosis.fits import Subject, fit_model
from sgms_mhe.diagnosis.laws import make_laws
from sgms_mhe.diagnosis.parametrisation import CandidateEffect
from sgms_mhe.diagnosis.rivals import Selection
from sgms_mhe.diagnosis.uncertainty import covariance, standard_deviations
from sgms_mhe.recordings.evidence import (
    ALONE,
    cross_loss,
    jackknife_covariance,
    robust_covariance,
    stationary_covariance,
)
from sgms_mhe.recordings.recording import prepare

BLOCKS, ROWS, FOLDS = 12, 40, 4


def rows_in_blocks() -> SimpleNamespace:
    """Of a recording what sums over blocks need."""
    return SimpleNamespace(
        used=np.ones(BLOCKS * ROWS, dtype=np.bool_),
        block=np.repeat(np.arange(BLOCKS), ROWS),
        blocks=BLOCKS,
        fold=np.arange(BLOCKS) % FOLDS,
        sum_blocks=lambda series: series.reshape(BLOCKS, ROWS).sum(axis=1),
    )


def test_numbers_that_few_blocks_tell_of_are_as_unsure_as_they_scatter() -> None:
    """Noise that is one number per block; four of 12 blocks tell of the parameter. A sandwich promises too much."""
    random, recording = np.random.default_rng(1), rows_in_blocks()
    seen = np.zeros(BLOCKS)
    seen[[1, 4, 7, 10]] = 1.0, 2.0, 1.0, 1.5
    X = np.column_stack((np.repeat(seen, ROWS), np.ones(BLOCKS * ROWS)))
    H, errors, stated, sandwich = X.T @ X, [], [], []
    for _ in range(300):
        noise = np.repeat(random.normal(size=BLOCKS), ROWS)
        found = np.linalg.solve(H, X.T @ noise)
        errors.append(found[0])
        rest = noise - X @ found
        stated.append(jackknife_covariance(recording, X, rest, H)[0, 0])  # type: ignore[arg-type]
        sums = (X * rest[:, None]).reshape(BLOCKS, ROWS, 2).sum(axis=1)
        sandwich.append((np.linalg.solve(H, sums.T) @ np.linalg.solve(H, sums.T).T)[0, 0])
    true = float(np.var(errors))
    assert float(np.mean(sandwich)) < 0.75 * true < 0.9 * true < float(np.mean(stated)) < 2.5 * true


def test_cross_validation_is_that_of_refits() -> None:
    """Of a linear model, at its optimum, each block is predicted as by a fit to the other folds."""
    random, recording = np.random.default_rng(2), rows_in_blocks()
    X, prior = random.normal(size=(BLOCKS * ROWS, 3)), np.full(3, 0.5)
    y = X @ [1.0, -2.0, 0.5] + random.normal(size=len(X))
    best = np.linalg.solve(X.T @ X, X.T @ y)
    found = cross_loss(recording, X, y - X @ best, prior)  # type: ignore[arg-type]
    for fold in range(FOLDS):
        left = np.repeat(recording.fold != fold, ROWS)
        # The prior is about the fit of all rows.
        H = X[left].T @ X[left] + np.diag(prior)
        without = np.linalg.solve(H, X[left].T @ y[left] + prior * best)
        expected = recording.sum_blocks((y - X @ without) ** 2)[recording.fold == fold]
        np.testing.assert_allclose(found[recording.fold == fold], expected, rtol=1e-9)


def test_a_fold_that_alone_tells_of_a_number_condemns_no_fit() -> None:
    """A fit that stopped short of its optimum there is as much worse again, and not 1e12 times."""
    random, recording = np.random.default_rng(3), rows_in_blocks()
    X = np.zeros((BLOCKS * ROWS, 2))
    X[:, 0] = 1.0
    X[:ROWS:2, 1] = 10.0
    residual = 0.1 * random.normal(size=len(X)) + 0.05 * X[:, 1]
    left = cross_loss(recording, X, residual, np.full(2, 1e-3))  # type: ignore[arg-type]
    assert left.sum() < 4.0 * float(residual @ residual)


def test_a_number_of_one_block_alone_has_a_finite_interval() -> None:
    recording = rows_in_blocks()
    X = np.zeros((BLOCKS * ROWS, 1))
    X[5 * ROWS : 6 * ROWS, 0] = 1.0
    residual = np.zeros(len(X))
    residual[5 * ROWS] = 1.0
    moved = jackknife_covariance(recording, X, residual, X.T @ X)[0, 0]  # type: ignore[arg-type]
    assert moved == pytest.approx((1.0 / ROWS / (1.0 - ALONE)) ** 2 * (BLOCKS - 1) / BLOCKS)


def test_a_sum_is_known_of_which_no_part_is() -> None:
    """Two columns that are nearly the same: each number is open, their sum is about as sure as if there were one."""
    random, recording = np.random.default_rng(4), rows_in_blocks()
    one = random.normal(size=BLOCKS * ROWS)
    X = np.column_stack((one, one + 1e-5 * random.normal(size=len(one))))
    residual = random.normal(size=len(X))
    residual -= X @ np.linalg.lstsq(X, residual)[0]
    H = X.T @ X
    cov = robust_covariance(recording, X, residual, H, np.linalg.inv(H), wrong=0.1)  # type: ignore[arg-type]
    alone = robust_covariance(recording, X[:, :1], residual, H[:1, :1], 1.0 / H[:1, :1], wrong=0.1)  # type: ignore[arg-type]
    assert cov[0, 0] > 1e6 * alone[0, 0]
    assert 0.9 * alone[0, 0] < cov.sum() < 2.0 * alone[0, 0]


@pytest.mark.parametrize(("colour", "least"), [(0.0, 0.9), (0.9, 0.8)])
def test_numbers_scatter_as_the_spectrum_of_the_residual_says(colour: float, least: float) -> None:
    """A level and a slope by least squares under noise that keeps its sign over ten rows, or none."""
    recording, random = rows_in_blocks(), np.random.default_rng(7)
    count = BLOCKS * ROWS
    X = np.column_stack((np.ones(count), np.linspace(-1.0, 1.0, count)))
    inverse = np.linalg.inv(X.T @ X)
    found, stated = [], []
    for _ in range(300):
        white = random.normal(size=2 * count)
        noise = lfilter([1.0], [1.0, -colour], white)[count:]
        b = inverse @ X.T @ noise
        found.append(b)
        stated.append(np.diag(stationary_covariance(recording, X, noise - X @ b, inverse)))  # type: ignore[arg-type]
    share = np.sqrt(np.mean(stated, axis=0)) / np.std(found, axis=0)
    assert (share > least).all()
    assert (share < 1.15).all()
    if colour:  # as white rows they would be known four times better
        assert (np.sqrt(np.diag(inverse) * np.mean(noise**2)) < 0.3 * np.std(found, axis=0)).all()


def test_errors_that_a_noise_floor_may_hide_widen_an_interval(monkeypatch: pytest.MonkeyPatch) -> None:
    machine = load_machine("etel_xy")
    motion = draw_motion("strokes", machine, 4.0, np.random.default_rng(2))
    log = simulate_log(machine, path=motion, seed=2)
    widths = []
    for unseen in (0.0, 0.15, 0.3):
        monkeypatch.setattr("sgms_mhe.diagnosis.uncertainty.UNSEEN_ERROR", unseen)
        recording = prepare(machine, log)
        subject = Subject.of(machine, recording)
        fit = fit_model(subject, ())
        # A floor at the residual's own RMS: nothing is seen beyond it.
        quiet = Subject(machine, recording, subject.alignment, noise=fit.cross_rms)
        widths.append(np.diag(covariance(quiet, fit)))
    more = widths[1] - widths[0]
    assert (more[fit.free] > 0.0).all()
    np.testing.assert_allclose(widths[2] - widths[0], 4.0 * more, rtol=1e-3)
    assert np.sqrt(widths[1] / widths[0])[fit.free].max() < 1.25


def test_derivatives_that_have_run_away_promise_nothing() -> None:
    """As of a gap that opens a hundred times along a short way: intervals were a 500th of the error."""
    machine = load_machine("etel_xy")
    motion = draw_motion("loops", machine, 4.0, np.random.default_rng(2))
    recording = prepare(machine, simulate_log(machine, path=motion, seed=2))
    subject = Subject.of(machine, recording)
    fit = fit_model(subject, ())
    slopes = fit.jacobian.copy()
    slopes[1000:1010] *= 1e5
    usual, stated = (np.diag(covariance(subject, f))[fit.free] for f in (fit, replace(fit, jacobian=slopes)))
    np.testing.assert_allclose(stated, usual, rtol=0.1)


@pytest.mark.parametrize(("gap", "seed", "style"), [(5e-5, 3, "strokes"), (2.2e-4, 4, "loops")])
def test_a_gap_is_as_long_as_it_is_found(gap: float, seed: int, style: str) -> None:
    """Against the plant's, which opens and closes at once. It was 6 and 7 % too long."""
    machine = load_machine("etel_xy")
    motion = draw_motion(style, machine, 5.0, np.random.default_rng(seed))
    log = simulate_log(machine, ("backlash", {"gap_m": gap}), path=motion, force_noise_N=0.02, seed=1)
    subject = Subject.of(machine, prepare(machine, log))
    found = fit_model(subject, [CandidateEffect("backlash", {"gap_m": 1.1 * gap})], refitted=())
    assert found.effects[0].parameters["gap_m"] == pytest.approx(gap, rel=0.05)


def test_a_number_that_a_bound_stops_has_no_interval() -> None:
    """A force later than any drive's: the search ends at the longest delay, which is not the axis's."""
    machine = load_machine("etel_xy")
    log = simulate_log(machine, path=draw_motion("strokes", machine, 3.0, np.random.default_rng(2)), seed=2)
    late = int(0.15 * log.rate)
    shifted = replace(log, force_N=np.concatenate((np.full(late, log.force_N[0]), log.force_N[:-late])))
    recording = prepare(machine, shifted)
    subject = Subject.of(machine, recording)
    nominal = fit_model(subject, (), refitted=())
    laws = make_laws(machine, recording, nominal.rms)
    fit = fit_model(laws.chosen, [CandidateEffect("force_delay", {"delay_s": 0.05})], refitted=())
    selection = Selection(fit, (), (), (), {}, {}, fit)
    final = make_final_fit(recording, nominal, laws, selection)
    (cause,) = measure_causes(final, final.selection, final.selection.fit).values()
    assert cause.vague == ("delay_s",)
    assert np.isnan(cause.std["delay_s"])


def test_intervals_do_not_hang_on_the_size_of_the_files_numbers() -> None:
    """Of a stiffness far below the file's every slope is large: rows that count were left out."""
    file = override_machine(load_machine("etel_xy"), {"friction": {"law": "switching"}})
    motion = draw_motion("loops", file, 4.0, np.random.default_rng(2))
    log = simulate_log(file, path=motion, seed=2)
    stiffness = file.friction.stiffness
    stated = []
    for factor in (1.0, 1e5):
        off = override_machine(file, {"friction": {"stiffness": [factor * stiffness[0], *stiffness[1:]]}})
        subject = Subject.of(off, prepare(off, log)).start_from({"stiffness_1": stiffness[0]})
        fit = fit_model(subject, ())
        stated.append(standard_deviations(covariance(subject, fit), fit))
    np.testing.assert_allclose(stated[1], stated[0], rtol=0.1)
