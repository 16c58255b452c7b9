"""The Simulink S-function of a package, run by a stub of Simulink: the numbers of the C, and refusals; its script."""

from __future__ import annotations

import ctypes
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from binding_cases import HELD_MASS, KINDS, PITCH, PLACES, Bound, ages, outputs_of, ticking
from c_packages import PROBES, STRICT, run
from sgms_mhe.support.toolchain import DEFAULT_FLAGS

Tool = Callable[[str], str]
Array = NDArray[np.float64]
STUB = PROBES / "simulink"
ALL_KINDS = (*KINDS, HELD_MASS)


def compiled(package: Bound, compiler: str, target: Path) -> ctypes.CDLL:
    """The S-function with the stub and the package's C, every warning of the former an error."""
    sfun, plain = package.folder / f"{package.name}_sfun.c", package.folder / f"{package.name}.c"
    includes = [f"-I{STUB}", f"-I{package.folder}", "-fPIC", "-DMATLAB_MEX_FILE"]
    objects = [target / "sfun.o", target / "c.o"]
    run(compiler, STRICT, DEFAULT_FLAGS, includes, "-c", sfun, "-o", objects[0])
    run(compiler, DEFAULT_FLAGS, includes, "-c", plain, "-o", objects[1])
    run(compiler, "-shared", objects, "-o", target / "block.so")
    library = ctypes.CDLL(str(target / "block.so"))
    for name in ("stub_block", "stub_error", "stub_set"):
        getattr(library, name).restype = ctypes.c_void_p if name == "stub_block" else ctypes.c_char_p
    return library


def pointer(array: NDArray[Any]) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


class Block:
    """A block on the stub's sheet.

    Args:
        dialog: value of every parameter; a list is an array of more or fewer than one.
    """

    def __init__(self, library: ctypes.CDLL, dialog: list[Any]) -> None:
        elements = np.array([len(d) if isinstance(d, list) else 1 for d in dialog], dtype=np.int32)
        values = np.array([0.0 if isinstance(d, list) else float(d) for d in dialog])
        self._c = library
        self._block = ctypes.c_void_p(library.stub_block(pointer(values), len(dialog), pointer(elements)))
        said = library.stub_error(self._block)
        self.error = None if said is None else said.decode()
        period, ports = ctypes.c_double(), np.zeros(2, dtype=np.int32)
        widths, tunable = np.zeros(16, dtype=np.int32), np.zeros(16, dtype=np.int32)
        library.stub_layout(self._block, ctypes.byref(period), pointer(ports), pointer(widths), pointer(tunable))
        self.period, self.inputs, self.outputs = period.value, int(ports[0]), int(ports[1])
        self.widths = widths[: self.outputs].tolist()
        self.tunable = tunable[: len(dialog)].tolist()

    def step(self, *inputs: float) -> list[Array]:
        """Outputs of one sample hit, port by port."""
        assert len(inputs) == self.inputs
        found = np.empty(sum(self.widths))
        self._c.stub_step(self._block, pointer(np.array(inputs)), pointer(found))
        return np.split(found, np.cumsum(self.widths)[:-1])

    def set(self, index: int, value: float) -> str | None:
        said = self._c.stub_set(self._block, index, ctypes.c_double(value))
        return None if said is None else str(said.decode())

    def take_point(self, other: Block) -> None:
        self._c.stub_point(self._block, other._block)

    def end(self) -> None:
        self._c.stub_end(self._block)


@dataclass(frozen=True)
class Sheet:
    package: Bound
    library: ctypes.CDLL

    def block(self, *, set_point: bool = False, **changes: Any) -> Block:
        plant = self.package.machine.plant
        held = "mass" not in changes and not self.has_mass
        dialog = [changes.get("compensate", self.package.machine.compensation.enabled), set_point]
        dialog += [] if held else [changes.get("mass", plant.moved)]
        return Block(self.library, [*dialog, 0.0] if self.has_origin else dialog)

    @property
    def has_mass(self) -> bool:
        return not self.package.machine.effects or self.has_origin

    @property
    def has_origin(self) -> bool:
        return any(effect.name == "force_ripple" for effect in self.package.machine.effects)


@pytest.fixture(scope="module")
def sheet(bound: Any, require_tool: Tool, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Sheet]:
    made: dict[str, Sheet] = {}

    def of(kind: str) -> Sheet:
        if kind not in made:
            library = compiled(bound(kind), require_tool("gcc"), tmp_path_factory.mktemp("simulink"))
            made[kind] = Sheet(bound(kind), library)
        return made[kind]

    return of


@pytest.mark.parametrize("kind", ALL_KINDS)
def test_it_gives_what_the_c_gives(kind: str, sheet: Any) -> None:
    page = sheet(kind)
    log, expected = page.package.log, page.package.run(page.package.log)
    block = page.block()
    assert block.error is None and block.period == 1.0 / page.package.machine.sampling.rate and block.inputs == 2
    rows = [block.step(q, u) for q, u in zip(log.position_m, log.force_N, strict=True)]
    samples = page.package.machine.sampling.samples_per_update
    updates = [rows[samples * k] for k in range(1, len(expected.status) + 1)]
    np.testing.assert_array_equal([row[0][0] for row in rows], expected.extra["compensation_N"])
    for port, column in enumerate(outputs_of(expected).values(), 1):
        found = np.array([row[port] for row in updates])
        np.testing.assert_array_equal(found, np.reshape(column, found.shape), err_msg=f"output {port + 1}")
    update, age = (list(outputs_of(expected)).index(name) + 1 for name in ("update", "age"))
    counted = np.array([(row[update][0], row[age][0]) for row in rows])
    np.testing.assert_array_equal(counted.T, ages(page.package, len(rows)))
    assert np.ptp(expected.parameters[:, 0]) > 0.0
    block.end()


