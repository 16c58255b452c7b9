"""A package's C from other languages: the same numbers as the C alone, and refusals that are said."""

import ctypes
import zipfile
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from fmpy.validation import validate_fmu

from binding_cases import COUNTS, KINDS, PITCH, PLACES, module_of, outputs_of
from c_packages import QUICK, STRICT, compile_object, run, written
from cli_cases import SMALL, done, refused
from package_variants import VARIANTS
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.emission.bindings import BINDINGS, binding_files
from sgms_mhe.emission.layout import memory_of
from sgms_mhe.emission.package import emit_package
from sgms_mhe.host.compiled import CompiledEstimator
from sgms_mhe.support.errors import InputError

Tool = Callable[[str], str]


# --- Python ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def python(bound: Any) -> Callable[[str], ModuleType]:
    modules: dict[str, ModuleType] = {}
    return lambda kind: modules.get(kind) or modules.setdefault(kind, module_of(bound(kind).folder))


@pytest.mark.parametrize("kind", KINDS)
def test_python_gives_what_the_package_gives(kind: str, bound: Any, python: Any) -> None:
    settings, log, module = bound(kind).machine, bound(kind).log, python(kind)
    expected = CompiledEstimator(settings, bound(kind).package).estimate_log(log, mode="tasks")
    estimator = module.Estimator()
    half = len(log.position_m) // 2 + 17
    parts = [
        estimator.estimate(log.position_m[:half], log.force_N[:half]),
        estimator.estimate(log.position_m[half:], log.force_N[half:]),
    ]
    outputs = outputs_of(expected) | {"compensation": expected.extra["compensation_N"]}
    for name in ("doubt", *COUNTS):  # of the status, which is whole here; of the estimator
        del outputs[name]
    for name, wanted in outputs.items():
        np.testing.assert_array_equal(np.concatenate([getattr(part, name) for part in parts]), wanted, err_msg=name)
    samples = np.concatenate([parts[0].sample, parts[1].sample + half])
    np.testing.assert_array_equal(samples, settings.sampling.samples_per_update * np.arange(1, len(samples) + 1))
    assert expected.parameter_names == module.PARAMETERS and log.rate == module.RATE
    assert np.ptp(expected.parameters[:, 0]) > 0.0 and parts[0].parameter.shape[1] == len(module.PARAMETERS)


def test_python_sample_by_sample_is_the_same(bound: Any, python: Any) -> None:
    log, module = bound("double").log, python("double")
    series, single = module.Estimator(), module.Estimator()
    found = series.estimate(log.position_m, log.force_N)
    fed = [single.sample(q, u) for q, u in zip(log.position_m, log.force_N, strict=True)]
    np.testing.assert_array_equal(fed, found.compensation)
    assert single.save() == series.save()
    assert series.estimate(np.empty(0), np.empty(0)).parameter.shape == (0, len(module.PARAMETERS))
    assert isinstance(series.status, str) and series.status
    updates, rest = len(found.sample), len(log.position_m) - 1 - int(found.sample[-1])
    assert (single.update, single.age, single.numeric) == (updates, rest, 0) and updates > 3


@pytest.mark.parametrize("kind", KINDS)
def test_python_has_the_memory_that_the_header_declares(kind: str, bound: Any, python: Any) -> None:
    package, module = bound(kind).package, python(kind)
    real = "float" if bound(kind).machine.code.precision == "single" else "double"
    memory = memory_of(package.files, bound(kind).machine.name, real)
    assert ctypes.sizeof(module._Saved) == memory.saved
    assert ctypes.sizeof(module._Estimate) == memory.estimate


def test_python_over_its_life(bound: Any, python: Any) -> None:
    log, module = bound("double").log, python("double")
    estimator, name = module.Estimator(), module.PARAMETERS[1]
    first = estimator.estimate(log.position_m, log.force_N)
    saved, other = estimator.save(), module.Estimator()
    other.load(saved)
    held = first.parameter[-1, 1]
    other.hold(name)
    other.set_mass(21.0)
    after = other.estimate(log.position_m, log.force_N)
    np.testing.assert_allclose(after.parameter[:, 1], held, rtol=1e-4)
    other.set_parameter(name, 1.1 * held)
    np.testing.assert_allclose(other.estimate(log.position_m, log.force_N).parameter[:, 1], 1.1 * held, rtol=1e-4)
    settings = estimator.settings()
    settings.measurement *= 3.0
    wide = module.Estimator(settings=settings).estimate(log.position_m, log.force_N)
    assert np.abs(wide.deviation - first.deviation).max() > 0.0
    other.reset()
    other.compensate(False)
    other.ahead(0.1, 0.0)


