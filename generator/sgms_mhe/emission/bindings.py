"""A package's C from other languages and tools: templates by file, variables of an axis, FMUs."""

import io
import platform
import sys
import tempfile
import zipfile
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal

from sgms_mhe.emission.context import PackageView
from sgms_mhe.emission.rendering import dot_unit
from sgms_mhe.support.errors import BuildError, InputError
from sgms_mhe.support.names import did_you_mean
from sgms_mhe.support.toolchain import DEFAULT_FLAGS, shared_library

BINDINGS: Final[Mapping[str, Mapping[str, str]]] = {
    "python": {"{name}.py": "bindings/python.py"},
    "cpp": {"{name}.hpp": "bindings/cpp.hpp"},
    "fmu2": {
        "{name}_fmi2.fmu/modelDescription.xml": "bindings/fmi2.xml",
        "{name}_fmi2.fmu/sources/{name}_fmi2.c": "bindings/fmi2.c",
    },
    "fmu3": {
        "{name}_fmi3.fmu/modelDescription.xml": "bindings/fmi3.xml",
        "{name}_fmi3.fmu/sources/buildDescription.xml": "bindings/fmi3_build.xml",
        "{name}_fmi3.fmu/sources/{name}_fmi3.c": "bindings/fmi3.c",
    },
}
"""Templates by file, by the name of the binding; files below one that ends in `.fmu` are those of that archive."""


def binding_files(names: Collection[str], machine: str) -> dict[str, str]:
    """Templates of the bindings asked for, by file name.

    Raises:
        InputError: a binding that there is not.
    """
    for name in names:
        if name not in BINDINGS:
            allowed = f"one of {', '.join(BINDINGS)}{did_you_mean(name, BINDINGS)}"
            raise InputError("--bindings", "binding", name, allowed)
    asked = [BINDINGS[name] for name in BINDINGS if name in names]
    return {file.format(name=machine): template for files in asked for file, template in files.items()}


def bindings_among(files: Collection[str], machine: str) -> tuple[str, ...]:
    """Bindings of which a package's folder has a file or more, of all the files in it."""
    own = {
        name: {
            file.format(name=machine).partition(SUFFIX)[0] + SUFFIX.rstrip("/") * (SUFFIX in file) for file in templates
        }
        for name, templates in BINDINGS.items()
    }
    return tuple(name for name, made in own.items() if made & set(files))


Causality = Literal["input", "output", "parameter"]
Kind = Literal["Real", "Integer", "Boolean"]

_BASE_UNITS: Final[Mapping[str, Mapping[str, int]]] = {
    "N": {"kg": 1, "m": 1, "s": -2},
    "kg": {"kg": 1},
    "m": {"m": 1},
    "rad": {"rad": 1},
    "s": {"s": 1},
    "Hz": {"s": -1},
    "": {},  # of 1
}


@dataclass(frozen=True)
class Variable:
    """One number of an axis.

    Attributes:
        reference: its number among all, from 1; 0 is time.
        name: unique, with dots and indices.
        kind: of number.
        causality: of whom it comes.
        unit: in the notation of FMI; empty where it has none.
        text: its meaning.
        code: C expression that reads it, of `self`, an axis with its inputs, and `now`, its estimate.
        start: where it does not come from the estimator.
        least, most: limits, where it has any.
        variability: of a parameter: while the axis runs, or before its first step alone.
    """

    reference: int
    name: str
    kind: Kind
    causality: Causality
    unit: str
    text: str
    code: str
    start: str | None = None
    least: float | None = None
    most: float | None = None
    variability: Literal["tunable", "fixed"] = field(default="tunable", kw_only=True)

    @property
    def exponents(self) -> str:
        """The unit as attributes of SI base units: `kg="1" s="-1"`."""
        exponents = dict.fromkeys(("kg", "m", "rad", "s"), 0)
        over, _, under = self.unit.partition("/")
        for sign, factors in ((1, over), (-1, under)):
            for factor in filter(None, factors.split(".")):
                name = factor.rstrip("0123456789")
                power = sign * int(factor[len(name) :] or 1)
                for base, exponent in _BASE_UNITS[name].items():
                    exponents[base] += power * exponent
        return " ".join(f'{base}="{exponent}"' for base, exponent in exponents.items() if exponent)


