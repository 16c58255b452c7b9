"""The function block of a package in structured text: parsed by blark, run over its C; the numbers of the C alone."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blark.parse import parse_source_code

from binding_cases import HELD_MASS, KINDS, PITCH, PLACES, Bound, ages, outputs_of, ticking
from c_packages import STRICT, run, symbols
from sgms_mhe.emission.bindings import binding_files
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.toolchain import DEFAULT_FLAGS

Tool = Callable[[str], str]
ALL_KINDS = (*KINDS, HELD_MASS)
SCALARS = {"LREAL": ctypes.c_double, "DINT": ctypes.c_int32, "UDINT": ctypes.c_uint32}
IN_C = {"LREAL": "double", "DINT": "int32_t", "UDINT": "uint32_t"}
MISMATCH, REFUSED = -4, -5


# --- structured text, as far as the function block goes ----------------------------------------------------------


class Array:
    """ARRAY [1..n] OF LREAL."""

    def __init__(self, length: int) -> None:
        self.values = [0.0] * length

    def __setitem__(self, index: int, value: float) -> None:
        if not 1 <= index <= len(self.values):
            raise IndexError(index)
        self.values[index - 1] = value


@dataclass(frozen=True)
class Declared:
    """A function: result, and arguments in order, (name, type, by address)."""

    result: str
    arguments: tuple[tuple[str, str, bool], ...]


@dataclass
class Text:
    """What a text declares, comments left out."""

    name: str
    types: dict[str, tuple[str, int]] = field(default_factory=dict)
    functions: dict[str, Declared] = field(default_factory=dict)
    variables: dict[str, list[tuple[str, str, str | None]]] = field(default_factory=dict)
    body: str = ""


def read_text(path: Path) -> Text:
    code = re.sub(r"\(\*.*?\*\)", "", path.read_text(), flags=re.DOTALL)
    found = Text(path.stem)
    for name, last, of in re.findall(r"^TYPE (\w+) :\s+ARRAY \[0\.\.(\d+)\] OF (\w+);\s+END_TYPE", code, re.M):
        found.types[name] = (of, int(last) + 1)
    for name, result, inside in re.findall(r"^FUNCTION (\w+) : (\w+)\n(.*?)^END_FUNCTION$", code, re.M | re.S):
        sections = re.findall(r"^(VAR_\w+)\n(.*?)^END_VAR", inside, re.M | re.S)
        arguments = [
            (n, t, section == "VAR_IN_OUT")
            for section, rows in sections
            for n, t in re.findall(r"(\w+) : (\w+);", rows)
        ]
        found.functions[name] = Declared(result, tuple(arguments))
    block = code.partition(f"FUNCTION_BLOCK {found.name}_observer\n")[2].partition("END_FUNCTION_BLOCK")[0]
    for section, rows in re.findall(r"^(VAR[\w ]*)\n(.*?)^END_VAR", block, re.M | re.S):
        declared = re.findall(r"(\w+) : ([^:;]+?)(?: := (\S+))?;", rows)
        found.variables[section] = [(name, of, start or None) for name, of, start in declared]
    found.body = block.rpartition("END_VAR")[2]
    return found


def python_of(body: str) -> str:
    """The statements of the block as Python: assignments, IF, FOR, calls with named arguments."""
    lines, depth = [], 0
    for line in filter(None, (row.strip() for row in body.splitlines())):
        if line in ("END_IF;", "END_FOR;"):
            depth -= 1
            continue
        if line == "ELSE":
            lines.append("    " * (depth - 1) + "else:")
            continue
        if condition := re.fullmatch(r"IF (.+) THEN", line):
            lines.append("    " * depth + f"if {expression(condition[1])}:")
            depth += 1
        elif loop := re.fullmatch(r"FOR (\w+) := (\d+) TO (\d+) DO", line):
            lines.append("    " * depth + f"for {loop[1]} in range({loop[2]}, {loop[3]} + 1):")
            depth += 1
        else:
            target, value = re.fullmatch(r"([\w\[\]]+) := (.+);", line).groups()  # type: ignore[union-attr]
            lines.append("    " * depth + f"{target} = {expression(value)}")
    assert depth == 0
    return "\n".join(lines)


def expression(text: str) -> str:
    text = text.replace(" = ", " == ").replace("<>", "!=").replace(" := ", "=").replace("/", "//")
    for word, own in (("AND", "and"), ("NOT", "not"), ("MOD", "%"), ("TRUE", "True"), ("FALSE", "False")):
        text = re.sub(rf"\b{word}\b", own, text)
    return text


class FunctionBlock:
    """An instance over a compiled shim; variables by name, `saved` from an earlier life where it is given."""

    def __init__(self, text: Text, library: ctypes.CDLL, saved: Any = None) -> None:
        self.retained = saved
        self._code = compile(python_of(text.body), text.name, "exec")
        self._names: dict[str, Any] = {"BOOL_TO_DINT": int, "LREAL_TO_UDINT": int, "LREAL_TO_DINT": int}
        for name, declared in text.functions.items():
            self._names[name] = self._bound(getattr(library, name), declared)
        for rows in text.variables.values():
            for name, of, start in rows:
                self._names[name] = self._started(text, of, start)
        if saved is not None:
            self._names["saved"] = saved
        self.outputs = [name for name, _, _ in text.variables["VAR_OUTPUT"]]

    @staticmethod
    def _bound(function: Any, declared: Declared) -> Callable[..., Any]:
        function.restype = SCALARS[declared.result]
        function.argtypes = [ctypes.c_void_p if address else SCALARS[of] for _, of, address in declared.arguments]
        order = [(name, address) for name, _, address in declared.arguments]

        def call(**given: Any) -> Any:
            assert sorted(given) == sorted(name for name, _ in order)
            return function(*(ctypes.addressof(given[name]) if address else given[name] for name, address in order))

        return call

    @staticmethod
    def _started(text: Text, of: str, start: str | None) -> Any:
        if of in text.types:
            word, length = text.types[of]
            return ((ctypes.c_uint64 if word == "LWORD" else ctypes.c_double) * length)()
        if array := re.fullmatch(r"ARRAY \[1\.\.(\d+)\] OF LREAL", of):
            return Array(int(array[1]))
        if of == "BOOL":
            return start == "TRUE"
        return float(start or 0.0) if of == "LREAL" else int(start or 0)

    def __getitem__(self, name: str) -> Any:
        value = self._names[name]
        return value.values if isinstance(value, Array) else value

    def __call__(self, **inputs: Any) -> float:
        """One cycle; what it feeds forward. Inputs stay until they change."""
        assert inputs.keys() <= self._names.keys()
        self._names.update(inputs)
        exec(self._code, self._names)
        return float(self["feed_forward"])


@dataclass(frozen=True)
class Runtime:
    """A package's text and its compiled shim."""

    package: Bound
    text: Text
    library: ctypes.CDLL

    def block(self, saved: Any = None) -> FunctionBlock:
        return FunctionBlock(self.text, self.library, saved)


