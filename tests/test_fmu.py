"""FMUs of a package: what the standard says of them, the same numbers as the C alone, and refusals."""

import itertools
import os
import re
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.build import build_platform_binary
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu
from numpy.typing import NDArray

from binding_cases import COUNTS, HELD_MASS, KINDS, PITCH, PLACES, Bound, ages, machine_of, outputs_of, ticking
from c_packages import STRICT, compile_object, symbols
from cli_cases import SMALL
from sgms_mhe.emission.package import emit_package
from sgms_mhe.signals.logs import Log

Tool = Callable[[str], str]
Array = NDArray[np.float64]
VERSIONS = (2, 3)
REAL = ("Real", "Float64")
HEADERS = Path(fmpy.__file__).parent / "c-code"
MODEL_EXCHANGE = {
    f"fmi2{name}"
    for name in (
        "EnterEventMode", "NewDiscreteStates", "EnterContinuousTimeMode", "CompletedIntegratorStep", "SetTime",
        "SetContinuousStates", "GetDerivatives", "GetEventIndicators", "GetContinuousStates",
        "GetNominalsOfContinuousStates",
    )
}  # fmt: skip
"""What FMI 2.0 does not ask of a co-simulation."""
CASES = [pytest.param(kind, version, id=f"{kind}-{version}") for kind in (*KINDS, HELD_MASS) for version in VERSIONS]


def archive_of(package: Bound, version: int) -> Path:
    return package.folder / f"{package.name}_fmi{version}.fmu"


@dataclass(frozen=True)
class Slave:
    """An instance in FMPy, by the names of its variables."""

    package: Bound
    fmi: Any
    description: Any
    version: int

    def reference(self, name: str) -> list[int]:
        return [v.valueReference for v in self.description.modelVariables if v.name == name]

    def _calls(self, name: str) -> tuple[Any, Any]:
        kind = next(v.type for v in self.description.modelVariables if v.name == name)
        return getattr(self.fmi, f"get{kind}"), getattr(self.fmi, f"set{kind}", None)

    def __getitem__(self, name: str) -> Any:
        return self._calls(name)[0](self.reference(name))[0]

    def __setitem__(self, name: str, value: Any) -> None:
        self._calls(name)[1](self.reference(name), [value])

    def start(self, at: float = 0.0) -> None:
        if self.version == 2:
            self.fmi.setupExperiment(startTime=at)
            self.fmi.enterInitializationMode()
        else:
            self.fmi.enterInitializationMode(startTime=at)
        self.fmi.exitInitializationMode()

    def step(self, k: int, position: float, push: float, step: float | None = None) -> None:
        period = 1.0 / self.package.machine.sampling.rate
        self["position"], self[self.package.machine.plant.units.push] = position, push
        self.fmi.doStep(k * period, period if step is None else step)

    def run(self, position: Array, push: Array, names: Sequence[str], first: int = 0) -> Array:
        """Outputs (n, names) after each sample, numbers only."""
        get, put = self._calls("position")
        given = self.reference("position") + self.reference(self.package.machine.plant.units.push)
        wanted = [reference for name in names for reference in self.reference(name)]
        period, rows = 1.0 / self.package.machine.sampling.rate, []
        for k, (q, u) in enumerate(zip(position.tolist(), push.tolist(), strict=True), first):
            put(given, [q, u])
            self.fmi.doStep(k * period, period)
            rows.append(get(wanted))
        return np.array(rows)

    def state(self) -> Any:
        return self.fmi.getFMUstate() if self.version == 2 else self.fmi.getFMUState()

    def restore(self, state: Any) -> None:
        (self.fmi.setFMUstate if self.version == 2 else self.fmi.setFMUState)(state)

    def forget(self, state: Any) -> None:
        (self.fmi.freeFMUstate if self.version == 2 else self.fmi.freeFMUState)(state)

    def to_bytes(self, state: Any) -> bytes:
        return (self.fmi.serializeFMUstate if self.version == 2 else self.fmi.serializeFMUState)(state)

    def of_bytes(self, content: bytes) -> Any:
        return (self.fmi.deSerializeFMUstate if self.version == 2 else self.fmi.deserializeFMUState)(content)


@pytest.fixture
def slave(bound: Any, tmp_path: Path) -> Iterator[Callable[..., Slave]]:
    """Instances of a kind's FMU, initialised or not; freed in the end."""
    made: list[Any] = []
    folders: dict[tuple[str, int], Path] = {}

    def of(kind: str, version: int, *, started: bool = True, token: str | None = None) -> Slave:
        package = bound(kind)
        if (kind, version) not in folders:
            folders[kind, version] = tmp_path / f"{kind}-{version}"
            fmpy.extract(str(archive_of(package, version)), unzipdir=str(folders[kind, version]))
        description = fmpy.read_model_description(str(folders[kind, version]))
        fmi = (FMU2Slave if version == 2 else FMU3Slave)(
            guid=token or (description.guid if version == 2 else description.instantiationToken),
            unzipDirectory=str(folders[kind, version]),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="axis",
        )
        fmi.instantiate()
        made.append(fmi)
        new = Slave(package, fmi, description, version)
        if started:
            new.start()
        return new

    yield of
    for fmi in made:
        fmi.freeInstance()


