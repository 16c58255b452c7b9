"""Emitted packages and C probes for the tests of the C: written out, compiled, loaded."""

import ctypes
import hashlib
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.emission.package import Package, emit_package, write_package
from sgms_mhe.host.compiled import replay_definitions
from sgms_mhe.machine import Machine
from sgms_mhe.support import cache
from sgms_mhe.support.paths import runtime_dir
from sgms_mhe.support.toolchain import DEFAULT_FLAGS, WARNING_FLAGS, shared_library

Array = NDArray[np.float64]

PROBES = Path(__file__).parent / "c"
STRICT = ("-std=c99", *WARNING_FLAGS)
REAL: Mapping[str, Any] = {"double": np.float64, "single": np.float32}
PRECISIONS = ("double", "single")
QUICK = ("-std=c99", "-O1", "-ffp-contract=off")
"""Where no level is judged: numbers are the same at all, and the compiler takes half the time of -O3."""


def machine(**changes: Any) -> Machine:
    """etel_xy with changes, as a machine file that extends it; relinearises all, which most of the code is in."""
    return override_machine(override_machine(load_machine("etel_xy"), {"estimator": {"relinearise": "all"}}), changes)


def scheme(name: str, **settings: Any) -> dict[str, Any]:
    """Table `sampling` of another integrator."""
    return {"integrator": {"scheme": name, **settings}}


def elements(n: int) -> dict[str, Any]:
    """Table `friction` of n elements."""
    fraction = np.round(np.random.default_rng(n).dirichlet(3.0 * np.ones(n)), 3)
    fraction[-1] = round(1.0 - float(fraction[:-1].sum()), 3)
    return {
        "stiffness": [float(k) for k in np.geomspace(1e5, 5e3, n)],
        "fraction": [float(nu) for nu in fraction],
        "micro_viscous": [0.0] * n,
    }


def written(package: Package, folder: Path) -> Path:
    """A package's folder below `folder`."""
    target = folder / package.machine.name
    write_package(package, target)
    return target


_packages: dict[tuple[str, bool], Package] = {}


def package_of(*, selftest: bool = False, **changes: Any) -> Package:
    """Package of etel_xy with changes, made once: the vectors of a self-test take seconds."""
    settings = machine(**changes)
    if (settings.digest, selftest) not in _packages:
        _packages[settings.digest, selftest] = emit_package(settings, selftest=selftest)
    return _packages[settings.digest, selftest]


def probed(settings: Machine, folder: Path, *probes: str) -> ctypes.CDLL:
    """Shared library of a package, written below `folder`, with the probe of estimators and others of tests/c."""
    package = written(emit_package(settings, selftest=False), folder)
    sources = [package / f"{settings.name}.c", PROBES / "estimator_probe.c", *(PROBES / probe for probe in probes)]
    library = ctypes.CDLL(str(shared_library(sources, [package], [*QUICK, *replay_definitions(settings.name)])))
    library.probe_size.restype = ctypes.c_size_t
    return library


def compile_probe(
    source: str | Path, *include: Path, definitions: Sequence[str] = (), flags: Sequence[str] = DEFAULT_FLAGS
) -> ctypes.CDLL:
    """Shared library of one probe of tests/c, or of a source elsewhere."""
    path = PROBES / source
    return ctypes.CDLL(str(shared_library([path], [*include, runtime_dir()], [*flags, *definitions])))


@lru_cache(maxsize=4)
def runtime_probe(precision: str, vectors: bool = True) -> ctypes.CDLL:
    """tests/c/runtime_probe.c in one precision, in the form for vectors or the plain one."""
    definitions = [f"-DSGMS_SINGLE={int(precision == 'single')}", "-USGMS_VECTORS", f"-DSGMS_VECTORS={int(vectors)}"]
    return compile_probe("runtime_probe.c", definitions=definitions)


def pointer(array: NDArray[Any]) -> ctypes.c_void_p:
    """Address of a C-contiguous array."""
    if not array.flags.c_contiguous:
        raise ValueError("not contiguous")
    return ctypes.c_void_p(array.ctypes.data)


def flat(*words: Any) -> list[str]:
    """Words of a command, given as text, paths and lists of them in any depth."""
    return [w for word in words for w in ([str(word)] if isinstance(word, str | Path) else flat(*word))]


def run(*words: Any) -> str:
    """Run a command, given in words and lists of words; its whole output is the failure's message."""
    command = flat(*words)
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise AssertionError(f"{' '.join(command)}\nexit code {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout


@lru_cache
def _version(tool: str) -> str:
    return run(tool, "--version")


def compile_object(tool: str, source: Path, *options: Any) -> Path:
    """Object of a source, compiled once of the same text behind the preprocessor, by any test of any run."""
    text = run(tool, options, "-E", "-P", source)
    level = [word for word in flat(*options) if not word.startswith(("-I", "-D", "-U"))]  # the others are in the text
    key = hashlib.sha256("\0".join([_version(tool), *level, source.suffix, text]).encode()).hexdigest()
    kept = cache.find(source.stem, key, ".o")
    if kept is None:
        with tempfile.TemporaryDirectory() as folder:
            made = Path(folder) / "made.o"
            run(tool, options, "-c", source, "-o", made)
            kept = cache.keep(source.stem, key, ".o", made.read_bytes())
    return kept


def build(tool: str, sources: Sequence[Path], target: Path, *options: Any) -> Path:
    """Program of sources and objects; each source is compiled once of the same text."""
    objects = [path if path.suffix == ".o" else compile_object(tool, path, *options) for path in sources]
    run(tool, options, objects, "-o", target, "-lm")
    return target


def symbols(path: Path, *arguments: str) -> list[tuple[str, str]]:
    """(type, name) of the symbols of an object, by nm."""
    nm = shutil.which("nm") or "nm"
    rows = [line.split() for line in run(nm, arguments, path).splitlines()]
    return [(row[-2], row[-1]) for row in rows if len(row) >= 2]


def emitted(folder: Path, **changes: Any) -> tuple[Package, Path]:
    """Package of etel_xy with changes, and its folder below `folder`."""
    package = emit_package(machine(**changes))
    return package, written(package, folder)
