"""Emitted packages as a firmware project takes them: bytes, compilers, linking, calls, impossible input."""

import ctypes
import itertools
import os
import re
import subprocess
import sys
from collections.abc import Callable, Mapping
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from c_packages import (
    PRECISIONS,
    PROBES,
    STRICT,
    Array,
    build,
    compile_object,
    machine,
    package_of,
    pointer,
    probed,
    run,
    scheme,
    symbols,
    written,
)
from reference_cases import linear_model
from sgms_bench import C_DIR
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.emission.package import Package, emit_package, write_package
from sgms_mhe.host.compiled import replay_definitions
from sgms_mhe.machine import Machine, merge_tables
from sgms_mhe.machine.file import RESERVED_NAMES
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import make_trajectory
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.paths import runtime_dir

Tool = Callable[[str], str]

# What changes the shape of the emitted code.
VARIANTS: dict[str, dict[str, Any]] = {
    "flow": {},
    "rk4": {"sampling": scheme("rk4")},
    "merged": {"sampling": scheme("flow", substeps=50)},
    "ekf": {"estimator": {"kind": "ekf"}},
    "ekf, no bounds": {"estimator": {"kind": "ekf", "parameters": ["coulomb", "viscous"], "bounds": {}}},
    "one parameter": {"estimator": {"parameters": ["viscous"], "bounds": {}}},
    "all parameters": {
        "estimator": {
            "parameters": ["stiffness", "coulomb", "viscous", "stribeck_ratio", "stribeck_velocity"],
            "bounds": {},
        }
    },
    "fixed, horizon 1": {"estimator": {"horizon": 1, "arrival_cost": {"update": "fixed"}}},
    "horizon 2": {"estimator": {"horizon": 2}},
    "auto": {"estimator": {"relinearise": "auto"}},
    "auto, rk4": {"estimator": {"relinearise": "auto"}, "sampling": scheme("rk4")},
    "auto, accuracy": {"estimator": {"relinearise": "auto"}, "code": {"accuracy": 1e-3}},
    "newest": {"estimator": {"relinearise": "newest"}},
    "newest, rk4": {"estimator": {"relinearise": "newest"}, "sampling": scheme("rk4")},
    "level of its own": {"effects": [{"name": "dwell_dependence"}], "estimator": {"relinearise": "auto"}},
    "ripple": {
        "effects": [{"name": "force_ripple", "pitch_m": 0.032, "amplitude_N": 0.8, "phase_rad": 0.7}],
        "estimator": {"parameters": ["stiffness", "force_ripple.amplitude_N"]},
    },
}


