"""Work on several cores: the same results to the bit, whatever their number, and nothing run or compiled twice."""

import ctypes
import threading
import time
from collections.abc import Iterator
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray
from threadpoolctl import threadpool_info, threadpool_limits

from record_cases import simulate_log
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.diagnosis import Diagnosis, diagnose
from sgms_mhe.diagnosis.models import compile_once
from sgms_mhe.emission.package import Package, emit_package
from sgms_mhe.host.compiled import CompiledEstimator, CompiledModel
from sgms_mhe.host.shared_code import free_numbers
from sgms_mhe.identification import Wanted, identify
from sgms_mhe.machine import Machine
from sgms_mhe.model import Model, build_model
from sgms_mhe.recordings.recording import RUNS_CACHED, Runs
from sgms_mhe.reference.lasting import DOUBTED
from sgms_mhe.signals.chain import Signals, signals_from_log
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.signals.logs import Log
from sgms_mhe.support import toolchain
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.parallel import VARIABLE, _cores, run_parallel, workers
from sgms_mhe.support.toolchain import QUICK_FLAGS

Array = NDArray[np.float64]
RIPPLE = {"amplitude_N": 0.5, "pitch_m": 0.0173, "phase_rad": 0.7}


@pytest.fixture(scope="module")
def log(machine: Machine) -> Log:
    return simulate_log(machine, ("force_ripple", RIPPLE), seconds=4.0, seed=5)


# --- tasks ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", ["1", "2", "5"])
def test_results_come_in_the_order_of_the_tasks(count: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, count)
    assert workers() == int(count)
    assert run_parallel([partial(pow, k, 2) for k in range(7)]) == [k**2 for k in range(7)]
    assert run_parallel([]) == []


def test_tasks_run_at_the_same_time_and_no_more_than_there_are_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "2")
    together = threading.Barrier(2, timeout=60.0)

    def task() -> set[int]:
        together.wait()  # nobody gets past it alone
        seen = {threading.get_ident(), *run_parallel([threading.get_ident] * 3)}
        together.wait()  # both are at work up to here
        return seen

    first, second = run_parallel([task, task])
    assert len(first) == len(second) == 1
    assert first != second


def test_a_core_that_is_free_takes_what_another_piece_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "2")

    def lasting() -> bool:
        until = time.monotonic() + 60.0
        while time.monotonic() < until:
            if len(set(run_parallel([piece, piece]))) == 2:
                return True
        return False

    def piece() -> int:
        time.sleep(0.01)
        return threading.get_ident()

    assert run_parallel([lambda: True, lasting]) == [True, True]
    assert run_parallel([lasting, lambda: True]) == [True, True]
    assert len(set(run_parallel([piece] * 8))) == 2  # as many as before


def all_cores_come_back() -> bool:
    """Whether nobody has one in the end: who worked for another gives it back after the other goes on."""
    until = time.monotonic() + 60.0
    while _cores._busy != 0 and time.monotonic() < until:
        time.sleep(0.001)
    return _cores._busy == 0


@pytest.mark.parametrize("swapped", [False, True])
def test_a_core_that_gets_free_takes_what_was_begun_without_it(swapped: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "2")
    begun, together = threading.Event(), threading.Barrier(2, timeout=60.0)

    def short() -> bool:
        return begun.wait(60.0)

    def first() -> int:
        begun.set()  # both cores are taken up to here
        together.wait()
        return threading.get_ident()

    def second() -> int:
        together.wait()  # and neither gets past it alone
        return threading.get_ident()

    def long() -> bool:
        return len(set(run_parallel([first, second]))) == 2

    assert run_parallel([long, short] if swapped else [short, long]) == [True, True]
    assert all_cores_come_back()


def test_many_batches_within_each_other_keep_no_core(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "3")
    at_work, most, guard = 0, 0, threading.Lock()

    def leaf() -> int:
        nonlocal at_work, most
        with guard:
            at_work += 1
            most = max(most, at_work)
        time.sleep(1e-4)
        with guard:
            at_work -= 1
        return 1

    def node(depth: int) -> int:
        return leaf() if depth == 0 else sum(run_parallel([partial(node, depth - 1)] * 3))

    assert node(5) == 3**5
    assert 1 < most <= 3
    assert all_cores_come_back()
    assert not any(batch.left for batch in _cores._offered)


def test_the_first_task_s_error_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "2")

    def fail(kind: type[Exception]) -> None:
        raise kind

    with pytest.raises(KeyError):
        run_parallel([lambda: None, partial(fail, KeyError), partial(fail, ValueError)])


@pytest.mark.parametrize("stated", ["0", "-1", "two", "", "1.5"])
def test_a_number_of_workers_that_is_none_is_refused(stated: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, stated)
    with pytest.raises(InputError, match=rf"{VARIABLE} = '{stated}': a whole number from 1 on"):
        workers()