# --- what the standard says --------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "version"), CASES)
def test_it_is_a_valid_fmu(kind: str, version: int, bound: Any) -> None:
    package = bound(kind)
    path = archive_of(package, version)
    assert validate_fmu(str(path)) == []
    description = fmpy.read_model_description(str(path))
    variables = {v.name: v for v in description.modelVariables}
    units, parameters = package.machine.plant.units, package.run(package.log).parameter_names
    assert {v.name for v in description.modelVariables if v.causality == "input"} == {
        "position", units.push, "ahead", "ahead_velocity", "ahead_acceleration",
    }  # fmt: skip
    assert [name.partition(".")[2] for name in variables if name.startswith("parameter.")] == list(parameters)
    assert [name.partition(".")[2] for name in variables if name.startswith("deviation.")] == list(parameters)
    assert float(description.defaultExperiment.stepSize) == 1.0 / package.machine.sampling.rate
    assert description.modelName == package.name and description.coSimulation.canGetAndSetFMUstate
    assert not description.coSimulation.canHandleVariableCommunicationStepSize
    if kind == HELD_MASS:
        assert units.inert not in variables and variables["compensate"].start == "false"
    else:
        assert float(variables[units.inert].start) == package.machine.plant.moved


def test_units_are_those_of_the_axis(bound: Any) -> None:
    found = {}
    for kind in ("double", "rotary"):
        description = fmpy.read_model_description(str(archive_of(bound(kind), 2)))
        found[kind] = {v.name: v.unit for v in description.modelVariables}
    assert {found["double"][name] for name in ("position", "force", "friction", "mass")} == {"m", "N", "kg"}
    assert {found["rotary"][name] for name in ("position", "torque", "friction", "inertia")} == {"rad", "N.m", "kg.m2"}


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("kind", ["single", "rotary", HELD_MASS])
def test_glue_agrees_with_the_headers_of_the_standard(
    kind: str, compiler: str, version: int, bound: Any, require_tool: Tool, tmp_path: Path
) -> None:
    package = bound(kind)
    zipfile.ZipFile(archive_of(package, version)).extractall(tmp_path)
    glue = tmp_path / "sources" / f"{package.name}_fmi{version}.c"
    header = f"fmi{version}Functions.h"
    wanted = set(re.findall(rf"^#define (fmi{version}\w+) +fmi{version}FullName", (HEADERS / header).read_text(), re.M))
    wanted -= MODEL_EXCHANGE if version == 2 else set()
    assert len(wanted) == {2: 34, 3: 75}[version]
    for number, flags in enumerate(([], [f"-DFMI{version}_FUNCTION_PREFIX=x_"], [f"-I{HEADERS}", "-include", header])):
        made = compile_object(require_tool(compiler), glue, STRICT, "-O2", flags)
        defined = {name for kind, name in symbols(made) if kind == "T"}
        assert defined == ({f"x_{name}" for name in wanted} if number == 1 else wanted)
    library = next((tmp_path / "binaries").rglob("*.so"))
    assert {name for kind, name in symbols(library, "-D") if kind == "T"} == wanted
    foreign = {name.partition("@")[0] for kind, name in symbols(library, "-D") if kind == "U"}
    heap = {"calloc", "free"} if version == 3 else set()
    assert foreign - {"memcpy", "memset", "memmove", "memcmp", "strcmp", "strncpy"} == heap


@pytest.mark.parametrize("version", VERSIONS)
def test_an_importer_builds_it_from_its_sources(
    version: int, bound: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, require_tool: Tool
) -> None:
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent), prepend=":")
    require_tool("cmake")
    package = bound("double")
    fmpy.extract(str(archive_of(package, version)), unzipdir=str(tmp_path))
    shipped = next((tmp_path / "binaries").rglob("*.so"))
    shipped.unlink()
    (tmp_path / "build").mkdir()
    build_platform_binary(tmp_path, build_dir=tmp_path / "build")
    assert shipped.is_file()
    log = package.log
    found = simulated(tmp_path, log, package, "friction")
    fed, friction = package.run(log).extra["compensation_N"], package.run(log).friction_N
    np.testing.assert_array_equal(found["feed_forward"][1:], fed[: len(found) - 1])
    np.testing.assert_array_equal(found["friction"][-1], friction[-1])


