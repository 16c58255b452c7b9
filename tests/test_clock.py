"""Effects in time after hours and after a year of samples."""

import ctypes
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from c_packages import PRECISIONS, Array, machine, pointer, probed, scheme
from sgms_mhe.emission.package import emit_package

RATE = 10_000
YEAR = 365 * 86400
"""[s]: a whole number of periods of every frequency below."""
WRAP = 2**31
"""Samples, 59.6 h, that 32 bits hold."""


class Axis:
    """An estimator of etel_xy with effects in time, whose clock can be set."""

    def __init__(self, folder: Path, precision: str, effects: list[dict[str, Any]], **changes: Any) -> None:
        # What is fed in below is no axis' motion: few readings, none doubted, leave the clock to be looked at.
        sampling = {"measurement_rate": 100.0, **changes.pop("sampling", {})}
        estimator = {"horizon": 4, "noise": {"self_scaling": False}, **changes}
        tables = {"code": {"precision": precision}, "estimator": estimator, "sampling": sampling}
        settings = machine(effects=effects, **tables)
        self.c = probed(settings, folder, "clock.c")
        self.c.probe_insert.restype = ctypes.c_double

    def friction(self, clock: int, updates: int = 12) -> Array:
        """Friction fed forward [N] at every sample of a motion that begins at a time of the clock [samples]."""
        memory = ctypes.create_string_buffer(self.c.probe_size())
        self.c.probe_init(memory)
        self.c.probe_compensate(memory, 1)
        self.c.probe_set_clock(memory, ctypes.c_int64(clock))
        fed = np.empty(updates * 100 + 1)
        for k in range(len(fed)):
            v = 2e-3 * np.sin(0.02 * k)
            signals = np.array([0.0, v, 0.0, 4.0, 3.0 * np.tanh(v / 1e-4)])
            fed[k] = self.c.probe_insert(memory, pointer(signals), 1)
            if self.c.probe_due(memory):
                self.c.probe_feedback(memory)
                self.c.probe_prepare(memory)
        assert np.isfinite(fed).all() and np.abs(fed).max() > 1.0
        return fed