def test_python_sets_the_origin(bound: Any, python: Any) -> None:
    log, module = bound(PLACES).log, python(PLACES)
    homed, other, unaware = (module.Estimator() for _ in range(3))
    other.set_origin(0.4 * PITCH)
    wanted = homed.estimate(log.position_m, log.force_N)
    found, wrong = (each.estimate(log.position_m + 0.4 * PITCH, log.force_N) for each in (other, unaware))
    np.testing.assert_allclose(found.parameter, wanted.parameter, rtol=1e-6)
    assert np.abs(found.compensation - wanted.compensation).max() < 1e-5
    assert np.abs(wrong.compensation - wanted.compensation).max() > 0.5
    with pytest.raises(ValueError, match="origin: refused"):
        other.set_origin(float("nan"))
    assert not hasattr(python("double").Estimator, "set_origin")


def test_python_says_what_is_refused(bound: Any, python: Any, tmp_path: Path) -> None:
    module = python("double")
    estimator = module.Estimator()
    damaged = bytearray(estimator.save())
    damaged[-1] ^= 1
    settings = estimator.settings()
    settings.measurement = float("nan")
    for call, said in (
        (lambda: estimator.load(bytes(damaged)), "what was saved: refused"),
        (lambda: estimator.load(b""), "what was saved: refused"),
        (lambda: estimator.set_mass(-1.0), "mass: refused"),
        (lambda: estimator.set_parameter(module.PARAMETERS[0], -1.0, 1.0), "stiffness_1: refused"),
        (lambda: estimator.hold("stifness_1"), "stifness_1: not one of stiffness_1"),
        (lambda: estimator.estimate(np.zeros(3), np.zeros(2)), "position has 3 samples"),
        (lambda: module.Estimator(settings=settings), "settings: refused"),
    ):
        with pytest.raises(ValueError, match=said):
            call()
    library = module.build(tmp_path / "etel_xy.so")
    assert module.Estimator(library).save() == module.Estimator().save()
    assert module.Estimator()._c is module.Estimator()._c  # compiled once
    with pytest.raises(RuntimeError, match="no-such-compiler"):
        module.build(tmp_path / "none.so", "no-such-compiler")


def test_python_refuses_the_library_of_another_package(bound: Any, python: Any, tmp_path: Path) -> None:
    other = python("ekf").build(tmp_path / "other.so")
    with pytest.raises(RuntimeError, match="not the library of etel_xy"):
        python("double").Estimator(other)


# --- C++ ---------------------------------------------------------------------------------------------------------

CPP = r"""
#include "NAME.hpp"

#include <cstdio>
#include <cstring>

namespace observer = NAME;

static observer::axis one, two;
static NAME_t plain, plain_two;

static int differ(const observer::estimate &a, const NAME_estimate_t &b)
{
    return a.friction != b.friction || std::memcmp(a.parameter, b.parameter, sizeof a.parameter) != 0 ||
           std::memcmp(a.deviation, b.deviation, sizeof a.deviation) != 0 || a.status != b.status;
}

int main()
{
    long wrong = one.init() != 0 || two.init(observer::machine_settings()) != 0;
    NAME_init(&plain);
    NAME_init(&plain_two);
    for (long k = 0; k <= 30L * observer::axis::samples; k++) {
        const double forth = static_cast<double>((k / 1500) % 2 ? 1500 - k % 1500 : k % 1500) / 1500.0;
        const observer::position at = observer::from_METRES(0.3 + 1e-3 * forth);
        const observer::real push = static_cast<observer::real>((k / 1500) % 2 ? -4 : 4);
        wrong += one.tick(at, push) != NAME_tick(&plain, at, push);
        wrong += two.sample(at, push) != NAME_sample(&plain_two, at, push);
        if (NAME_due(&plain_two)) {
            NAME_feedback(&plain_two);
        }
        if (k % observer::axis::samples == 40) {
            two.prepare();
            NAME_prepare(&plain_two);
        }
        NAME_estimate_t found;
        NAME_estimate(&plain, &found);
        wrong += differ(one.now(), found);
        NAME_estimate(&plain_two, &found);
        wrong += differ(two.now(), found);
    }
    observer::saved saved, again;
    wrong += one.save(saved) != 0 || two.load(saved) != 0 || two.save(again) != 0;
    wrong += std::memcmp(saved.theta, again.theta, sizeof saved.theta) != 0;
    saved.theta[0] += 1;
    wrong += two.load(saved) != static_cast<int>(observer::status::refused);
    wrong += two.set_mass(-1) != static_cast<int>(observer::status::refused);
#ifdef PLACES
    wrong += two.set_origin(observer::from_METRES(0.1)) != 0;
    wrong += two.set_origin(observer::from_METRES(5e6)) != static_cast<int>(observer::status::refused);
#endif
    wrong += two.hold(0, true) != 0 || two.hold(observer::axis::parameters, true) == 0;
    wrong += two.set_parameter(0, one.now().parameter[0], 0) != 0;
    wrong += !observer::has(two.now().status, observer::status::filling) || observer::has(-1, observer::status::hold);
    two.ahead(0, 0);
    two.compensate(false);
    two.reset();
    observer::signals signals = observer::signals();
    (void)two.insert(signals);
    std::printf("%ld %d\n", wrong, two.share() >= 0);
    return wrong != 0;
}
"""


