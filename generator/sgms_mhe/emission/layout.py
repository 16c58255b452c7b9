"""Bytes declared by emitted C, read from its text: the memory of an axis, and tables of constants.

For processors on which numbers of 64 bits lie at multiples of eight bytes, as they do on Arm, RISC-V and x86-64.
"""

import ast
import ctypes
import operator
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Final

_SCALARS: Final = ("double", "float", "int", "int32_t", "int64_t", "uint8_t", "uint32_t", "uint64_t")
_OPERATIONS: Final[Mapping[type[ast.operator], Callable[[int, int], int]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
}
_STRUCT: Final = re.compile(r"^typedef struct \{(.*?)^\} (\w+);", re.DOTALL | re.MULTILINE)
_GROUP: Final = re.compile(r"struct \{([^{}]*)\} (\w+);")
"""Members of a structure that are one of their own."""
_CONSTANT: Final = re.compile(
    r"(?:^#define (?=\w+ )|^ +(?=\w+ = )|enum \{ )(\w+)(?: = | )([\w +*()-]+?)(?:,|\n| \})", re.MULTILINE
)
_TABLE: Final = re.compile(r"^static const (\w+) (\w+)((?:\[[^\]]+\])+) =", re.MULTILINE)
_ALIAS: Final = re.compile(r"^typedef (\w+) (\w+);", re.MULTILINE)


@dataclass(frozen=True)
class Memory:
    """Bytes of a package.

    Attributes:
        axis: of the memory of one axis.
        estimate: of an estimate.
        saved: of data kept over a power cycle.
        tables: of the estimator's constant tables.
        vectors: of those of the self-test; 0 where there is none.
        drive: of the memory of a drive; 0 where there is none.
    """

    axis: int
    estimate: int
    saved: int
    tables: int
    vectors: int
    drive: int


@dataclass(frozen=True)
class _Type:
    size: int
    alignment: int


def memory_of(files: Mapping[str, str], name: str, real: str) -> Memory:
    """Bytes the emitted files of a package declare.

    Args:
        files: text by file name.
        name: of the machine.
        real: C type of the package's numbers.
    """
    code = {
        file: re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
        for file, text in files.items()
        if file.endswith((".c", ".h")) and file.startswith(name)
    }
    constants = _constants(code.values())
    sizes = {scalar: ctypes.sizeof(getattr(ctypes, f"c_{scalar.removesuffix('_t')}")) for scalar in _SCALARS}
    types = {scalar: _Type(size, size) for scalar, size in sizes.items()}
    types["sgms_real"] = types[real]
    header = code[f"{name}.h"]
    for known, alias in _ALIAS.findall(header):
        types[alias] = types[known]
    for body, struct in _STRUCT.findall(header):
        types[struct] = _struct(body, types, constants)
    vectors = f"{name}_selftest.h"
    return Memory(
        axis=types[f"{name}_t"].size,
        estimate=types[f"{name}_estimate_t"].size,
        saved=types[f"{name}_saved_t"].size,
        tables=sum(_tables(text, types, constants) for file, text in code.items() if file != vectors),
        vectors=_tables(code.get(vectors, ""), types, constants),
        drive=types[f"{name}_drive_t"].size if f"{name}_drive_t" in types else 0,
    )


def _constants(texts: Iterable[str]) -> dict[str, int]:
    """Integer constants by name, macros and enumerations."""
    written = {name: value for text in texts for name, value in _CONSTANT.findall(text)}
    known: dict[str, int] = {}

    def valued(expression: str) -> int | None:
        try:
            return _value(ast.parse(expression.strip(), mode="eval").body, known)
        except (SyntaxError, KeyError):
            return None

    # Some stand before what they are made of: as many rounds as there are links in the longest chain of them.
    while found := {n: v for n, text in written.items() if n not in known and (v := valued(text)) is not None}:
        known |= found
    return known


def _value(node: ast.expr, constants: Mapping[str, int]) -> int:
    """Value of a C expression of integers, which reads as a Python one. Raises KeyError where it is none."""
    match node:
        case ast.Constant(value=int(number)):
            return number
        case ast.Name(id=name):
            return constants[name]
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATIONS:
            return _OPERATIONS[type(op)](_value(left, constants), _value(right, constants))
    raise KeyError(ast.unparse(node))


def _count(dimensions: str, constants: Mapping[str, int]) -> int:
    """Elements of an array by its dimensions, `[2][STATES * 3]`."""
    count = 1
    for dimension in re.findall(r"\[([^\]]+)\]", dimensions):
        count *= _value(ast.parse(" ".join(dimension.split()), mode="eval").body, constants)
    return count


def _struct(body: str, types: Mapping[str, _Type], constants: Mapping[str, int]) -> _Type:
    """A structure, its members one after the other at multiples of their alignment."""
    groups = {f"struct.{name}": _struct(members, types, constants) for members, name in _GROUP.findall(body)}
    size, alignment = 0, 1
    for declaration in filter(None, (part.strip() for part in _GROUP.sub(r"struct.\2 \2;", body).split(";"))):
        kind, _, members = declaration.removeprefix("volatile ").partition(" ")
        own = groups[kind] if kind in groups else types[kind]
        alignment = max(alignment, own.alignment)
        for member in members.split(","):
            size = -(-size // own.alignment) * own.alignment + own.size * _count(member, constants)
    return _Type(-(-size // alignment) * alignment, alignment)


def _tables(text: str, types: Mapping[str, _Type], constants: Mapping[str, int]) -> int:
    """Bytes of the constant arrays a file defines."""
    return sum(types[kind].size * _count(size, constants) for kind, _, size in _TABLE.findall(text) if kind in types)