@pytest.fixture(scope="module")
def axis(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Axis]:
    def build(precision: str, *effects: dict[str, Any], **changes: Any) -> Axis:
        return Axis(tmp_path_factory.mktemp("clock"), precision, list(effects), **changes)

    return build


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("kind", ["mhe", "ekf"])
@pytest.mark.parametrize("frequency_Hz", [0.5, 50.0, 1000.0])
def test_sine_keeps_its_phase_for_a_year(frequency_Hz: float, kind: str, precision: str, axis: Any) -> None:
    """In double precision within 4e-8 s of its time, also where 32 bits of samples end; in single to its rounding."""
    amplitude_N = 1.0
    effect = {"name": "periodic_disturbance", "amplitude_N": amplitude_N, "frequency_Hz": frequency_Hz}
    estimator: Axis = axis(precision, effect, kind=kind)
    allowed = 2.0 * np.pi * frequency_Hz * amplitude_N * 4e-8 if precision == "double" else 2e-4
    start = estimator.friction(0)
    np.testing.assert_allclose(estimator.friction(YEAR * RATE), start, rtol=0.0, atol=allowed)
    # A whole number of periods, of two seconds, before the end of 32 bits, which the motion crosses.
    periods = (WRAP - 600) // (2 * RATE) * 2 * RATE
    offset = WRAP - 600 - periods
    np.testing.assert_allclose(estimator.friction(WRAP - 600), estimator.friction(offset), rtol=0.0, atol=allowed)
    assert np.abs(estimator.friction(RATE // 4) - start).max() > (0.5 if frequency_Hz < 1.0 else -1.0) * amplitude_N


SAMPLINGS: dict[str, dict[str, Any]] = {"flow": {}, "merged": scheme("flow", substeps=20)}


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("sampling", list(SAMPLINGS))
def test_sines_within_a_period_are_those_of_all_time(sampling: str, precision: str, axis: Any) -> None:
    """Against time that goes on, in double precision, which a step in time asks for; and a year later still."""
    sines = [
        {"name": "periodic_disturbance", "amplitude_N": 0.7, "frequency_Hz": 50.0, "phase_rad": 0.4},
        {"name": "periodic_disturbance", "amplitude_N": 0.5, "frequency_Hz": 13.5, "phase_rad": 0.9},
    ]
    nothing = {"name": "step_disturbance", "force_N": 1e-12, "time_s": 10.0}
    settings = {"sampling": SAMPLINGS[sampling]}
    within, on = axis(precision, *sines, **settings), axis("double", *sines, nothing, **settings)
    soon, late = (1e-7, 2.0 * np.pi * 50.0 * 4e-8) if precision == "double" else (1e-3, 1e-3)
    for clock in (0, 37, 12_345):
        expected = on.friction(clock)
        np.testing.assert_allclose(within.friction(clock), expected, rtol=0.0, atol=soon)
        np.testing.assert_allclose(within.friction(YEAR * RATE + clock), expected, rtol=0.0, atol=late)


@pytest.mark.parametrize(
    ("effects", "is_exact"),
    [
        (({"frequency_Hz": 49.98},), True),
        (({"frequency_Hz": 50.0}, {"frequency_Hz": 13.37}), True),
        (({"frequency_Hz": 50.0}, {"frequency_Hz": 50.0 * 2.0**0.5}), False),
    ],
)
def test_header_says_what_holds_in_single_precision(effects: tuple[dict[str, float], ...], is_exact: bool) -> None:
    sines = [{"name": "periodic_disturbance", "amplitude_N": 1.0, **effect} for effect in effects]
    header = emit_package(machine(effects=sines, code={"precision": "single"}), selftest=False).files["etel_xy.h"]
    assert ("after a year as well" in header) == is_exact
    assert ("but see a time of 24 bits" in header) != is_exact


def test_sine_of_an_estimated_frequency_has_the_time_that_goes_on() -> None:
    sine = {"name": "periodic_disturbance", "amplitude_N": 1.0, "frequency_Hz": 50.0}
    estimator = {"parameters": ["periodic_disturbance.frequency_Hz"], "bounds": {}}
    settings = machine(effects=[sine], code={"precision": "single"}, estimator=estimator)
    assert "but see a time of 24 bits" in emit_package(settings, selftest=False).files["etel_xy.h"]


def test_step_in_a_year_comes_when_it_is_due(axis: Any) -> None:
    soon: Axis = axis("double", {"name": "step_disturbance", "force_N": 1.0, "time_s": 0.05})
    late: Axis = axis("double", {"name": "step_disturbance", "force_N": 1.0, "time_s": YEAR + 0.05})
    np.testing.assert_allclose(late.friction(YEAR * RATE), soon.friction(0), rtol=0.0, atol=1e-4)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("name", ["friction_drift", "viscous_drift"])
def test_drift_goes_on_for_a_year(name: str, precision: str, axis: Any) -> None:
    """In both precisions: what is slow needs few digits of the time."""
    slow = {"name": name, "ratio": 0.5, "time_constant_s": float(YEAR)}
    estimator: Axis = axis(precision, slow)
    # At the same share of its time constant: one that is a thousand times as fast, after a thousandth of a year.
    fast: Axis = axis(precision, {**slow, "time_constant_s": YEAR / 1000})
    atol = 1e-5 if precision == "double" else 2e-3
    for share in (0.01, 0.2, 1.0):
        clock = round(share * YEAR * RATE)
        np.testing.assert_allclose(estimator.friction(clock), fast.friction(clock // 1000), rtol=0.0, atol=atol)
    frozen = estimator.friction(WRAP)
    assert np.abs(estimator.friction(YEAR * RATE) - frozen).max() > (0.1 if name == "friction_drift" else 1e-3)
