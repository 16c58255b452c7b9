"""Emitted packages and the runtime headers are C++17 as well as C99, with the same numbers."""

import ctypes
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from c_packages import PRECISIONS, PROBES, Array, build, compile_object, run, written
from package_variants import VARIANTS
from sgms_mhe.host.compiled import replay_definitions
from sgms_mhe.support.paths import runtime_dir
from sgms_mhe.support.toolchain import WARNING_FLAGS

Tool = Callable[[str], str]

LANGUAGE = ("-x", "c++", "-std=c++17", "-Wpedantic", *(w for w in WARNING_FLAGS if w != "-Wmissing-prototypes"))
NUMBERS = ("-O2", "-ffp-contract=off", "-fPIC")
PACKAGES = (
    "machine etel_xy", "machine etel_xy_controller", "machine etel_xy_paper", "machine emps",
    "machine etel_xy_switching", "switching, 5 merged", "switching, levels, 5 merged",
    "flow, ekf", "flow, 5 merged", "rk4, all", "rk4, fixed", "accuracy",
    "horizon 1", "bounds of two, 5 merged", "linear model", "compensation, effects",
    "every effect, single", "every effect, fixed, rk4, 4 merged",
    "effects: time", "effects: upstream, 5 merged, single", "toy, states", "toy, single",
    "position loop with all, single", "voltage",
)  # fmt: skip
"""Variants whose code differs in kind: double and single precision, MHE and filter, effects."""


@pytest.mark.slow
@pytest.mark.parametrize("title", PACKAGES)
def test_package_is_cplusplus(title: str, require_tool: Tool, tmp_path: Path) -> None:
    package = VARIANTS[title].package
    source = written(package, tmp_path) / f"{package.machine.name}.c"
    run(require_tool("clang++"), LANGUAGE, "-fsyntax-only", source)
    # What C++20 deprecates, C++26 has no more: arithmetic of two enumerations.
    newest = ("-x", "c++", "-std=c++20", "-Wdeprecated", "-Werror", "-fsyntax-only")
    run(require_tool("clang++"), newest, sorted(source.parent.glob("*.c")))
    # gcc finds some of what it warns of only as it optimises.
    compile_object(require_tool("g++"), source, LANGUAGE, "-O1")


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("header", sorted(path.name for path in runtime_dir().glob("sgms_*.h")))
def test_runtime_header_is_cplusplus(header: str, precision: str, require_tool: Tool, tmp_path: Path) -> None:
    source = tmp_path / "alone.cpp"
    source.write_text(f'#include "{header}"\n')
    single = f"-DSGMS_SINGLE={int(precision == 'single')}"
    unused = "-Wno-unused-function"  # nothing calls what the header brings
    compile_object(require_tool("g++"), source, LANGUAGE, unused, single, f"-I{runtime_dir()}")


def estimates(library: Path) -> Array:
    """What every update of a motion through a package gives, compensation of every sample behind it."""
    c = ctypes.CDLL(str(library))
    c.probe_size.restype = ctypes.c_size_t
    c.probe_tick.restype = ctypes.c_double
    c.probe_tick.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_double]
    memory = ctypes.create_string_buffer(c.probe_size())
    row = (ctypes.c_double * c.probe_numbers())()
    c.probe_init(memory)
    c.probe_compensate(memory, 1)
    numbers: list[float] = []
    for k in range(1201):
        position, velocity = 4e-5 * np.sin(0.01 * k) + 2e-3 * np.sin(0.002 * k), np.cos(0.01 * k)
        numbers.append(c.probe_tick(memory, position, 3.0 * np.tanh(4.0 * velocity) + velocity))
        status = c.probe_estimate(memory, row)
        numbers += [*row, status]
    return np.array(numbers)


@pytest.mark.parametrize("title", ["machine etel_xy", "machine etel_xy_controller", "flow, ekf", "toy, states"])
def test_compiled_as_cplusplus_it_gives_the_same_bits(title: str, require_tool: Tool, tmp_path: Path) -> None:
    package = VARIANTS[title].package
    name = package.machine.name
    folder = written(package, tmp_path)
    probe = (f"-I{folder}", *replay_definitions(name), *NUMBERS)
    found = []
    for language, compiler, standard in (("c", "gcc", "c99"), ("c++", "g++", "c++17")):
        options = ["-x", language, f"-std={standard}", *NUMBERS]
        code = compile_object(require_tool(compiler), folder / f"{name}.c", options)
        sources, library = [PROBES / "estimator_probe.c", code], tmp_path / f"{compiler}.so"
        found.append(estimates(build(require_tool("gcc"), sources, library, "-shared", probe)))
    assert np.isfinite(found[0]).all() and np.ptp(found[0]) > 1.0
    assert found[0].tobytes() == found[1].tobytes()