@pytest.fixture(scope="module")
def runtime(bound: Any, require_tool: Tool, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Runtime]:
    made: dict[str, Runtime] = {}

    def of(kind: str) -> Runtime:
        if kind not in made:
            package, target = bound(kind), tmp_path_factory.mktemp("iec") / "shim.so"
            sources = [package.folder / f"{package.name}{end}.c" for end in ("", "_iec")]
            run(require_tool("gcc"), DEFAULT_FLAGS, "-fPIC", "-shared", sources, "-o", target)
            made[kind] = Runtime(package, read_text(package.folder / f"{package.name}.st"), ctypes.CDLL(str(target)))
        return made[kind]

    return of


# --- the text ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ALL_KINDS)
def test_the_text_is_structured_text(kind: str, bound: Any) -> None:
    package = bound(kind)
    path = package.folder / f"{package.name}.st"
    result = parse_source_code(path.read_text())
    assert result.exception is None
    kinds = [type(item).__name__ for item in result.transform().items]
    text = read_text(path)
    assert kinds == ["DataTypeDeclaration"] * 3 + ["Function"] * len(text.functions) + ["FunctionBlock"]


def test_what_is_no_structured_text_is_found(bound: Any) -> None:
    package = bound("double")
    path = package.folder / f"{package.name}.st"
    for broken in (("END_IF;", ""), (" THEN", ""), ("END_FOR;", "END_IF;"), (" : LREAL;", " LREAL;")):
        assert parse_source_code(path.read_text().replace(*broken, 1)).exception is not None


