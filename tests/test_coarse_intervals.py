"""Intervals of numbers identified through coarse encoders, off their stamps, at low rates: they hold the truth."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from sgms_bench.studies.coarse import draw_coarse_axis, identified_coarse_axis
from sgms_mhe.configuration import override_machine
from sgms_mhe.identification import Wanted
from sgms_mhe.identification.fits import RecordView, covariance
from sgms_mhe.identification.identify import explore
from sgms_mhe.identification.records import make_records
from sgms_mhe.identification.sampling import replace_filter, rough_mass, unknown_axis
from sgms_mhe.recordings.path import smooth_path, thin_path
from sgms_mhe.signals.logs import Log

Array = NDArray[np.float64]


@pytest.mark.slow
# 1: of two laws the records tell neither; 2: few samples below the Stribeck velocity; 14: a low-pass that lets half of
# the acceleration be noise; 17: readings off their stamps.
@pytest.mark.parametrize("seed", [1, 2, 14, 17])
def test_axes_behind_coarse_encoders_drawn_at_random(seed: int) -> None:
    """A few of `python -m sgms_bench.studies coarse`; each had numbers 9 to 17 deviations off."""
    row = identified_coarse_axis(seed, 12.0)
    print(row)
    errors = np.abs(list(row["errors"].values()))
    assert len(errors) >= 3
    assert errors.max() < 4.0


def test_readings_off_their_stamps_are_smoothed_by_their_own_noise() -> None:
    """Where the axis is fast they are far off, where it is slow not: one noise for both leaves one of them rough."""
    random, time = np.random.default_rng(1), np.arange(8000) / 1000.0
    way = 1e-3 * np.where(time < 4.0, 0.0, np.sin(2.0 * np.pi * (time - 4.0)))
    course = np.where(time < 4.0, 1e-7, 2e-5)
    position = way + course * random.standard_normal(len(time))
    plain, weighed = smooth_path(position, 1e-7), smooth_path(position, 1e-7, course)
    for part in (slice(100, 3900), slice(4100, 7900)):
        assert np.std((weighed - way)[part]) < 0.5 * np.std((plain - way)[part])


def test_a_thinned_way_lacks_what_is_between_samples() -> None:
    time = np.arange(400) / 100.0
    smooth, corner = np.sin(time), np.abs(time - 2.0)
    for thinned in thin_path(smooth):
        assert np.abs(thinned - smooth)[4:-4].max() < 1e-6
    assert max(np.abs(thinned - corner)[4:-4].max() for thinned in thin_path(corner)) > 1e-3


def driven_mass(jitter: float) -> Log:
    """A mass of 2 kg with 3 N of friction on sines, read up to `jitter` samples off its stamps, in steps of 10 nm."""
    random, rate, step = np.random.default_rng(5), 2000.0, 1e-8
    time = np.arange(int(12.0 * rate)) / rate
    off = random.uniform(0.0, jitter, len(time)) / rate

    def way(t: Array) -> Array:
        return 0.05 * np.sin(2.0 * np.pi * 1.1 * t) + 0.004 * np.sin(2.0 * np.pi * 4.3 * t)

    velocity = np.gradient(way(time), 1.0 / rate)
    force = 2.0 * np.gradient(velocity, 1.0 / rate) + 3.0 * np.tanh(velocity / 1e-3)
    force += 0.02 * random.standard_normal(len(time))
    return Log(time, np.round(way(time - off) / step) * step, force, rate, source="drive.csv")


@pytest.mark.parametrize(("jitter", "kept"), [(0.0, True), (0.5, False)])
def test_a_low_pass_is_judged_by_the_noise_behind_it(jitter: float, kept: bool) -> None:
    """A mass that came from a slower one is no reason to keep it."""
    log = driven_mass(jitter)
    machine = override_machine(unknown_axis([log], "drive", 2.0, None), {"sampling": {"velocity_cutoff": 320.0}})
    found, said = replace_filter(machine, [log])
    assert (found.sampling.velocity_cutoff == 320.0) == kept
    assert not said if kept else "in place of 320 Hz" in said[0]
    assert rough_mass(found, [log]) == pytest.approx(2.0, rel=0.03)


@pytest.mark.slow
def test_other_lines_and_fewer_samples_widen_intervals() -> None:
    """By what they make of the numbers, and by nothing where neither changes the way of the elements."""
    axis = draw_coarse_axis(2, 6.0)
    explored = explore([axis.log], Wanted("axis", axis.machine.plant.moved, elements=2))
    view, fit = explored.views.fine, explored.final.fit
    records = make_records(explored.records.machine, [axis.log])
    assert len(view.misread) == len(records.misread) > 1 and len(view.thinned) == 2
    alone = RecordView(view.rows, view.motions, view.noise, view.limits)
    own = replace(alone, thinned=(view.motions, view.motions))
    bare, same, whole = (np.diag(covariance(one, fit)) for one in (alone, own, view))
    assert np.allclose(same, bare, rtol=1e-6)
    assert np.all(whole >= bare * (1.0 - 1e-9)) and np.max(whole / np.maximum(bare, 1e-300)) > 1.5