def simulated(fmu: Path, log: Log, package: Bound, *outputs: str) -> Any:
    """FMPy's own co-simulation along a log; its result is one row later than the sample."""
    rate = package.machine.sampling.rate
    columns = [("time", float), ("position", float), (package.machine.plant.units.push, float)]
    times = np.arange(len(log.position_m)) * (1.0 / rate)  # as FMPy counts: nothing is interpolated
    given = np.array(list(zip(times, log.position_m, log.force_N, strict=True)), dtype=columns)
    stop = len(times) / rate
    names = ["feed_forward", *outputs]
    return fmpy.simulate_fmu(str(fmu), stop_time=stop, output_interval=1.0 / rate, input=given, output=names)


# --- numbers -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("kind", "version"), CASES)
def test_it_gives_what_the_c_gives(kind: str, version: int, slave: Any) -> None:
    axis = slave(kind, version)
    log, expected = axis.package.log, axis.package.run(axis.package.log)
    names = [v.name for v in axis.description.modelVariables if v.causality == "output" and v.type in REAL]
    samples = axis.package.machine.sampling.samples_per_update
    parts, said, whole = [], [], ("status", "doubt", *COUNTS)
    for first, last in itertools.pairwise([0, *range(1, len(log.position_m) + 1, samples)]):
        parts.append(axis.run(log.position_m[first:last], log.force_N[first:last], names, first))
        said.append([axis[name] for name in whole])
    rows = np.concatenate(parts)
    updates = rows[samples * np.arange(1, len(expected.status) + 1)]
    outputs = outputs_of(expected)
    for k, name in enumerate(whole):
        assert [row[k] for row in said[1:]] == outputs[name].tolist(), name
    for name in (name for name in outputs if name not in whole):
        columns = [k for k, each in enumerate(names) if re.fullmatch(rf"(\w+\.)?{name}([\[.].*)?", each)]
        np.testing.assert_array_equal(np.squeeze(updates[:, columns]), np.squeeze(outputs[name]), err_msg=name)
    np.testing.assert_array_equal(rows[:, names.index("feed_forward")], expected.extra["compensation_N"][: len(rows)])
    assert np.ptp(expected.parameters[:, 0]) > 0.0


@pytest.mark.parametrize("version", VERSIONS)
def test_set_points_mass_and_compensation_reach_the_c(version: int, slave: Any) -> None:
    axis = slave("double", version)
    log, plain = axis.package.log, ticking(axis.package)
    position, push = log.position_m, log.force_N
    axis["mass"] = 20.0  # what it is already: nothing has to settle
    for k, (q, u) in enumerate(zip(position[:1500], push[:1500], strict=True)):
        velocity = 0.01 * np.sin(0.01 * k)
        axis["ahead"], axis["ahead_velocity"], axis["ahead_acceleration"] = True, velocity, 0.5
        axis.step(k, q, u)
        plain.ahead(velocity, 0.5)
        assert axis["feed_forward"] == plain.tick(q, u)
    axis["mass"], axis["compensate"], axis["ahead"] = 23.5, False, False
    plain.set_mass(23.5)
    plain.compensate(False)
    fed = axis.run(position[1500:3000], push[1500:3000], ["feed_forward", "friction"], 1500)
    wanted = [plain.tick(q, u) for q, u in zip(position[1500:3000], push[1500:3000], strict=True)]
    np.testing.assert_array_equal(fed[:, 0], wanted)
    assert (axis["update"], axis["age"]) == tuple(count[-1] for count in ages(axis.package, 3000))
    assert axis["mass"] == 23.5 and not axis["compensate"] and axis["position"] == position[2999]


@pytest.mark.parametrize("version", VERSIONS)
def test_origin_reaches_the_c(version: int, slave: Any) -> None:
    axis = slave(PLACES, version)
    log, plain = axis.package.log, ticking(axis.package)
    axis["origin"] = 0.0
    for first, origin in ((0, 0.0), (700, 0.4 * PITCH), (1400, 0.4 * PITCH)):
        axis["origin"] = origin
        if first == 700:
            plain.set_origin(origin)
        samples = slice(first, first + 700)
        wanted = [plain.tick(q, u) for q, u in zip(log.position_m[samples], log.force_N[samples], strict=True)]
        fed = axis.run(log.position_m[samples], log.force_N[samples], ["feed_forward"], first)
        np.testing.assert_array_equal(fed[:, 0], wanted)
    assert axis["origin"] == 0.4 * PITCH