# --- bytes -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_same_machine_same_bytes(tmp_path: Path) -> None:
    """In this process twice, and in another with other hashes, another folder, another language."""
    script = (
        "import sys; from pathlib import Path; from sgms_mhe.configuration import load_machine, override_machine\n"
        "from sgms_mhe.emission.package import emit_package, write_package\n"
        "for single in (False, True):\n"
        "    m = override_machine(load_machine('etel_xy'), {'code': {'precision': 'single' if single else 'double'},\n"
        "        'estimator': {'horizon': 5}})\n"
        "    write_package(emit_package(m), Path(sys.argv[1]) / str(single))\n"
    )
    elsewhere = {**os.environ, "PYTHONHASHSEED": "4711", "LANG": "C", "LC_ALL": "C", "TZ": "X4"}
    command = [sys.executable, "-c", script, str(tmp_path)]
    done = subprocess.run(command, cwd=tmp_path, env=elsewhere, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for single in (False, True):
        precision = "single" if single else "double"
        changes = {"code": {"precision": precision}, "estimator": {"horizon": 5}}
        settings = override_machine(load_machine("etel_xy"), changes)
        here = emit_package(settings).files
        assert emit_package(settings, selftest=False).files == emit_package(settings, selftest=False).files
        folder = tmp_path / str(single)
        assert sorted(here) == sorted(p.name for p in folder.iterdir())
        for file, text in here.items():
            assert (folder / file).read_bytes() == text.encode(), file


def test_package_tells_where_it_comes_from_and_nothing_else(repo_root: Path) -> None:
    package = package_of(selftest=True)
    for file, text in package.files.items():
        assert str(repo_root) not in text and "/home/" not in text and "/tmp/" not in text, file
        assert not re.search(r"\b20\d\d-\d\d-\d\d\b", text), file
        assert text.endswith("\n") and "\t" not in text and "\r" not in text, file
        assert not re.search(r"[ ]+$", text, re.MULTILINE), f"{file}: trailing blanks"
    assert package.machine.digest[:12] in package.files["etel_xy.c"].splitlines()[0]
    assert machine(plant={"mass": 21.0}).digest != package.machine.digest


def test_folder_is_replaced_as_a_whole(tmp_path: Path) -> None:
    folder = tmp_path / "etel_xy"
    write_package(package_of(), folder)
    assert (folder / "etel_xy_flow.h").exists()
    write_package(package_of(**VARIANTS["rk4"]), folder)
    assert not (folder / "etel_xy_flow.h").exists()
    assert [p.name for p in tmp_path.iterdir()] == ["etel_xy"]
    (folder / "notes.md").write_text("mine")
    with pytest.raises(InputError, match=r"notes\.md"):
        write_package(package_of(), folder)
    assert (folder / "notes.md").exists() and (folder / "etel_xy.c").exists()


def test_names_that_would_collide_are_refused() -> None:
    """Whatever else in a package, or in the runtime, ends like a public symbol: its beginning is no machine's name."""
    variants = ["flow", "merged", "auto", "ekf", "level of its own"]
    changes = [VARIANTS[v] for v in variants] + [{"effects": [{"name": "backlash"}, {"name": "actuator_lag"}]}]
    for package in (package_of(**c, code={"precision": p}) for c in changes for p in PRECISIONS):
        code = "".join(text for file, text in package.files.items() if file.endswith((".c", ".h")))
        public = set(re.findall(r"\b(?:etel_xy|ETEL_XY)_(\w+)\b(?!\.h)", code))
        ending = re.compile(rf"\b(?!etel_xy|ETEL_XY)([A-Za-z]\w*?)_(?:{'|'.join(sorted(public))})\b")
        code = re.sub(r"/\*.*?\*/", "", code, flags=re.DOTALL)
        begins = {match.group(1) for match in ending.finditer(code)}
        assert {"take", "int32"} <= {name.lower() for name in begins}
        assert not [name for name in begins if not RESERVED_NAMES.fullmatch(name)]
        headers = [file for file in package.files if file.endswith(".h") and not file.startswith("etel_xy")]
        assert all(RESERVED_NAMES.fullmatch(file.removesuffix(".h").lower()) for file in headers)


# --- compilers ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("level", ["-O0", "-O2", "-O3"])
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_no_warning(compiler: str, level: str, precision: str, require_tool: Tool, tmp_path: Path) -> None:
    folder = written(package_of(code={"precision": precision}), tmp_path)
    compile_object(require_tool(compiler), folder / "etel_xy.c", STRICT, level)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("variant", list(VARIANTS))
def test_no_warning_in_any_variant(variant: str, precision: str, require_tool: Tool, tmp_path: Path) -> None:
    folder = written(package_of(**merge_tables(VARIANTS[variant], {"code": {"precision": precision}})), tmp_path)
    compile_object(require_tool("gcc"), folder / "etel_xy.c", STRICT, "-O1")
    run(require_tool("clang"), STRICT, "-fsyntax-only", folder / "etel_xy.c")


def test_no_warning_where_states_are_coupled(require_tool: Tool, tmp_path: Path) -> None:
    model = linear_model(bounds={"stiffness": [0.5, 2.0]})
    folder = written(emit_package(model.machine, model, selftest=False), tmp_path)
    for compiler in ("gcc", "clang"):
        compile_object(require_tool(compiler), folder / "etel_xy.c", STRICT, "-O1")


@pytest.mark.parametrize("precision", PRECISIONS)
def test_helpers_of_the_host_without_a_warning(precision: str, require_tool: Tool, tmp_path: Path) -> None:
    folder = written(package_of(code={"precision": precision}), tmp_path)
    for source in ("replay.c", "predict.c"):
        compile_object(
            require_tool("gcc"), runtime_dir() / source, STRICT, replay_definitions("etel_xy"), f"-I{folder}"
        )


@pytest.mark.parametrize("kind", ["mhe", "ekf"])
@pytest.mark.parametrize("precision", PRECISIONS)
def test_harness_passes_the_self_test_of_its_package(
    precision: str, kind: str, require_tool: Tool, tmp_path: Path
) -> None:
    package = package_of(selftest=True, code={"precision": precision}, estimator={"kind": kind})
    folder = written(package, tmp_path)
    own = [f'-DSGMS_CONFIG_HEADER="{folder.name}_config.h"', "-DSGMS_SELFTEST"]
    sources = [folder / "etel_xy.c", folder / "etel_xy_selftest.c", C_DIR / "harness.c"]
    options = [*STRICT, "-O1", *replay_definitions("etel_xy"), *own, f"-I{folder}"]
    harness = build(require_tool("gcc"), sources, tmp_path / "harness", options)
    assert "selftest passed" in run(harness, "--selftest")
    rows = run(harness, "--motion", "30").splitlines()
    assert len(rows) == 31 and all(np.isfinite([float(f) for f in row.split(",")]).all() for row in rows[1:])
    for bad in (["--motion", "0"], ["--log", "absent.csv"], ["--nonsense"], []):
        assert subprocess.run([harness, *bad], capture_output=True, check=False).returncode == 2


def test_runtime_of_another_version_is_refused(require_tool: Tool, tmp_path: Path) -> None:
    folder = written(package_of(), tmp_path)
    header = folder / "sgms_real.h"
    text, count = re.subn(r"(#define SGMS_RUNTIME_VERSION) \d+", r"\1 999", header.read_text())
    assert count == 1
    header.write_text(text)
    with pytest.raises(AssertionError, match="another version than this package: run sgms-mhe generate again"):
        run(require_tool("gcc"), "-std=c99", "-fsyntax-only", folder / "etel_xy.c")


def test_runtime_without_a_precision_is_refused(require_tool: Tool, tmp_path: Path) -> None:
    source = tmp_path / "bare.c"
    source.write_text('#include "sgms_linalg.h"\n')
    with pytest.raises(AssertionError, match="define SGMS_SINGLE"):
        run(require_tool("gcc"), "-std=c99", "-fsyntax-only", f"-I{runtime_dir()}", source)


@pytest.mark.parametrize(
    ("compiler", "flags"),
    [
        *((c, [f]) for c in ("gcc", "clang") for f in ("-ffast-math", "-Ofast", "-ffinite-math-only")),
        *(("gcc", [f]) for f in ("-funsafe-math-optimizations", "-freciprocal-math", "-fno-signed-zeros")),
        ("gcc", ["-fassociative-math", "-fno-signed-zeros", "-fno-trapping-math"]),
    ],
)
def test_relaxed_arithmetic_is_refused(compiler: str, flags: list[str], require_tool: Tool, tmp_path: Path) -> None:
    folder = written(package_of(), tmp_path)
    command = [require_tool(compiler), "-std=c99", "-O2", "-fsyntax-only", folder / "etel_xy.c"]
    run(command, "-ffp-contract=fast", "-fno-math-errno")
    with pytest.raises(AssertionError, match="wrong in silence"):
        run(command, flags)


def test_excess_precision_and_short_numbers_are_refused(require_tool: Tool, tmp_path: Path) -> None:
    folder = written(package_of(), tmp_path)
    command = [require_tool("gcc"), "-std=c99", "-fsyntax-only", folder / "etel_xy.c"]
    with pytest.raises(AssertionError, match="without excess precision"):
        run(command, "-mfpmath=387")
    short = ["-U__DBL_MANT_DIG__", "-D__DBL_MANT_DIG__=24", "-U__DBL_MAX_EXP__", "-D__DBL_MAX_EXP__=128"]  # AVR's
    with pytest.raises(AssertionError, match="double has to be"):
        run(command, short)


def test_compiler_without_a_known_barrier_is_refused(require_tool: Tool, tmp_path: Path) -> None:
    folder = written(package_of(), tmp_path)
    command = [require_tool("gcc"), "-std=c99", "-ffreestanding", "-U__GNUC__", "-fsyntax-only", folder / "etel_xy.c"]
    with pytest.raises(AssertionError, match=r"SGMS_FENCE\(\) as a barrier"):
        run(command)
    run(command, "-DSGMS_ONE_TASK")
    run(command, "-DSGMS_FENCE()=its_own()", "-include", "stdint.h", "-Dits_own()=((void)0)")


NOT_SAID = {
    "no NaN": ("clang", ["-fno-honor-nans"]),
    "finite only": ("clang", ["-ffinite-math-only", "-U__FINITE_MATH_ONLY__"]),
    "finite only, gcc": ("gcc", ["-ffinite-math-only", "-U__FINITE_MATH_ONLY__"]),
    "associative": ("clang", ["-fassociative-math", "-fno-signed-zeros", "-fno-trapping-math"]),
    "excess precision": ("gcc", ["-mfpmath=387", "-U__FLT_EVAL_METHOD__", "-D__FLT_EVAL_METHOD__=-1"]),
    "flush to zero": ("gcc", ["-DMXCSR=0x9fc0"]),
    "towards zero": ("gcc", ["-DMXCSR=0x7f80"]),
}
"""Compilers and options of which no macro tells, and settings of the processor (x86)."""
STATUS_ARITHMETIC = -6


@pytest.mark.skipif(os.uname().machine != "x86_64", reason="options and settings are x86-64's")
@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("title", [None, *NOT_SAID])
def test_arithmetic_that_no_macro_tells_of_is_noticed(
    title: str | None, precision: str, require_tool: Tool, tmp_path: Path
) -> None:
    """By the handshake, the self-test and every update; nothing is fed forward, also where the signal is no number."""
    compiler, flags = NOT_SAID[title] if title else ("clang", [])
    package = package_of(selftest=True, estimator={"horizon": 3}, code={"precision": precision})
    folder = written(package, tmp_path)
    options = ["-std=c99", "-O2", *flags, f"-I{folder}", *replay_definitions("etel_xy")]
    sources = [PROBES / "unsound.c", folder / "etel_xy.c", folder / "etel_xy_selftest.c"]
    program = build(require_tool(compiler), sources, tmp_path / "program", options)
    check, selftest, first, update, after, fed = map(int, run(program).split())
    if title is None:
        assert (check, selftest, first) == (0, 0, 1) and update >= 0 and after >= 0 and fed > 100
    else:
        assert check == first == update == after == STATUS_ARITHMETIC and selftest > 0 and fed == 0


STATUS_UNSTARTED, STATUS_REFUSED = -7, -5
RIPPLE: Mapping[str, Any] = {"name": "force_ripple", "amplitude_N": 0.6, "pitch_m": 0.004}


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("estimator", [{"horizon": 3}, {"horizon": 3, "relinearise": "auto"}, {"kind": "ekf"}])
def test_memory_without_init_is_no_axis(
    estimator: Mapping[str, Any], precision: str, require_tool: Tool, tmp_path: Path
) -> None:
    """Every call returns 0 or UNSTARTED, and what it saves is taken by nobody; init then starts an axis."""
    package = package_of(estimator=estimator, code={"precision": precision}, effects=[RIPPLE])
    header = re.search(r"HEADER 0x(\w+)u", package.files["etel_xy.h"])
    assert header is not None and len(set(re.findall("..", header[1]))) > 1, "a byte repeated: memory may be full of it"
    folder = written(package, tmp_path)
    command = [require_tool("gcc"), "-std=c99", "-O1", "-DHAS_ORIGIN", f"-I{folder}", *replay_definitions("etel_xy")]
    run(command, PROBES / "unstarted.c", folder / "etel_xy.c", "-lm", "-o", tmp_path / "program")
    for line in run(tmp_path / "program").splitlines():
        *statuses, largest, loaded, first = line.split()
        assert set(map(int, statuses)) == {STATUS_UNSTARTED} and len(statuses) == 16, line
        assert (float(largest), int(loaded), int(first)) == (0.0, STATUS_REFUSED, 1), line


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("compiler", ["gcc", "clang", "arm-none-eabi-gcc"])
def test_library_is_asked_for_three_functions_of_memory_alone(
    compiler: str, precision: str, require_tool: Tool, tmp_path: Path
) -> None:
    folder = written(package_of(code={"precision": precision}), tmp_path)
    fpu = ["-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-d16", "-mfloat-abi=hard"] if "arm" in compiler else []
    for level in ("-O1", "-O2", "-O3", "-Os"):
        made = compile_object(require_tool(compiler), folder / "etel_xy.c", "-std=c99", level, fpu)
        foreign = {name for kind, name in symbols(made) if kind == "U" and not name.startswith("__")}
        assert foreign <= {"memcpy", "memmove", "memset"}, level


# --- linking -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize(("compiler", "level"), [("gcc", "-O0"), ("gcc", "-O3"), ("clang", "-O2"), ("gcc", "-Os")])
def test_freestanding(compiler: str, level: str, precision: str, require_tool: Tool, tmp_path: Path) -> None:
    """Links without any library; the object needs memcpy and memset at most, has no data, exports its prefix alone."""
    tool = require_tool(compiler)
    folder = written(package_of(code={"precision": precision}), tmp_path)
    free = ["-ffreestanding", "-fno-pie", "-fno-stack-protector", level]
    package = compile_object(tool, folder / "etel_xy.c", "-std=c99", free)
    found = symbols(package)
    assert {name for kind, name in found if kind == "U"} <= {"memcpy", "memset"}
    assert not [(kind, name) for kind, name in found if kind in "BbDdCcGgSs"], "writable globals"
    exported = {name for kind, name in found if kind.isupper() and kind != "U"}
    public = "check init reset tick sample insert ahead compensate share due prepare feedback estimate status_text"
    public += " settings init_with set_mass hold set_parameter save load"
    assert exported == {f"etel_xy_{name}" for name in public.split()}
    # The program brings its own two functions only where the compiler wants them.
    (tmp_path / "memory.c").write_text(
        "#include <stddef.h>\n"
        "void *memcpy(void *to, const void *from, size_t n) { char *t = to; const char *f = from;"
        " while (n--) *t++ = *f++; return to; }\n"
        "void *memset(void *to, int value, size_t n) { char *t = to; while (n--) *t++ = (char)value; return to; }\n"
    )
    files = [f"-I{folder}", PROBES / "freestanding.c", tmp_path / "memory.c", package, "-o", tmp_path / "program"]
    run(tool, "-std=c99", free, replay_definitions("etel_xy"), "-fno-builtin", "-nostdlib", "-static", "-no-pie", files)


@pytest.mark.needs_arm
@pytest.mark.parametrize("variant", ["flow", "rk4", "ekf"])
def test_single_precision_has_no_double_arithmetic(variant: str, require_tool: Tool, tmp_path: Path) -> None:
    folder = written(package_of(**merge_tables(VARIANTS[variant], {"code": {"precision": "single"}})), tmp_path)
    cpu = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16", "-ffreestanding", "-O2"]
    package = compile_object(require_tool("arm-none-eabi-gcc"), folder / "etel_xy.c", "-std=c99", cpu)
    needed = {name for kind, name in symbols(package) if kind == "U"}
    # The position is a 64-bit integer; nothing else needs help.
    assert needed <= {"memcpy", "memset", "__aeabi_l2f"}
    assert not [name for name in needed if "_d" in name or "2d" in name]


@pytest.mark.parametrize("language", ["c", "c++"])
def test_two_machines_in_one_program(language: str, require_tool: Tool, tmp_path: Path) -> None:
    """Double and single side by side, one of them twice: the numbers they give alone. The program as C and as C++."""
    other = {"name": "lower", "code": {"precision": "single"}, "estimator": {"horizon": 5, "kind": "mhe"}}
    packages = [written(package_of(), tmp_path), written(package_of(**other), tmp_path)]
    sources = packages[0] / "etel_xy.c", packages[1] / "lower.c"
    made = [compile_object(require_tool("gcc"), source, "-std=c99", "-O2") for source in sources]
    tool = require_tool("g++" if language == "c++" else "gcc")
    dialect = ["-std=c++11", "-Wpedantic"] if language == "c++" else ["-std=c99", "-pedantic"]
    names = [*("-DFIRST=etel_xy", '-DFIRST_HEADER="etel_xy.h"'), *("-DSECOND=lower", '-DSECOND_HEADER="lower.h"')]
    program = tmp_path / "program"
    files = [*(f"-I{p}" for p in packages), "-x", language, PROBES / "side_by_side.c", "-x", "none", *made]
    run(tool, dialect, "-Wall", "-Wextra", "-Werror", names, files, "-o", program, "-lm")
    lines = run(program).splitlines()
    assert lines[-1] == "0 lines differ"
    friction = np.array([[float(v) for v in line.split()] for line in lines[:3]])
    assert np.isfinite(friction).all() and len({row[1] for row in friction}) == 3


# --- calls -------------------------------------------------------------------------------------------------------

STATUSES = (
    *("OK", "FILLING", "MISSING", "HOLD", "BOUND", "SPEED", "OVERRUN"),
    *("EARLY", "NUMERIC", "OVERLAP", "MISMATCH", "REFUSED", "STALE", "ARITHMETIC", "UNSTARTED"),
)


class Axis:
    """One estimator through its public C functions."""

    def __init__(self, settings: Machine, folder: Path) -> None:
        self.machine = settings
        self.samples = settings.sampling.samples_per_update
        self.c = probed(settings, folder, *["whole_sweep.c"] * (settings.estimator.relinearise != "all"))
        number, memory = ctypes.c_double, ctypes.c_void_p
        self.c.probe_status_text.restype = ctypes.c_char_p
        for function in (self.c.probe_tick, self.c.probe_sample):
            function.restype, function.argtypes = number, [memory, number, number]
        self.c.probe_insert.restype = self.c.probe_insert_late.restype = number
        self.c.probe_insert_late.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int, number]
        self.status = dict(zip(STATUSES, (self.c.probe_status(k) for k in range(len(STATUSES))), strict=True))
        self.numbers = int(self.c.probe_numbers())

    def new(self, byte: int = 0xA5) -> ctypes.Array[ctypes.c_char]:
        """A fresh estimator in memory that was full of `byte`."""
        memory = ctypes.create_string_buffer(self.c.probe_size())
        self.c.probe_init_on(memory, byte)
        return memory

    def estimate(self, memory: Any) -> tuple[Array, int]:
        """(friction, measured, deflections, parameters, deviations), status."""
        numbers = np.empty(self.numbers)
        return numbers, int(self.c.probe_estimate(memory, pointer(numbers)))

    def run(self, memory: Any, position: Array, force: Array) -> list[tuple[Array, int]]:
        """Two tasks; the estimate after every update."""
        found = []
        for q, u in zip(position, force, strict=True):
            self.c.probe_sample(memory, float(q), float(u))
            if self.c.probe_due(memory):
                returned = self.c.probe_feedback(memory)
                self.c.probe_prepare(memory)
                found.append(self.estimate(memory))
                assert returned == found[-1][1]
        return found