@pytest.mark.parametrize("kind", ALL_KINDS)
def test_text_and_header_declare_the_same_functions(kind: str, bound: Any) -> None:
    package = bound(kind)
    text = read_text(package.folder / f"{package.name}.st")
    header = re.sub(r"/\*.*?\*/", "", (package.folder / f"{package.name}_iec.h").read_text(), flags=re.DOTALL)
    in_c = {}
    for result, name, arguments in re.findall(r"^(\w+) (\w+_iec_\w+)\(([^)]*)\);", header, re.M):
        rows = [re.fullmatch(r"(?:const )?(\w+ ?\*?)(\w+)", argument.strip()) for argument in arguments.split(",")]
        in_c[name] = (result, [(row[2], row[1].replace(" ", "")) for row in rows if row is not None])
    in_text = {}
    for name, declared in text.functions.items():
        arguments = []
        for argument, of, address in declared.arguments:
            word = text.types[of][0] if address else of
            arguments.append((argument, {"LWORD": "void*", "LREAL": "double*"}[word] if address else IN_C[of]))
        in_text[name] = (IN_C[declared.result], arguments)
    assert in_c == in_text and len(in_c) == (8 if kind == HELD_MASS else 9)
    called = set(re.findall(r"\w+_iec_\w+", text.body))
    assert called == set(text.functions)


@pytest.mark.parametrize("kind", ALL_KINDS)
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_the_shim_is_strict_c(kind: str, compiler: str, bound: Any, require_tool: Tool, tmp_path: Path) -> None:
    package, target = bound(kind), tmp_path / "shim.o"
    run(require_tool(compiler), STRICT, "-O2", "-c", package.folder / f"{package.name}_iec.c", "-o", target)
    foreign = {name for kind, name in symbols(target) if kind == "U"}
    assert {name for name in foreign if not name.startswith(f"{package.name}_")} <= {"memcpy", "__stack_chk_fail"}
    assert not {kind for kind, _ in symbols(target)} & set("bBdDC")


def test_names_that_structured_text_has_not_are_refused() -> None:
    for machine in ("an__axis", "axis_"):
        with pytest.raises(InputError, match="no two underscores"):
            binding_files(["iec"], machine)
        assert binding_files(["cpp"], machine)


def test_one_that_turns_has_no_mass(bound: Any) -> None:
    package = bound("rotary")
    for end in (".st", "_iec.c", "_iec.h"):
        text = (package.folder / f"{package.name}{end}").read_text().replace(f"{package.name}_set_mass(", "")
        assert not re.findall(r"\w*(?:mass|force)\w*", text, flags=re.IGNORECASE)


# --- numbers -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ALL_KINDS)
def test_it_gives_what_the_c_gives(kind: str, runtime: Any) -> None:
    plc = runtime(kind)
    log, expected = plc.package.log, plc.package.run(plc.package.log)
    block, push = plc.block(), plc.package.machine.plant.units.push
    samples, fed, rows, counted = plc.package.machine.sampling.samples_per_update, [], [], []
    for k, (q, u) in enumerate(zip(log.position_m.tolist(), log.force_N.tolist(), strict=True)):
        fed.append(block(position=q, **{push: u}))
        counted.append((block["update"], block["age"]))
        if k and k % samples == 0:
            rows.append({name: np.copy(block[name]) for name in block.outputs})
    np.testing.assert_array_equal(fed, expected.extra["compensation_N"])
    for name, wanted in outputs_of(expected).items():
        np.testing.assert_array_equal([row[name] for row in rows], wanted, err_msg=name)
    np.testing.assert_array_equal(np.transpose(counted), ages(plc.package, len(fed)))
    assert np.ptp(expected.parameters[:, 0]) > 0.0 and block["fault"] == 0 and not block["loaded"]