def variables_of(view: PackageView) -> tuple[Variable, ...]:
    """All variables of a package's axis, in the order of their references."""
    rows = [*_inputs(view), *_outputs(view), *_estimated_variables(view)]
    return tuple(Variable(number, *row) for number, row in enumerate(rows, 1))


_Row = (
    tuple[str, Kind, Causality, str, str, str]
    | tuple[str, Kind, Causality, str, str, str, str]
    | tuple[str, Kind, Causality, str, str, str, str, float, float]
)


def _inputs(view: PackageView) -> Iterator[_Row]:
    units = view.machine.plant.units
    position, push = "position of the axis, one sample a step", f"drive {units.push}, what was fed forward included"
    yield "position", "Real", "input", dot_unit(units.position), position, "self->position", "0.0"
    yield units.push, "Real", "input", dot_unit(units.force), push, f"self->{units.push}", "0.0"
    for name, unit in (("velocity", units.velocity), ("acceleration", units.acceleration)):
        text = f"{name} of the set-point while the answer to this sample acts; read where ahead is true"
        yield f"ahead_{name}", "Real", "input", dot_unit(unit), text, f"self->ahead_{name}", "0.0"
    yield "ahead", "Boolean", "input", "", "whether the set-point is given", "self->ahead", "false"
    enabled = "true" if view.machine.compensation.enabled else "false"
    on = f"whether the {units.push} to feed forward is on, along its ramp"
    yield "compensate", "Boolean", "parameter", "", on, "self->compensate", enabled
    if not view.signals.mass_in_model:
        mass, what = view.machine.plant.moved, f"{units.inert} that moves, payload included"
        code = f"self->{units.inert}"
        yield units.inert, "Real", "parameter", dot_unit(units.mass), what, code, repr(mass), mass / 20.0, 20.0 * mass
    if "position" in view.signals.read:
        counted = "position that effects over place count from"
        yield "origin", "Real", "parameter", dot_unit(units.position), counted, "self->origin", "0.0"


def _outputs(view: PackageView) -> Iterator[_Row]:
    units = view.machine.plant.units
    force = dot_unit(units.force)
    yield "feed_forward", "Real", "output", force, f"{units.push} to feed forward", "self->feed_forward"
    for name, unit, text in (
        ("friction", force, "friction at the last update"),
        ("friction_measured", force, "the newest reading of friction"),
        ("innovation", force, "the newest reading minus its prediction"),
        ("test_ratio", "", "square of the innovation over the variance predicted for it"),
        ("noise_scale", "", "factor on the stated standard deviation that the reading was taken with"),
    ):
        yield name, "Real", "output", unit, text, f"(double)now->{name}"
    stated = "status of the last update: 0, a sum of positive flags, or negative: refused"
    yield "status", "Integer", "output", "", stated, "now->status"
    doubt = f"now->status > 0 && (now->status & {view.package.NAME}_DOUBT) != 0"
    yield "doubt", "Boolean", "output", "", "measurements contradict the model beyond their stated noise", doubt
    updates = "number of updates so far, modulo 2^31"
    yield "update", "Integer", "output", "", updates, "(int32_t)(now->update & INT32_MAX)"
    age = "samples since the last update, 2^31 - 1 at most; the status says STALE beyond two intervals"
    yield "age", "Integer", "output", "", age, "now->age < INT32_MAX ? (int32_t)now->age : INT32_MAX"
    cause = "cause of the last NUMERIC, a sum: 1 state, 2 parameters, 4 variances, 8 friction"
    yield "numeric", "Integer", "output", "", cause, "now->numeric"