@pytest.fixture(scope="module")
def axis(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Axis]:
    built: dict[str, Axis] = {}

    def build(**changes: Any) -> Axis:
        key = repr(changes)
        if key not in built:
            built[key] = Axis(machine(**changes), tmp_path_factory.mktemp("axis"))
        return built[key]

    return build


@lru_cache(maxsize=2)
def log_of(trajectory: str = "paper", duration_s: float = 0.8) -> Log:
    return simulate_axis(
        machine(),
        make_trajectory(trajectory, 1e4, duration_s=duration_s),
        AxisConfig(seed=3),
        scale={"stiffness": [1.2, 0.8, 1.1, 0.97]},
        truth=False,
    ).log


def same(a: list[tuple[Array, int]], b: list[tuple[Array, int]]) -> bool:
    return len(a) == len(b) and all(s == t and np.array_equal(x, y) for (x, s), (y, t) in zip(a, b, strict=True))


@pytest.mark.parametrize("relinearise", ["all", "auto", "newest"])
def test_tick_and_tasks_give_the_same(relinearise: str, axis: Any) -> None:
    estimator: Axis = axis(estimator={"relinearise": relinearise})
    log = log_of()
    tasks = estimator.run(estimator.new(), log.position_m, log.force_N)
    memory, ticked = estimator.new(), []
    last = estimator.estimate(memory)
    for k, (q, u) in enumerate(zip(log.position_m, log.force_N, strict=True)):
        back = estimator.c.probe_tick(memory, float(q), float(u))
        assert np.isfinite(back)
        if k > 1 and k % estimator.samples == 1:  # the feedback is the next sample's
            ticked.append(estimator.estimate(memory))
        elif k > 1:
            assert same([estimator.estimate(memory)], [ticked[-1] if ticked else last]), "changed between updates"
    assert same(ticked, tasks)