def test_set_points_mass_and_compensation_reach_the_c(sheet: Any) -> None:
    page = sheet("double")
    log, plain, block = page.package.log, ticking(page.package), page.block(set_point=True)
    assert block.inputs == 4 and block.tunable == [1, 0, 1]
    for k, (q, u) in enumerate(zip(log.position_m[:3000], log.force_N[:3000], strict=True)):
        if k == 700:
            assert block.set(2, 23.5) is None
            plain.set_mass(23.5)
        if k == 1400:
            assert block.set(2, 23.5) is None  # the same again: nothing has to settle
            assert block.set(0, 0.0) is None
            plain.compensate(False)
        velocity = 0.01 * np.sin(0.01 * k)
        plain.ahead(velocity, 0.5)
        assert block.step(q, u, velocity, 0.5)[0][0] == plain.tick(q, u)
    block.end()


def test_origin_reaches_the_c(sheet: Any) -> None:
    page = sheet(PLACES)
    log, plain, block = page.package.log, ticking(page.package), page.block()
    assert block.tunable == [1, 0, 1, 1]
    for k, (q, u) in enumerate(zip(log.position_m[:2000], log.force_N[:2000], strict=True)):
        if k == 700:
            assert block.set(3, 0.4 * PITCH) is None
            plain.set_origin(0.4 * PITCH)
        if k == 1400:
            assert block.set(3, 0.4 * PITCH) is None  # the same again: the window goes on
        assert block.step(q, u)[0][0] == plain.tick(q, u)
    assert "origin" in str(block.set(3, 5e6))
    block.end()


def test_an_operating_point_is_all_of_it(sheet: Any) -> None:
    page = sheet("single")
    log, one, other = page.package.log, page.block(), page.block()
    samples = list(zip(log.position_m.tolist(), log.force_N.tolist(), strict=True))
    for q, u in samples[:2033]:
        one.step(q, u)
    other.take_point(one)
    for q, u in samples[2033:]:
        for ours, theirs in zip(one.step(q, u), other.step(q, u), strict=True):
            np.testing.assert_array_equal(ours, theirs)
    one.end()
    other.end()


def test_what_it_refuses(sheet: Any) -> None:
    page = sheet("double")
    for mass in (-1.0, 0.0, 401.0, float("nan"), float("inf")):
        assert page.block(mass=mass).error == "etel_xy: mass has to be from 1.0 to 400.0 kg"
    assert (
        page.block(mass=[]).error == page.block(mass=[1.0, 2.0]).error == "etel_xy: every parameter is one real number"
    )
    assert sheet(HELD_MASS).block(mass=20.0).error == "number of parameters"
    block = page.block()
    assert block.set(2, 0.5) == "etel_xy: mass has to be from 1.0 to 400.0 kg"
    assert block.set(2, 20.5) is None
    block.end()


@pytest.mark.parametrize("kind", ALL_KINDS)
def test_clang_takes_it_too(kind: str, bound: Any, require_tool: Tool, tmp_path: Path) -> None:
    compiled(bound(kind), require_tool("clang"), tmp_path)


# --- the script of its mask --------------------------------------------------------------------------------------


def linted(path: Path) -> int:
    """Exit code of MISS_HIT, which parses MATLAB."""
    command = [sys.executable, "-c", "from miss_hit.mh_lint import main; main()", "--brief", str(path)]
    return subprocess.run(command, capture_output=True, check=False, cwd=path.parent).returncode


@pytest.mark.parametrize("kind", ALL_KINDS)
def test_the_script_is_matlab_and_speaks_of_this_block(kind: str, sheet: Any, tmp_path: Path) -> None:
    page, block = sheet(kind), sheet(kind).block()
    path = page.package.folder / f"{page.package.name}_block.m"
    text = path.read_text()
    assert linted(path) == 0
    labels = re.findall(r"port_label\(''(\w+)'', (\d+), ''([^']+)''\)", text)
    numbers = {way: [int(n) for w, n, _ in labels if w == way] for way in ("input", "output")}
    assert numbers["output"] == list(range(1, block.outputs + 1))
    assert numbers["input"] == list(range(1, sheet(kind).block(set_point=True).inputs + 1))
    names = re.findall(r"addParameter\('Name', '(\w+)'", text)
    stated = re.search(r"'Parameters', '([^']+)'", text)
    assert stated is not None and stated[1].split(", ") == names and len(names) == len(block.tunable)
    assert re.findall(r"'Tunable', '(\w+)'", text) == ["on" if tunable else "off" for tunable in block.tunable]
    units = page.package.machine.plant.units
    assert f"[{units.force}]" in text and f"[{units.position}]" in text
    for source in re.findall(r"'(\w+\.c)'", text):
        assert (page.package.folder / source).is_file()
    block.end()


def test_what_is_no_matlab_is_found(bound: Any, tmp_path: Path) -> None:
    text = (bound("double").folder / "etel_xy_block.m").read_text()
    (tmp_path / "broken.m").write_text(text.replace("};", "", 1))
    assert linted(tmp_path / "broken.m") != 0


def test_one_that_turns_has_no_mass(bound: Any) -> None:
    package = bound("rotary")
    for file in (f"{package.name}_sfun.c", f"{package.name}_block.m"):
        text = (package.folder / file).read_text().replace(f"{package.name}_set_mass(", "")
        assert not re.findall(r"\w*(?:mass|force)\w*", text, flags=re.IGNORECASE)