@pytest.mark.slow
@pytest.mark.parametrize("work", ["diagnose", "identify"])
def test_linear_algebra_has_one_thread_whatever_the_host_has(work: str, machine: Machine, log: Log) -> None:
    seen: list[int] = []

    def threads(*_: Any) -> None:
        seen.extend(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas")

    with threadpool_limits(limits=2, user_api="blas"):
        if work == "diagnose":
            diagnose(machine, log, progress=threads)
        else:
            identify([log], Wanted("axis"), threads)
        assert seen
        assert set(seen) == {1}
        seen.clear()
        threads()
        assert set(seen) == {2}  # as before


# --- runs that were asked for before ----------------------------------------------------------------------------


def test_a_run_is_known_by_its_code_signals_and_parameters() -> None:
    runs, code, other, count = Runs(), object(), object(), 0

    def run(derivatives: bool) -> tuple[Array, Array | None]:
        nonlocal count
        count += 1
        return np.ones(3), np.ones((3, 2)) if derivatives else None

    def ask(code: object, signals: object, theta: float, *, derivatives: bool) -> int:
        force, slopes = runs.get(code, signals, np.array([theta]), derivatives, partial(run, derivatives))
        assert (slopes is not None) == derivatives
        assert not force.flags.writeable
        return count

    assert ask(code, other, 1.0, derivatives=False) == 1
    assert ask(code, other, 1.0, derivatives=False) == 1
    assert ask(code, other, 1.0, derivatives=True) == 2  # the first had none
    assert ask(code, other, 1.0, derivatives=False) == 2
    assert ask(code, other, 2.0, derivatives=False) == 3
    assert ask(code, code, 1.0, derivatives=False) == 4
    assert ask(other, other, 1.0, derivatives=False) == 5
    for k in range(RUNS_CACHED):
        ask(code, other, 10.0 + k, derivatives=False)
    assert ask(code, other, 1.0, derivatives=True) == 6 + RUNS_CACHED  # only the newest are kept


# --- code for this host -----------------------------------------------------------------------------------------


@pytest.fixture
def fresh_flags() -> Iterator[None]:
    toolchain.wide_flags.cache_clear()
    yield
    toolchain.wide_flags.cache_clear()


@pytest.mark.usefixtures("fresh_flags")
def test_wide_registers_only_where_host_and_compiler_have_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    host, command = tmp_path / "cpuinfo", tmp_path / "cc"
    monkeypatch.setattr(toolchain, "_HOST", host)
    monkeypatch.setenv("CC", str(command))
    for registers, refused, first in (
        ("fpu avx512f avx2 avx512dq avx512vl", "-mnothing", "-mavx512f"),
        ("fpu avx512f avx2 avx512dq avx512vl", "-mavx512", "-mavx2"),
        ("fpu avx2 avx512f", "-mnothing", "-mavx2"),
        ("fpu avx2", "-mavx", ""),
        ("fpu sse2", "-mnothing", ""),
    ):
        host.write_text(f"flags : {registers}\n")
        command.write_text(f'#!/bin/sh\ncase "$*" in *{refused}*) exit 1;; esac\n')
        command.chmod(0o755)
        toolchain.wide_flags.cache_clear()
        assert "".join(toolchain.wide_flags()[:1]) == first, (registers, refused)
    host.unlink()
    toolchain.wide_flags.cache_clear()
    assert toolchain.wide_flags() == ()


def assert_same_bits(machine: Machine, one: CompiledModel, other: CompiledModel) -> None:
    step, n = machine.sampling.step, 20_000
    time = step * np.arange(n)
    position, pulse = 0.02, 2.0 * np.pi * 5.0
    w = np.column_stack(
        (
            position * np.sin(pulse * time),
            position * pulse * np.cos(pulse * time),
            -position * pulse**2 * np.sin(pulse * time),
            np.zeros(n),
            time,
        )
    )
    n_x, n_p = one.model.n_x, one.model.n_p
    results = []
    for code in (one, other):
        state, sensitivity, force, slopes = np.zeros(n_x), np.zeros((n_x, n_p)), np.empty(n), np.empty((n, n_p))
        code.advance(w, np.full(n_p, 1.1), state, sensitivity, force, slopes)
        results.append((state, sensitivity, force, slopes))
    assert float(np.ptp(results[0][2])) > machine.friction.coulomb
    for first, second in zip(*results, strict=True):
        np.testing.assert_array_equal(first, second)


def test_wide_registers_change_no_bit(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    package = emit_package(machine, selftest=False)
    wide = CompiledModel(machine, package)
    monkeypatch.setattr("sgms_mhe.host.compiled.wide_flags", lambda: ())
    assert_same_bits(machine, wide, CompiledModel(machine, package))


@pytest.mark.parametrize("settings", ["etel_xy", "etel_xy_switching", "frictional_lag"])
def test_machines_of_one_structure_share_code_that_changes_no_bit(settings: str, machine: Machine) -> None:
    if settings == "frictional_lag":
        machine = override_machine(machine, {"effects": [{"name": "frictional_lag", "time_constant_s": 0.013}]})
    elif settings != "etel_xy":
        machine = load_machine(settings)
    friction = machine.friction
    numbers = {"coulomb": 1.137 * friction.coulomb, "stiffness": [1.137 * k for k in friction.stiffness]}
    sampling = {"rate": 12500.0, "update_rate": 125.0, "velocity_cutoff": 300.0, "max_velocity": 2.7}
    changes = {"friction": numbers, "plant": {"mass": 1.23 * machine.plant.mass}, "estimator": {"horizon": 7}}
    other = override_machine(machine, {**changes, "sampling": sampling})
    shared = [CompiledModel(each) for each in (machine, other)]
    assert len({code.library for code in shared}) == 1
    for each, code in zip((machine, other), shared, strict=True):  # in turns, so that each brings its own numbers
        assert_same_bits(each, code, CompiledModel(each, emit_package(each, selftest=False)))
    assert_same_bits(machine, shared[0], CompiledModel(machine, emit_package(machine, selftest=False)))


@pytest.mark.parametrize("precision", ["double", "single"])
def test_numbers_that_a_caller_sets_are_those_of_a_package_to_the_bit(
    precision: str, machine: Machine, log: Log
) -> None:
    colour = 3.7
    plain = override_machine(machine, {"code": {"precision": precision}})
    stated = override_machine(plain, {"estimator": {"noise": {"colour": colour}}})
    files, numbers = free_numbers(emit_package(plain, selftest=False).files, ("COLOUR_KNOWN", "DOUBTED_SPREAD"))
    assert numbers.tolist() == [1.0, DOUBTED]
    free = CompiledEstimator(plain, Package(plain, files), (*QUICK_FLAGS, "-DSGMS_FREE=2"))
    known = (ctypes.c_double * 2).in_dll(free.library, "sgms_free")
    known[:] = (colour * numbers).tolist()
    assert_same_estimates(free.estimate_log(log), CompiledEstimator(stated).estimate_log(log))
    known[:] = numbers.tolist()
    assert_same_estimates(free.estimate_log(log), CompiledEstimator(plain).estimate_log(log))


@pytest.mark.parametrize("kind", ["ekf", "mhe"])
def test_weights_that_a_caller_sets_are_those_of_a_package_to_the_bit(kind: str, machine: Machine, log: Log) -> None:
    plain = override_machine(machine, {"estimator": {"kind": kind, "relinearise": "newest"}})
    signals = signals_from_log(log, machine)
    free, as_stated = CompiledEstimator(plain), CompiledEstimator(plain).estimate(signals)
    for noise in ({"measurement": 0.37}, {"state": 0.003}, {"parameter_drift": 0.01}):
        stated = override_machine(plain, {"estimator": {"noise": noise}})
        found = free.estimate(signals, weights=build_model(stated))
        assert_same_estimates(found, CompiledEstimator(stated).estimate(signals))
        with pytest.raises(AssertionError):
            assert_same_estimates(found, as_stated)
    assert_same_estimates(free.estimate(signals), as_stated)
    model = build_model(plain)
    none = SimpleNamespace(machine=plain, state_noise=0.0 * model.state_noise, drift=model.drift)
    with pytest.raises(ValueError, match="refuses the weights"):
        free.estimate(signals, weights=cast(Model, none))


def assert_same_estimates(found: Estimates, expected: Estimates) -> None:
    for column in ("parameters", "std", "status"):
        np.testing.assert_array_equal(getattr(found, column), getattr(expected, column))


# --- a whole diagnosis ------------------------------------------------------------------------------------------


def same_but_for_its_duration(one: Diagnosis, other: Diagnosis) -> None:
    first, second = (replace(d, seconds=0.0).to_json() for d in (one, other))
    assert repr(first) == repr(second)
    for field in fields(one.traces):
        np.testing.assert_array_equal(getattr(one.traces, field.name), getattr(other.traces, field.name), field.name)


@pytest.mark.slow
def test_one_and_two_workers_say_the_same_to_the_bit(
    machine: Machine, log: Log, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, ran = [0, 0], [0, 0]
    get = Runs.get
    found, compiled = [], []
    for k, count in enumerate(("1", "2")):

        def looked_up(self: Runs, code: Any, along: Any, *arguments: Any, at: int = k) -> Any:
            model = isinstance(along, Signals)  # elements of an identification run along arrays

            def counted() -> Any:
                ran[at] += model
                return run()

            asked[at] += model
            *asked_for, run = arguments
            return get(self, code, along, *asked_for, counted)

        monkeypatch.setattr(Runs, "get", looked_up)
        monkeypatch.setenv(VARIABLE, count)
        compile_once.cache_clear()
        found.append(diagnose(machine, log))
        compiled.append(compile_once.cache_info())
    assert [cause.name for cause in found[0].causes] == ["force_ripple"]
    same_but_for_its_duration(*found)
    assert compiled[0].misses == compiled[0].currsize == compiled[1].misses == compiled[1].currsize  # once each
    assert asked[0] == asked[1]
    assert max(ran) < 0.9 * asked[0]  # the others were known