@pytest.mark.parametrize(
    ("relinearise", "accuracy"), [("auto", 0.0), ("newest", 0.0), ("auto", 1e-9), ("auto", 1e-3), ("newest", 1e-3)]
)
def test_resumed_sweep_is_the_whole_one(relinearise: str, accuracy: float, axis: Any) -> None:
    """To rounding (rows are written about newer nodes), through drift, new linearisations and a reset; mostly short."""
    estimator: Axis = axis(estimator={"relinearise": relinearise}, code={"accuracy": accuracy})
    log = log_of("mixed", 1.2)
    memories = estimator.new(), estimator.new()
    found: tuple[list[Any], list[Any]] = [], []
    reached, forced = [], []
    for k, (q, u) in enumerate(zip(log.position_m, log.force_N, strict=True)):
        for memory in memories:
            if k == 6050:
                estimator.c.probe_reset(memory)
            estimator.c.probe_sample(memory, float(q), float(u))
        if estimator.c.probe_due(memories[0]):
            for memory, estimates in zip(memories, found, strict=True):
                estimator.c.probe_feedback(memory)
                estimates.append(estimator.estimate(memory))
            estimator.c.probe_forget_sweep(memories[1])
            for memory in memories:
                estimator.c.probe_prepare(memory)
            reached.append(estimator.c.probe_sweep(memories[0]))
            forced.append(estimator.c.probe_sweep(memories[1]))
            assert forced[-1] >= reached[-1]
    numbers, whole = (np.array([numbers for numbers, _ in estimates]) for estimates in found)
    size = np.abs(whole).max(axis=0)
    assert np.abs((numbers - whole) / size).max() < 1e-11
    assert [status for _, status in found[0]] == [status for _, status in found[1]]
    far = np.array(reached[-40:])
    assert far.max() == estimator.machine.estimator.horizon - 1, "drift takes the whole sweep"
    # Where every second factor is kept, every second whole sweep begins at the interval that has left.
    assert max(forced) == estimator.machine.estimator.horizon - 1 + (accuracy > 0.0)
    assert np.maximum(far, 0).mean() < 0.5 * far.max()
    assert (far < 0).any()


@pytest.mark.parametrize("drift", [0.0, 0.002])
def test_no_count_grows_for_ever(drift: float, axis: Any) -> None:
    """Shifts that wait for drift: at 100 updates per second an int32_t would overflow after 248 days."""
    estimator: Axis = axis(estimator={"relinearise": "auto", "noise": {"parameter_drift": drift}})
    memory, log, counted = estimator.new(), log_of("mixed", 0.8), []
    for q, u in zip(log.position_m, log.force_N, strict=True):
        estimator.c.probe_sample(memory, float(q), float(u))
        if estimator.c.probe_due(memory):
            estimator.c.probe_feedback(memory)
            estimator.c.probe_prepare(memory)
            counted.append(estimator.c.probe_shifts(memory))
    assert len(counted) > 3 * 20 and max(counted) == 19


def constants(package: Package) -> dict[str, int]:
    """Plain integer constants of a package's config header."""
    text, public = package.files["etel_xy_config.h"], package.files["etel_xy.h"]
    sizes = dict(re.findall(r"^#define (ETEL_XY_\w+) +(\d+)\b", public, re.MULTILINE))
    sizes |= dict(re.findall(r"^ +(ETEL_XY_\w+) = (\d+)\b", public, re.MULTILINE))
    found = dict(re.findall(r"^    (\w+) = (\w+)(?:,| |$)", text, re.MULTILINE)) | sizes
    resolved = {name: found.get(value, value) for name, value in found.items()}
    return {name: int(value) for name, value in resolved.items() if value.isdigit()}