def test_inputs_reach_the_c(runtime: Any) -> None:
    plc = runtime("double")
    log, plain, block = plc.package.log, ticking(plc.package), plc.block()
    changed: dict[int, tuple[dict[str, Any], Callable[[], None]]] = {
        700: ({"mass": 23.5}, lambda: plain.set_mass(23.5)),
        1400: ({"compensate": False}, lambda: plain.compensate(False)),
        1700: ({"compensate": True}, lambda: plain.compensate(True)),
        2100: ({"reset": True}, plain.reset),
        2400: ({"reset": False, "ahead": False}, lambda: None),
    }
    for k, (q, u) in enumerate(zip(log.position_m[:3000].tolist(), log.force_N[:3000].tolist(), strict=True)):
        inputs, act = changed.get(k, ({}, lambda: None))
        act()
        velocity = float(0.01 * np.sin(0.01 * k))
        if k < 2400:
            plain.ahead(velocity, 0.5)
            inputs = {"ahead": True, "ahead_velocity": velocity, "ahead_acceleration": 0.5, **inputs}
        assert block(position=q, force=u, **inputs) == plain.tick(q, u)
    assert block["fault"] == 0


def test_origin_reaches_the_c(runtime: Any) -> None:
    plc = runtime(PLACES)
    log, plain, block = plc.package.log, ticking(plc.package), plc.block()
    for k, (q, u) in enumerate(zip(log.position_m[:2000].tolist(), log.force_N[:2000].tolist(), strict=True)):
        origin = 0.4 * PITCH if k >= 700 else 0.0
        if k == 700:
            plain.set_origin(origin)
        assert block(position=q, force=u, origin=origin) == plain.tick(q, u)
    assert block["fault"] == 0
    block(position=0.0, force=0.0, origin=5e6)
    assert block["fault"] == -5


def test_what_was_learned_outlives_the_power(runtime: Any) -> None:
    plc = runtime("single")
    log, first = plc.package.log, plc.block()
    samples = list(zip(log.position_m.tolist(), log.force_N.tolist(), strict=True))
    for q, u in samples[:2500]:
        first(position=q, force=u)
    first(position=samples[2500][0], force=samples[2500][1], keep=True)
    kept, learned = bytes(first["saved"]), first["parameter"]
    first(position=samples[2501][0], force=samples[2501][1])
    assert bytes(first["saved"]) == kept  # as keep rises, and not while it stays
    second, third = plc.block(first["saved"]), plc.block()
    for block in (second, third):
        block(position=samples[0][0], force=samples[0][1])
    assert second["loaded"] and not third["loaded"] and second["fault"] == third["fault"] == 0
    assert second["parameter"] == learned != third["parameter"]
    damaged = type(first["saved"]).from_buffer_copy(kept[:-8] + bytes(7) + b"\1")
    damaged[2] ^= 1 << 40
    fresh = plc.block(damaged)
    fresh(position=samples[0][0], force=samples[0][1])
    assert not fresh["loaded"] and fresh["parameter"] == third["parameter"]


def test_what_it_refuses(runtime: Any) -> None:
    plc = runtime("double")
    block = plc.block()
    block(position=0.1, force=0.0)
    for mass in (-1.0, 0.0, 401.0, float("nan")):
        block._names["fault"] = 0
        block(mass=mass)
        assert block["fault"] == REFUSED
    block._names["fault"] = 0
    block(mass=20.5)
    assert block["fault"] == 0
    call, memory = block._names, block["memory"]
    size = 8 * len(memory)
    aside = type(memory).from_buffer_copy(memory)
    raw = (ctypes.c_char * (size + 16))()
    start = plc.library.etel_xy_iec_init
    at = (ctypes.addressof(raw) + 7) // 8 * 8
    assert start(at + 4, size) == MISMATCH and start(at, size) == 0
    assert call["etel_xy_iec_init"](memory=aside, bytes=1000) == MISMATCH and bytes(aside) == bytes(memory)
    assert call["etel_xy_iec_estimate"](memory=memory, values=block["values"], count=3) == MISMATCH
    assert call["etel_xy_iec_save"](memory=memory, saved=block["saved"], bytes=8) == MISMATCH
    assert call["etel_xy_iec_load"](memory=memory, saved=block["saved"], bytes=8) == MISMATCH
    assert call["etel_xy_iec_load"](memory=memory, saved=block["saved"], bytes=8 * len(block["saved"])) == REFUSED