def _estimated_variables(view: PackageView) -> Iterator[_Row]:
    unit = dot_unit(view.machine.plant.units.position)
    for i in range(view.sizes.elements):
        code = f"(double)now->deflection[{i}]"
        yield f"deflection[{i + 1}]", "Real", "output", unit, f"deflection of element {i + 1}", code
    for kind, text in (("parameter", "estimated"), ("deviation", "one standard deviation")):
        for p, name in enumerate(parameter.column for parameter in view.model.parameters):
            yield f"{kind}.{name}", "Real", "output", "", f"{name}, {text}, SI units", f"(double)now->{kind}[{p}]"


SUFFIX: Final = ".fmu/"
"""In a path: what stands behind it is inside the archive."""
_EPOCH: Final = (1980, 1, 1, 0, 0, 0)
"""The first time that an archive can state: it tells of no other."""
_MACHINES: Final[Mapping[str, str]] = {"x86_64": "x86_64", "amd64": "x86_64", "aarch64": "aarch64", "arm64": "aarch64"}
_SYSTEMS: Final[Mapping[str, tuple[str, str]]] = {"linux": ("linux", ".so"), "darwin": ("darwin", ".dylib")}


def fmu(files: Mapping[str, str], name: str, archive: str, libraries: tuple[str, ...] = ()) -> tuple[bytes, str | None]:
    """An archive with a binary for this host, where it has a compiler.

    Args:
        files: of the FMU, by path inside it.
        name: of the machine.
        archive: its name, which says the version of FMI.
        libraries: that its sources take.

    Returns:
        The archive, and why it has no binary; None where it has one.
    """
    version = 2 if archive.endswith("_fmi2.fmu") else 3
    content = {path: text.encode() for path, text in files.items()}
    folder, suffix = _platform(version)
    missing: str | None = f"FMI {version}.0 has no name for this platform"
    if folder is not None:
        try:
            content[f"binaries/{folder}/{name}{suffix}"] = _binary(files, libraries)
            missing = None
        except BuildError as error:
            missing = str(error)
    return _archive(content), missing


def strip_binaries(archive: bytes) -> dict[str, bytes] | None:
    """Return the parts of an FMU that do not depend on the compiler, by path; None where it is no archive."""
    try:
        with zipfile.ZipFile(io.BytesIO(archive)) as opened:
            return {path: opened.read(path) for path in opened.namelist() if not path.startswith("binaries/")}
    except zipfile.BadZipFile:
        return None


def _platform(version: int) -> tuple[str | None, str]:
    """Folder and suffix of this host's binaries; None where FMI has no name for it."""
    system, suffix = _SYSTEMS.get(sys.platform, (None, ""))
    machine = _MACHINES.get(platform.machine().lower())
    if system is None or machine is None:
        return None, suffix
    if version == 2:
        return {"x86_64-linux": "linux64", "x86_64-darwin": "darwin64"}.get(f"{machine}-{system}"), suffix
    return f"{machine}-{system}", suffix


def _binary(files: Mapping[str, str], libraries: tuple[str, ...]) -> bytes:
    """Shared library of an FMU's sources.

    Raises:
        BuildError: no compiler, or it refused.
    """
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for path, text in files.items():
            inside, _, file = path.rpartition("/")
            if inside == "sources":
                (folder / file).write_text(text, encoding="utf-8")
        sources = sorted(folder.glob("*.c"))
        flags = (*DEFAULT_FLAGS, "-fvisibility=hidden")
        return shared_library(sources, [folder], flags, libraries=libraries).read_bytes()


def _archive(content: Mapping[str, bytes]) -> bytes:
    """Entries in the order of their paths, stored as they are: compressed, they would hang on a library's version."""
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_STORED) as archive:
        for path, data in sorted(content.items()):
            entry = zipfile.ZipInfo(path, _EPOCH)
            entry.create_system = 3
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, data)
    return whole.getvalue()