@pytest.mark.parametrize("kind", [*KINDS, PLACES])
@pytest.mark.parametrize("compiler", ["g++ -std=c++11", "g++ -std=c++17", "clang++ -std=c++17"])
def test_cpp_gives_what_the_c_gives(kind: str, compiler: str, bound: Any, require_tool: Tool, tmp_path: Path) -> None:
    settings, folder = bound(kind).machine, bound(kind).folder
    name, (tool, standard) = settings.name, compiler.split()
    source, program = tmp_path / "main.cpp", tmp_path / "program"
    source.write_text(CPP.replace("NAME", name).replace("METRES", settings.plant.units.metres))
    plain = compile_object(require_tool("gcc"), folder / f"{name}.c", QUICK)
    strict = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror", "-fno-exceptions", "-fno-rtti"]
    strict += ["-DPLACES"] if kind == PLACES else []
    run(require_tool(tool), standard, strict, "-O1", f"-I{folder}", source, plain, "-o", program)
    assert run(program) == "0 1\n"


# --- asking for them ---------------------------------------------------------------------------------------------


def test_bindings_come_where_they_are_asked_for(tmp_path: Path) -> None:
    path, out = tmp_path / "small.toml", tmp_path / "out"
    path.write_text(SMALL)
    done("generate", path, "--out", out, "--bindings", " cpp, python ")
    assert {p.suffix for p in out.iterdir()} >= {".py", ".hpp"}
    assert [list(binding_files(names, "axis")) for names in (["cpp"], ["python"], [])] == [
        ["axis.hpp"],
        ["axis.py"],
        [],
    ]
    assert "one of python, cpp, " in refused("generate", path, "--out", tmp_path / "none", "--bindings", "matlab")
    assert not (tmp_path / "none").exists()
    with pytest.raises(InputError, match=r"fmu3; did you mean (?:fmu3 or fmu2|fmu2 or fmu3)\?"):
        binding_files(["fmu"], "axis")
    for former in ("iec", "simulink"):
        with pytest.raises(InputError, match="one of python, cpp, fmu2, fmu3"):
            binding_files(["python", former], "axis")
    said = " ".join(done("generate", "--help").output.split())
    assert f"with commas: {', '.join(BINDINGS)}." in said
    for unknown in ([""], ["python", "", "cpp"]):
        with pytest.raises(InputError, match="one of python, cpp, "):
            binding_files(unknown, "axis")


# --- every kind of package ---------------------------------------------------------------------------------------

SHAPES = (
    "effects: states", "two ripples", "geared, ekf", "geared, single", "switching, compensation, single",
    "n_z 10, single", "sample an update", "horizon 1", "compensation off", "machine etel_xy_controller",
)  # fmt: skip
"""Variants whose parameters, states, units or rates differ in kind."""


@pytest.mark.slow
@pytest.mark.parametrize("title", SHAPES)
def test_every_kind_of_package_has_every_binding(title: str, require_tool: Tool, tmp_path: Path) -> None:
    """What is C compiles without a warning, and what describes it says the same of it."""
    variant = VARIANTS[title]
    settings = override_machine(load_machine(variant.machine), variant.changes)
    package = emit_package(settings, selftest=False, bindings=BINDINGS)
    name, folder, gcc = settings.name, written(package, tmp_path), require_tool("gcc")
    assert not package.missing
    for version in (2, 3):
        archive = folder / f"{name}_fmi{version}.fmu"
        zipfile.ZipFile(archive).extractall(tmp_path / str(version))
        run(gcc, STRICT, "-fsyntax-only", tmp_path / str(version) / "sources" / f"{name}_fmi{version}.c")
        assert validate_fmu(str(archive)) == []
    compile((folder / f"{name}.py").read_text(), name, "exec")
