"""Real numeric variables of a MAT file, version 5 (what MATLAB saves with -v6 and -v7).

scipy.io.loadmat is not used: it looks a data-type code up without checking it (scipy 1.17), so that one wrong byte in a
damaged file ends the process where a user needs a message. Numeric arrays are all that a log holds.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.signals.formats.variables import Choose, Variables, array_row, damaged, vector
from sgms_mhe.support.errors import InputError

_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_MATRIX, _COMPRESSED = 14, 15
_NUMERIC_CLASSES = range(6, 16)  # double, single, the integers
_COMPLEX = 0x0800
_HEADER = 128
_PEEK = 4096  # bytes of a variable that hold its flags, dimensions and name


@dataclass(frozen=True)
class MatVariable:
    """A variable that has been found and not yet read."""

    name: str
    order: str
    packed: bool
    body: memoryview

    def read(self) -> NDArray[np.float64]:
        """The values in the variable's own shape; ValueError or zlib.error where they are damaged or not real."""
        matrix = memoryview(zlib.decompress(self.body))[8:] if self.packed else self.body
        elements = _elements(matrix, self.order)
        flags, shape, _ = _description(elements, self.order)
        if flags & 0xFF not in _NUMERIC_CLASSES or flags & _COMPLEX:
            raise ValueError(f"{self.name} is no array of real numbers")
        kind, data = next(elements, (0, memoryview(b"")))
        if kind not in _TYPES:
            raise ValueError(f"{self.name} has the unknown data type {kind}")
        values = np.frombuffer(data, dtype=self.order + _TYPES[kind])
        if values.size != math.prod(shape):
            raise ValueError(f"{self.name} holds {values.size} numbers for the shape {shape}")
        return values.astype(np.float64).reshape(shape, order="F")


def read_mat(path: Path, choose: Choose) -> Variables:
    """Read the wanted variables. Raises InputError for a damaged file or one of v7.3, OSError as open does."""
    try:
        found = mat_variables(path)
        variables = {name: found[name].read() for name in choose(list(found))}
    except NotImplementedError:
        raise InputError(path, "file", None, "MAT v5; this one is v7.3 (save it with -v7)") from None
    except (ValueError, zlib.error) as error:
        raise damaged(path, "a whole MAT v5 file, its columns vectors of real numbers", error) from None
    return Variables({name: vector(path, name, value) for name, value in variables.items()}, array_row)


def mat_variables(path: Path) -> dict[str, MatVariable]:
    """The variables of a MAT v5 file by name; ValueError where it is none, NotImplementedError for v7.3."""
    content = memoryview(path.read_bytes())
    if len(content) < _HEADER or bytes(content[126:128]) not in (b"IM", b"MI"):
        raise ValueError("no MAT v5 header")
    order = "<" if bytes(content[126:128]) == b"IM" else ">"
    if struct.unpack_from(order + "H", content, 124)[0] != 0x0100:
        raise NotImplementedError("MAT v7.3")
    variables = {}
    for kind, body in _elements(content[_HEADER:], order):
        packed = kind == _COMPRESSED
        if not packed and kind != _MATRIX:
            raise ValueError(f"unknown element {kind}")
        start = memoryview(zlib.decompressobj().decompress(body, _PEEK))[8:] if packed else body
        name = _description(_elements(start, order), order)[2]
        variables[name] = MatVariable(name, order, packed, body)
    return variables


def _elements(data: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """(type, content) of one element after the other; content of up to four bytes shares the tag's eight."""
    at = 0
    while at < len(data):
        if at + 8 > len(data):
            raise ValueError("cut off within a tag")
        kind, size = struct.unpack_from(order + "II", data, at)
        start, small = at + 8, kind >> 16
        if small:
            kind, size, start = kind & 0xFFFF, small, at + 4
        if start + size > len(data) or small > 4:
            raise ValueError("cut off within an element")
        yield kind, data[start : start + size]
        # Elements begin at multiples of eight bytes, but what follows a compressed one does so at once.
        at = start + size if kind == _COMPRESSED else at + 8 if small else start + -(-size // 8) * 8


def _description(elements: Iterator[tuple[int, memoryview]], order: str) -> tuple[int, tuple[int, ...], str]:
    """(flags, shape, name): the first three elements of every variable."""
    try:
        (_, flags), (_, shape), (_, name) = (next(elements) for _ in range(3))
        sizes = tuple(np.frombuffer(shape, dtype=order + "i4").tolist())
        return int(struct.unpack_from(order + "I", flags)[0]), sizes, bytes(name).decode("latin-1")
    except (RuntimeError, struct.error) as error:  # a generator turns its inner StopIteration into RuntimeError
        raise ValueError("cut off within a variable's description") from error