@pytest.mark.parametrize("version", VERSIONS)
def test_its_state_is_all_of_it(version: int, slave: Any) -> None:
    one, other = slave("double", version), slave("double", version)
    log = one.package.log
    half = len(log.position_m) // 2 + 33
    head, tail = (log.position_m[:half], log.force_N[:half]), (log.position_m[half:], log.force_N[half:])
    names = ["feed_forward", "friction", "parameter.stiffness_1", "deviation.stiffness_1", "test_ratio"]
    one.run(*head, names)
    state = one.state()
    content = one.to_bytes(state)
    wanted = one.run(*tail, names, half)
    assert np.ptp(wanted[:, 2]) > 0.0
    one.restore(state)
    np.testing.assert_array_equal(one.run(*tail, names, half), wanted)
    copied = other.of_bytes(content)
    other.restore(copied)
    np.testing.assert_array_equal(other.run(*tail, names, half), wanted)
    one.fmi.reset()
    one.start()
    fresh = slave("double", version)
    np.testing.assert_array_equal(one.run(*head, names), fresh.run(*head, names))
    for damaged in (content[:-1], bytes([content[0] ^ 1]) + content[1:], b""):
        with pytest.raises(FMICallException):
            one.of_bytes(damaged)
    one.forget(state)
    other.forget(copied)


# --- refusals ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", VERSIONS)
def test_what_it_refuses(version: int, slave: Any) -> None:
    axis = slave("double", version, started=False)
    with pytest.raises(FMICallException):
        axis.step(0, 0.3, 4.0)
    axis.start()
    axis.step(0, 0.3, 4.0)
    for step in (0.0, 0.5e-4, 2e-4, 1e-3, float("nan")):
        with pytest.raises(FMICallException):
            axis.step(1, 0.3, 4.0, step)
    set_number = axis.fmi.setReal if version == 2 else axis.fmi.setFloat64
    for mass in (-1.0, float("nan"), 0.0, 401.0):
        with pytest.raises(FMICallException):
            axis["mass"] = mass
    assert axis["mass"] == 20.0
    for reference in (axis.reference("friction"), axis.reference("status"), [10**6]):
        with pytest.raises(FMICallException):
            set_number(reference, [1.0])
    with pytest.raises(FMICallException):
        (axis.fmi.getReal if version == 2 else axis.fmi.getFloat64)(axis.reference("status"))
    with pytest.raises(Exception, match="instantiate"):
        slave("double", version, token="another")


# --- the archive -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_its_bytes_are_those_of_its_content(bound: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))  # nothing built before
    again = emit_package(machine_of("double"), selftest=False, bindings=["fmu3", "fmu2"])
    assert dict(again.archives) == dict(bound("double").package.archives) and not again.missing
    for version in VERSIONS:
        entries = zipfile.ZipFile(archive_of(bound("double"), version)).infolist()
        assert [e.filename for e in entries] == sorted(e.filename for e in entries)
        assert {e.date_time for e in entries} == {(1980, 1, 1, 0, 0, 0)}
        assert {e.compress_type for e in entries} == {zipfile.ZIP_STORED}
        assert not [e.filename for e in entries if "selftest" in e.filename]
    package = bound("double")
    content = zipfile.ZipFile(archive_of(package, 2))
    assert content.read(f"sources/{package.name}.c") == (package.folder / f"{package.name}.c").read_bytes()


@pytest.mark.slow
def test_without_a_compiler_it_has_its_sources(tmp_path: Path, bound: Any) -> None:
    path, out = tmp_path / "small.toml", tmp_path / "out"
    path.write_text(SMALL)
    command = [
        sys.executable,
        "-m",
        "sgms_mhe",
        "generate",
        path,
        "--out",
        out,
        "--bindings",
        "fmu2,fmu3",
        "--amalgamate",
    ]
    for compiler, binaries in (("no-such-compiler", 0), ("gcc", 1)):
        environment = {**os.environ, "CC": compiler}
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
        assert done.returncode == 0, done.stderr
        for version in VERSIONS:
            said = f"small_fmi{version}.fmu: sources without a binary: no-such-compiler"
            assert (said in done.stderr) == (binaries == 0)
            names = zipfile.ZipFile(out / f"small_fmi{version}.fmu").namelist()
            assert len([name for name in names if name.startswith("binaries/")]) == binaries
            assert {"sources/small.c", "sources/small.h", f"sources/small_fmi{version}.c"} < set(names)
            assert validate_fmu(str(out / f"small_fmi{version}.fmu")) == []


def test_one_that_turns_has_no_mass(bound: Any) -> None:
    for version, package in itertools.product(VERSIONS, [bound("rotary")]):
        archive = zipfile.ZipFile(archive_of(package, version))
        for name in ("modelDescription.xml", f"sources/{package.name}_fmi{version}.c"):
            text = archive.read(name).decode().replace(f"{package.name}_set_mass(", "")
            assert not re.findall(r"\w*(?:mass|force)\w*", text)