@pytest.mark.parametrize(
    ("horizon", "samples", "merged"), [(2, 2, 1), (20, 5, 1), (20, 100, 1), (60, 400, 1), (20, 100, 5), (20, 100, 100)]
)
@pytest.mark.parametrize(("relinearise", "accuracy"), [("all", 0.0), ("auto", 0.0), ("newest", 0.0), ("auto", 1e-3)])
def test_work_of_an_interval_fits_into_its_samples(
    relinearise: str, accuracy: float, horizon: int, samples: int, merged: int
) -> None:
    """Units as tick does them, as many as there can be: never more than the bound in one sample, all done in time."""
    settings: dict[str, Any] = {
        "sampling": {"update_rate": 1e4 / samples, "integrator": {"scheme": "flow", "substeps": samples // merged}},
        "estimator": {"horizon": horizon, "relinearise": relinearise},
        "code": {"accuracy": accuracy},
    }
    of = constants(package_of(**settings))
    nodes = horizon - 1
    steps = samples // merged if relinearise != "newest" else 0
    order = ["EXPAND"] * nodes + ["CONDENSE"] + ["STEP"] * steps + ["READINGS", "CONDENSE"] * (nodes + (accuracy > 0.0))
    units = [of[f"{unit}_COST"] for unit in order + ["FOLD"] * of.get("INNER", 0)]
    # A sample that completes a step of merged ones has that to take.
    free = samples - (samples // merged if merged > 1 else 1)
    mean = sum(units) / free
    largest = 0
    for _ in range(free):
        left = of["COST_PER_SAMPLE"]
        while units and units[0] <= left:
            left -= units.pop(0)
        largest = max(largest, of["COST_PER_SAMPLE"] - left)
    assert not units
    # A bound, and no more than the work asks for: the mean, and what does not fit because units are whole.
    assert 0 < largest <= 2.0 * mean + max(of["READINGS_COST"], of["CONDENSE_COST"], of["STEP_COST"] * (steps > 0))


@pytest.mark.parametrize(
    ("precision", "accuracy", "most_N", "saved"),
    [
        ("double", 1e-9, 0.0, 8 * 44 * 9),
        ("double", 1e-3, 2.7e-5, 8 * 44 * 9 + 4 * 2000),
        ("single", 1e-3, 0.0, 4 * 44 * 9),
    ],
)
def test_accuracy_is_kept_and_saves_memory(
    precision: str, accuracy: float, most_N: float, saved: int, axis: Any
) -> None:
    """Every second factor found again is the same to rounding; rounded velocities cost less than the header says."""
    changes: dict[str, Any] = {"estimator": {"relinearise": "auto"}, "code": {"precision": precision}}
    exact: Axis = axis(**changes)
    changes["code"] = {"precision": precision, "accuracy": accuracy}
    less: Axis = axis(**changes)
    left = (4 if precision == "single" else 8) * (4 + 2)  # node and measurement of the interval that has left
    assert exact.c.probe_size() - less.c.probe_size() == saved - left
    stated = re.search(r"costs at most ([\d.e-]+) N", package_of(**changes).files["etel_xy.h"].replace("\n *", ""))
    assert (float(stated.group(1)) if stated else 0.0) == most_N
    log = log_of("mixed", 1.2)
    whole, found = (
        np.array([numbers for numbers, _ in e.run(e.new(), log.position_m, log.force_N)]) for e in (exact, less)
    )
    apart, size = np.abs(found - whole).max(axis=0), np.abs(whole).max(axis=0)
    friction, rounding = apart[0], 1e-3 if precision == "single" else 1e-11
    assert friction <= most_N + rounding * size[0] and np.all(apart <= (1e-7 if most_N else rounding) * size)
    assert not most_N or friction > 1e-12 * size[0], "something is rounded"


def test_memory_follows_what_is_linearised_anew(axis: Any) -> None:
    """Lanes for all, the series for auto, neither for newest."""
    sizes = {m: axis(estimator={"relinearise": m}).c.probe_size() for m in ("all", "auto", "newest")}
    ring = 100 * 19 * 8  # a signal of each step
    # Newest keeps defects and the sweep's factors instead of lanes.
    assert sizes["newest"] < 0.5 * sizes["all"] and sizes["newest"] < sizes["auto"] - ring
    wanted = {"all": {"lane"}, "auto": {"blocks", "end", "rows"}, "newest": {"rows"}}
    for relinearise, arrays in wanted.items():
        header = package_of(estimator={"relinearise": relinearise}).files["etel_xy.h"]
        (members,) = re.findall(r"struct \{([^{}]*)\} linearisation;", header)
        assert set(re.findall(r"\b(\w+)\[", members)) == arrays, relinearise


def test_init_relies_on_nothing_and_instances_on_nothing_of_each_other(axis: Any) -> None:
    estimator: Axis = axis()
    log, other = log_of(), log_of("mixed", 0.8)
    alone = [estimator.run(estimator.new(), x.position_m, x.force_N) for x in (log, other)]
    memories: list[Any] = [estimator.new(), estimator.new()]
    found: list[list[tuple[Array, int]]] = [[], []]
    for k in range(min(len(log.time_s), len(other.time_s))):
        for i, x in enumerate((log, other)):
            found[i] += estimator.run(memories[i], x.position_m[k : k + 1], x.force_N[k : k + 1])
    for i in range(2):
        assert same(found[i], alone[i][: len(found[i])])


ESTIMATORS: dict[str, dict[str, Any]] = {
    "all": {"estimator": {"relinearise": "all"}},
    "auto": {"estimator": {"relinearise": "auto"}},
    "newest": {"estimator": {"relinearise": "newest"}},
    "auto, merged": {"estimator": {"relinearise": "auto"}, "sampling": scheme("flow", substeps=20)},
    "all, merged": {"sampling": scheme("flow", substeps=50)},
    "fixed": {"estimator": {"arrival_cost": {"update": "fixed"}, "horizon": 5}},
    "rk4": {"sampling": scheme("rk4")},
    "ekf": {"estimator": {"kind": "ekf"}},
}
"""What an estimator remembers differs between these."""

ORDERS = [("double", kind) for kind in ESTIMATORS] + [("single", kind) for kind in ("all", "auto, merged", "ekf")]


@pytest.mark.parametrize(("precision", "kind"), ORDERS)
def test_slower_task_may_start_first(precision: str, kind: str, axis: Any) -> None:
    """prepare() before the first sample, after init() and after reset(), on memory of any content, changes nothing."""
    estimator: Axis = axis(code={"precision": precision}, **ESTIMATORS[kind])
    log = log_of()
    q, u = log.position_m[:2501], log.force_N[:2501]

    def updates(byte: int, *, first: bool) -> list[tuple[Array, int]]:
        memory, found = estimator.new(byte), []
        for restart in (False, True):
            if restart:
                estimator.c.probe_reset(memory)
            if first:
                estimator.c.probe_prepare(memory)
            found += estimator.run(memory, q, u)
        return found

    clean = updates(0, first=False)
    for byte in (0, 0xAA, 0xFF):  # all bits set: every number is NaN
        for first in (False, True):
            assert same(updates(byte, first=first), clean), f"memory of {byte:#x}, prepare first: {first}"


@pytest.mark.parametrize(("precision", "kind"), ORDERS)
def test_no_memory_is_read_that_was_not_written(precision: str, kind: str, require_tool: Tool, tmp_path: Path) -> None:
    """valgrind knows which memory was never written, over calls in several orders."""
    valgrind, changes = require_tool("valgrind"), ESTIMATORS[kind]
    estimator = {"horizon": 4, **changes.get("estimator", {})}
    folder = written(package_of(**{**changes, "estimator": estimator}, code={"precision": precision}), tmp_path)
    options = [STRICT[0], "-O1", "-g", *replay_definitions("etel_xy"), f"-I{folder}"]
    sources = [PROBES / "uninitialised.c", folder / "etel_xy.c"]
    program = build(require_tool("gcc"), sources, tmp_path / "program", options)
    lines = run(valgrind, "-q", "--error-exitcode=9", program).splitlines()
    assert len(lines) > 4 * 12 and not any("nan" in line for line in lines)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("bits", [2, 8, 17, 24, 31, 32])
def test_counts_that_start_over_are_unwrapped(bits: int, precision: str, axis: Any) -> None:
    """To and fro over several turns, from the first count on; bits beyond are not read."""
    estimator: Axis = axis(code={"precision": precision})
    rng = np.random.default_rng(bits)
    most = 2 ** (bits - 1) - 1  # half a range back cannot be distinguished from half of it on
    moves = np.concatenate([np.full(20, most), np.full(30, -most), rng.integers(-most, most + 1, 200)])
    first = int(rng.integers(0, 2**bits))
    whole = first + np.concatenate([[0], np.cumsum(moves)])
    beyond = rng.integers(0, 2 ** (32 - bits), whole.size) << bits
    counts = ((whole % 2**bits) | beyond).astype(np.uint32)

    def positions(bits: int) -> tuple[Array, Array]:
        found, made = np.empty(whole.size, np.int64), np.empty(whole.size, np.int64)
        per, picometres = ctypes.c_int32(4), ctypes.c_int64(1000)
        unwrap = estimator.c.probe_position_from_wrapped_counts
        unwrap(pointer(counts), whole.size, bits, per, picometres, pointer(found), pointer(made))
        return found, made if precision == "single" else made.view(np.float64)

    found, made = positions(bits)
    np.testing.assert_array_equal(found, whole)
    np.testing.assert_allclose(made, whole * (250 if precision == "single" else 250e-12), rtol=1e-15, atol=0.0)
    for none in (1, 0, -1, 33):
        assert np.all(np.abs(positions(none)[1]) >= (4e18 if precision == "single" else 4e6))


@pytest.mark.parametrize("precision", PRECISIONS)
def test_positions_from_counts_and_from_metres(precision: str, axis: Any) -> None:
    """Whole picometres in single precision, for any encoder; what no integer holds is missing."""
    estimator: Axis = axis(code={"precision": precision})
    single = precision == "single"
    largest = 2**63 - 1

    def from_counts(counts: int, per: int, picometres: int) -> float:
        made = np.empty(1, np.int64 if single else np.float64)
        whole = ctypes.c_int64
        estimator.c.probe_position_from_counts(whole(counts), ctypes.c_int32(per), whole(picometres), pointer(made))
        return int(made[0]) if single else float(made[0])

    def from_metres(metres: float) -> float:
        made = np.empty(1, np.int64 if single else np.float64)
        estimator.c.probe_position_from_metres(ctypes.c_double(metres), pointer(made))
        return int(made[0]) if single else float(made[0])

    rng = np.random.default_rng(0)
    encoders = [(1, 1000), (1, 1), (16384, 20_000_000), (4000, 10**10), (2**20, -(10**10)), (3, 2_000_001)]
    for per, picometres in encoders:
        for counts in [0, 1, -1, *(int(c) for c in rng.integers(-(10**9), 10**9, 200))]:
            exact = counts * picometres / per  # picometres
            found = from_counts(counts, per, picometres)
            if abs(exact) >= 4e18:
                assert abs(found) >= (4e18 if single else 4e6)
            elif single:
                assert abs(found - Fraction(counts * picometres, per)) < 1
            else:
                assert found == pytest.approx(1e-12 * exact, rel=1e-15)
    assert from_metres(0.3) == (300_000_000_000 if single else 0.3)
    assert from_metres(-1e-9) == (-1000 if single else -1e-9)
    for counts, per, picometres in [
        (largest, 1, 2),
        (-largest - 1, 1, 10**6),
        (1, 1, largest),
        (1, 0, 1000),
        (1, -1, 1000),
        (largest, 2**31 - 1, 4 * 10**18 - 1),
    ]:
        assert abs(from_counts(counts, per, picometres)) >= (4e18 if single else 4e6)
    for metres in (np.nan, np.inf, -np.inf, 4e6, -4e6, 1e300):
        found = from_metres(metres)
        assert found == largest if single else found == metres or np.isnan(found)


@pytest.mark.parametrize("call", ["tick", "sample"])
@pytest.mark.parametrize("precision", PRECISIONS)
def test_position_and_force_cannot_be_exchanged(precision: str, call: str, require_tool: Tool, tmp_path: Path) -> None:
    """As C and as C++, without a warning asked for: the right order compiles, the wrong one and bare numbers do not."""
    folder = written(package_of(code={"precision": precision}), tmp_path)
    position = "etel_xy_position_from_metres(0.1)"
    for compiler, language in (("gcc", "c"), ("clang", "c"), ("g++", "c++")):
        for arguments in (f"{position}, 2", f"2, {position}", "0.1, 2", "x, x"):
            source = f"etel_xy_t axis; etel_xy_real x; void f(void) {{ (void)etel_xy_{call}(&axis, {arguments}); }}"
            (tmp_path / "call.c").write_text(f'#include "etel_xy.h"\n{source}\n')
            command = [require_tool(compiler), "-w", "-x", language, "-fsyntax-only", f"-I{folder}"]
            done = subprocess.run([*command, tmp_path / "call.c"], capture_output=True, text=True, check=False)
            assert (done.returncode == 0) == (arguments == f"{position}, 2"), (compiler, arguments, done.stderr)


def test_memory_may_be_moved(axis: Any) -> None:
    """The struct holds no pointer into itself: a copy goes on as the original does."""
    estimator: Axis = axis()
    log = log_of()
    memory, half = estimator.new(), 4321
    estimator.run(memory, log.position_m[:half], log.force_N[:half])
    copy = ctypes.create_string_buffer(memory.raw, len(memory))
    rest = [estimator.run(m, log.position_m[half:], log.force_N[half:]) for m in (memory, copy)]
    assert same(*rest)


def test_estimate_before_the_first_update_is_nominal(axis: Any) -> None:
    estimator: Axis = axis()
    numbers, status = estimator.estimate(estimator.new())
    assert status == estimator.status["FILLING"]
    nominal = np.array(estimator.machine.friction.stiffness)
    np.testing.assert_array_equal(numbers[:6], 0.0)
    np.testing.assert_allclose(numbers[6:10], nominal)
    np.testing.assert_allclose(numbers[10:], estimator.machine.estimator.noise.parameter * nominal)


def test_feedback_before_its_time_is_refused(axis: Any) -> None:
    estimator: Axis = axis()
    log = log_of()
    memory, clean = estimator.new(), estimator.new()
    assert estimator.c.probe_feedback(memory) == estimator.status["EARLY"]
    found = []
    for k, (q, u) in enumerate(zip(log.position_m[:3001], log.force_N[:3001], strict=True)):
        estimator.c.probe_sample(memory, float(q), float(u))
        assert bool(estimator.c.probe_due(memory)) == (k > 0 and k % 100 == 0)
        if not estimator.c.probe_due(memory):
            before = estimator.estimate(memory)
            if k % 37 == 0:
                assert estimator.c.probe_feedback(memory) == estimator.status["EARLY"]
                assert same([estimator.estimate(memory)], [before])
            if k % 11 == 0:
                estimator.c.probe_prepare(memory)  # early, late and often: nothing but the work that is due
        else:
            estimator.c.probe_feedback(memory)
            found.append(estimator.estimate(memory))
    assert same(found, estimator.run(clean, log.position_m[:3001], log.force_N[:3001]))


def test_late_feedback_says_that_samples_were_lost(axis: Any) -> None:
    estimator: Axis = axis()
    log = log_of()
    memory = estimator.new()
    estimator.run(memory, log.position_m[:4001], log.force_N[:4001])
    for k in range(4001, 4101 + 30):  # the interval is complete at 4100; 30 samples come before anybody asks
        back = estimator.c.probe_sample(memory, float(log.position_m[k]), float(log.force_N[k]))
        assert np.isfinite(back)
    status = estimator.c.probe_feedback(memory)
    assert status & estimator.status["OVERRUN"]
    late = estimator.run(memory, log.position_m[4131:7000], log.force_N[4131:7000])
    assert not any(s & estimator.status["OVERRUN"] for _, s in late)
    assert all(np.isfinite(x).all() for x, _ in late)
    clean = estimator.run(estimator.new(), log.position_m, log.force_N)
    assert abs(late[-1][0][0] - clean[-1][0][0]) < 2.0


@pytest.mark.parametrize("kind", ["mhe", "ekf"])
def test_estimate_says_how_old_it_is(kind: str, axis: Any) -> None:
    estimator: Axis = axis(estimator={"kind": kind})
    log, samples = log_of(), 100
    memory, numbers = estimator.new(), np.zeros(3, dtype=np.uint32)

    def ages() -> tuple[int, int, int]:
        estimator.c.probe_age(memory, pointer(numbers))
        return int(numbers[0]), int(numbers[1]), int(numbers[2])

    def is_stale() -> bool:
        status = estimator.estimate(memory)[1]
        return status >= 0 and bool(status & estimator.status["STALE"])

    assert ages() == (0, 0, 0) and not is_stale()
    for k in range(3 * samples + 1):
        assert ages() == (max(k - 1, 0) // samples, k if k <= samples else (k - 1) % samples, 0), k
        estimator.c.probe_sample(memory, float(log.position_m[k]), float(log.force_N[k]))
        if estimator.c.probe_due(memory):
            assert estimator.c.probe_feedback(memory) >= 0
            estimator.c.probe_prepare(memory)
    before = estimator.estimate(memory)
    for k in range(1, 3 * samples + 1):  # nobody asks for feedback
        estimator.c.probe_sample(memory, float(log.position_m[k]), float(log.force_N[k]))
        assert ages() == (3, k, 0) and is_stale() == (k > 2 * samples)
    np.testing.assert_array_equal(estimator.estimate(memory)[0], before[0])
    estimator.c.probe_reset(memory)
    assert ages() == (3, 3 * samples, 0) and is_stale()  # it is as old as before
    estimator.run(memory, log.position_m[: samples + 1], log.force_N[: samples + 1])
    assert ages() == (4, 0, 0) and not is_stale()


def test_reset_keeps_what_was_learned(axis: Any) -> None:
    estimator: Axis = axis()
    log = log_of()
    memory = estimator.new()
    learned = estimator.run(memory, log.position_m, log.force_N)[-1]
    estimator.c.probe_reset(memory)
    numbers, status = estimator.estimate(memory)
    assert status == estimator.status["FILLING"]
    np.testing.assert_array_equal(numbers[6:10], learned[0][6:10])
    again = estimator.run(memory, log.position_m, log.force_N)
    fresh = estimator.run(estimator.new(), log.position_m, log.force_N)
    assert [bool(s & estimator.status["FILLING"]) for _, s in again] == [
        bool(s & estimator.status["FILLING"]) for _, s in fresh
    ]
    # The prior starts at what was learned, with the prior's own spread.
    np.testing.assert_allclose(again[0][0][6:10], learned[0][6:10], rtol=0.2)
    assert not np.allclose(again[0][0][6:10], fresh[0][0][6:10])
    # A reset with nothing learned is an init.
    idle = estimator.new()
    estimator.c.probe_reset(idle)
    assert same(estimator.run(idle, log.position_m, log.force_N), fresh)


def test_controller_with_a_signal_chain_of_its_own(axis: Any) -> None:
    estimator: Axis = axis()
    memory = estimator.new()
    statuses = []
    for k in range(601):
        v = 1e-3 * np.sin(0.01 * k)
        signals = np.array([0.0, v, 0.0, 4.0, 4.0 * np.tanh(v / 1e-4)])
        if k == 250:
            signals[1] = np.nan
        if k in (400, 500):
            signals[4] = np.nan if k == 400 else 3.0
        valid = int(k != 500)
        assert np.isfinite(estimator.c.probe_insert(memory, pointer(signals), valid))
        if estimator.c.probe_due(memory):
            statuses.append(int(estimator.c.probe_feedback(memory)))
    missing = [bool(s & estimator.status["MISSING"]) for s in statuses]
    assert missing == [False, False, False, True, True, False]


@pytest.mark.parametrize("delay", [np.nan, np.inf, -1e-9, 0.0101, 1e12])
def test_signals_of_an_impossible_delay_count_as_missing(delay: float, axis: Any) -> None:
    """Bit by bit as signals of which one is no number: the window, its force and the clock are unharmed."""
    estimator: Axis = axis(effects=[{"name": "viscous_drift", "ratio": 0.5, "time_constant_s": 1.0}])

    def run(late: float, velocity: float) -> tuple[list[int], list[Any], list[float]]:
        memory = estimator.new()
        statuses, found, fed = [], [], []
        for k in range(901):
            v = 1e-3 * np.sin(0.01 * k)
            is_wrong = 390 <= k <= 400
            signals = np.array([0.0, velocity if is_wrong else v, 0.0, 4.0, 4.0 * np.tanh(v / 1e-4)])
            fed.append(estimator.c.probe_insert_late(memory, pointer(signals), 1, late if is_wrong else 0.01))
            if estimator.c.probe_due(memory):
                statuses.append(int(estimator.c.probe_feedback(memory)))
                found.append(estimator.estimate(memory))
        return statuses, found, fed

    statuses, found, fed = run(delay, 1e-3 * np.sin(0.01 * 400))
    missing = [bool(s & estimator.status["MISSING"]) for s in statuses]
    assert missing == [False, False, False, True, *5 * [False]]
    expected = run(0.0, np.nan)
    assert statuses == expected[0] and same(found, expected[1]) and fed == expected[2]
    assert np.abs(fed).max() < 50.0


def test_status_texts(axis: Any) -> None:
    estimator: Axis = axis()
    texts = {name: estimator.c.probe_status_text(code).decode() for name, code in estimator.status.items()}
    assert len(set(texts.values())) == len(STATUSES)
    assert texts["OK"] == "good"
    for name, word in (
        ("FILLING", "filling"),
        ("MISSING", "missing"),
        ("HOLD", "hold"),
        ("BOUND", "bound"),
        ("SPEED", "max_velocity"),
        ("OVERRUN", "lost"),
        ("STALE", "old"),
        ("EARLY", "not complete"),
        ("NUMERIC", "not finite"),
        ("OVERLAP", "overlapped"),
        ("MISMATCH", "another header"),
        ("REFUSED", "out of range"),
        ("ARITHMETIC", "does not compute"),
        ("UNSTARTED", "has not set"),
    ):
        assert word in texts[name]
    # Sums say their gravest part, and every number has a text.
    assert estimator.c.probe_status_text(1 + 4).decode() == texts["HOLD"]
    assert estimator.c.probe_status_text(2 + 8 + 16).decode() == texts["SPEED"]
    for flags in itertools.chain(range(-7, 64), (-(2**31), 2**31 - 1)):
        assert estimator.c.probe_status_text(flags)


@pytest.mark.parametrize(
    ("precision", "effects"),
    [("double", []), ("single", [{"name": "mass_mismatch", "mass_kg": 1.5}])],
    ids=["one chain", "two chains"],
)
def test_axis_at_rest_leaves_subnormal_numbers(
    precision: str, effects: list[dict[str, Any]], require_tool: Tool, tmp_path: Path
) -> None:
    """After a motion filters decay to zero, and do not stay among numbers with which processors are slow."""
    folder = written(package_of(code={"precision": precision}, effects=effects), tmp_path)
    command = [require_tool("gcc"), "-std=c99", "-O2", f"-I{folder}", *replay_definitions("etel_xy")]
    run(*command, PROBES / "rest.c", folder / "etel_xy.c", "-o", tmp_path / "program")
    for line in run(tmp_path / "program").splitlines():
        met, of_last, moving = map(int, line.split())
        # States are dropped once in 128 samples, and one filter decays behind the other.
        assert met <= 2 * 128 and of_last == moving == 0, line


@pytest.mark.slow
def test_damaged_counts_of_the_chain_come_back(require_tool: Tool, tmp_path: Path) -> None:
    """A bit of its memory that has flipped takes no measurement for longer than the filters settle."""
    folder = written(emit_package(machine(), selftest=False), tmp_path)
    command = [require_tool("gcc"), *STRICT, "-O2", f"-I{folder}", *replay_definitions("etel_xy")]
    run(*command, PROBES / "flipped_counts.c", folder / "etel_xy.c", "-o", tmp_path / "program")
    assert run(tmp_path / "program") == ""


# --- input that cannot be meant ----------------------------------------------------------------------------------

HOSTILE = (np.nan, np.inf, -np.inf, 1e300, -1e300, 1e20, 3.4e38)


def estimator_of(kind: str) -> dict[str, str]:
    """Table `estimator` of "mhe", "mhe auto", "mhe newest" or "ekf"."""
    name, _, relinearise = kind.partition(" ")
    return {"kind": name, "relinearise": relinearise or "all"}


def hostile_log(seed: int) -> tuple[Array, Array, int]:
    """Closed-loop log with a bad stretch: single values, runs, both channels; ends at the sample returned."""
    rng = np.random.default_rng(seed)
    log = log_of("paper", 1.6)
    q, u = log.position_m.copy(), log.force_N.copy()
    for channel in (q, u):
        for _ in range(12):
            first = int(rng.integers(2500, 6000))
            channel[first : first + int(rng.choice([1, 3, 100, 260]))] = rng.choice(HOSTILE)
    return q, u, 6260


@pytest.mark.parametrize("kind", ["mhe", "mhe auto", "ekf"])
@pytest.mark.parametrize("precision", PRECISIONS)
def test_hostile_samples_never_reach_the_estimate(precision: str, kind: str, axis: Any) -> None:
    estimator: Axis = axis(code={"precision": precision}, estimator=estimator_of(kind))
    log = log_of("paper", 1.6)
    clean = estimator.run(estimator.new(), log.position_m, log.force_N)
    for seed in range(6):
        q, u, end = hostile_log(seed)
        memory, last = estimator.new(), None
        found = []
        for k in range(len(q)):
            assert np.isfinite(estimator.c.probe_sample(memory, float(q[k]), float(u[k]))), f"seed {seed} sample {k}"
            if estimator.c.probe_due(memory):
                status = estimator.c.probe_feedback(memory)
                numbers, _ = estimator.estimate(memory)
                assert np.isfinite(numbers).all(), f"seed {seed} sample {k}"
                if status < 0 and last is not None:
                    np.testing.assert_array_equal(numbers, last)  # the last good estimate is kept
                last = numbers
                found.append((numbers, status))
        # A second after the last bad sample the friction is what it would have been.
        for (numbers, status), (expected, _) in list(zip(found, clean, strict=True))[-20:]:
            assert status >= 0
            assert abs(numbers[0] - expected[0]) < 0.5, f"seed {seed}: {numbers[0]} instead of {expected[0]}"
        assert end < len(q) - 8000


@pytest.mark.parametrize(
    "changes",
    [
        {"estimator": {"horizon": 5}},
        {"estimator": {"horizon": 5, "relinearise": "auto"}},
        {"estimator": {"horizon": 5, "relinearise": "newest"}},
        {"estimator": {"kind": "ekf"}},
    ],
    ids=["mhe", "auto", "newest", "ekf"],
)
@pytest.mark.parametrize("precision", PRECISIONS)
def test_solution_that_is_not_finite_is_refused(precision: str, changes: dict[str, Any], axis: Any) -> None:
    """A speed that explicit schemes blow up at: the last good estimate stays, the window starts anew and recovers."""
    # Friction without memory contradicts the model at every reversal: it is to count all the same.
    estimated = {**changes["estimator"], "noise": {"self_scaling": False}}
    estimator: Axis = axis(code={"precision": precision}, sampling=scheme("rk4"), estimator=estimated)

    def updates(speeding: bool) -> list[tuple[Array, int]]:
        memory = estimator.new()
        found: list[tuple[Array, int]] = []
        for k in range(6001):
            v = 2e-3 * np.sin(0.005 * k)
            if speeding and 2010 <= k < 2030:
                v = 1e8
            signals = np.array([0.0, v, 0.0, 4.0, 4.0 * np.tanh(v / 1e-4)])
            assert np.isfinite(estimator.c.probe_insert(memory, pointer(signals), 1))
            if estimator.c.probe_due(memory):
                status = int(estimator.c.probe_feedback(memory))
                numbers, told = estimator.estimate(memory)
                assert told == status and np.isfinite(numbers).all()
                if status < 0:
                    assert status == estimator.status["NUMERIC"]
                    np.testing.assert_array_equal(numbers, found[-1][0])
                found.append((numbers, status))
        return found

    found, clean = updates(True), updates(False)
    refused = [u for u, (_, s) in enumerate(found) if s < 0]
    assert refused and refused[0] == 20 and refused[-1] < 30, refused
    # From then on as a window that has just begun, and right again soon.
    if "kind" not in changes["estimator"]:
        assert all(found[u][1] & estimator.status["FILLING"] for u in range(refused[-1] + 1, refused[-1] + 5))
    assert all(s >= 0 for _, s in found[31:])
    assert all(s >= 0 for _, s in clean)
    assert abs(found[-1][0][0] - clean[-1][0][0]) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "precision"), [("mhe", "double"), ("mhe auto", "double"), ("mhe newest", "single"), ("ekf", "single")]
)
def test_sanitizers_find_nothing(precision: str, kind: str, require_tool: Tool, tmp_path: Path) -> None:
    """ASan and UBSan over the hostile logs, one task and two; the program prints every estimate."""
    folder = written(package_of(code={"precision": precision}, estimator=estimator_of(kind)), tmp_path)
    checks = ["-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all"]
    options = [STRICT[0], "-O1", "-g", *checks, *replay_definitions("etel_xy"), f"-I{folder}"]
    sources = [PROBES / "hostile.c", PROBES / "estimator_probe.c", folder / "etel_xy.c"]
    program = build(require_tool("gcc"), sources, tmp_path / "program", options)
    for seed in range(2):
        q, u, _ = hostile_log(seed)
        q[2000:2400:3], q[2001:2400:3] = 3.9999999e6, -3.9999999e6  # the ends of what counts as a position
        samples = tmp_path / "samples.bin"
        np.column_stack([q, u]).tofile(samples)
        count, friction = run(program, samples).split()
        assert int(count) == len(q) and np.isfinite(float(friction))
