"""Real numeric variables of a MAT file, version 5 (MATLAB's -v6 and -v7), members of structs among them.

scipy.io.loadmat is not used: it looks a data-type code up without checking it (scipy 1.17), so that one wrong byte in a
damaged file ends the process where a user needs a message. Numeric arrays and structs are all that a log holds.
"""

import math
import re
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from sgms_mhe.logfiles.mat73 import DEEPEST, describe_values, hdf_variables
from sgms_mhe.logfiles.table import StoredArray, Table, refuse_damage, table_of_arrays
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.libraries import optional_library

_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_MATRIX, _COMPRESSED = 14, 15
_STRUCT, _CHAR, _OPAQUE = 2, 4, 17
_NUMERIC_CLASSES = range(6, 16)  # double, single, the integers
_COMPLEX = 0x0800
_HEADER = 128
_PEEK = 4096  # bytes of a variable that hold its flags, dimensions and name
_CHANNEL = re.compile(r"(?P<root>.*\.)?(?P<own>(?:signals|Y)(?:\(\d+\))?)\.(?P<field>\w+)")
_V5, _V73 = 0x0100, 0x0200
_HDF5 = b"\x89HDF\r\n\x1a\n"  # begins a file of v7.3 that other programs wrote, without MATLAB's header
_WHOLE = "a whole MAT file, its columns arrays of real numbers"


def _read(name: str, order: str, packed: bool, body: memoryview) -> Array:
    """The values of a variable in its own shape; ValueError or zlib.error where they are damaged or not real."""
    elements = _elements(_unpack(body, packed), order)
    flags, shape, _ = _description(elements, order)
    if flags & 0xFF not in _NUMERIC_CLASSES or flags & _COMPLEX:
        raise ValueError(f"{name} is no array of real numbers")
    kind, data = next(elements, (0, memoryview(b"")))
    if kind not in _TYPES:
        raise ValueError(f"{name} has the unknown data type {kind}")
    values = np.frombuffer(data, dtype=order + _TYPES[kind])
    if values.size != math.prod(shape):
        raise ValueError(f"{name} holds {values.size} numbers for the shape {shape}")
    return values.astype(np.float64).reshape(shape, order="F")


def read_mat(path: Path) -> Table:
    """The table of a MAT file, one of v7.3 by HDF5. Raises InputError for a damaged file, OSError as open does."""
    content = path.read_bytes()
    with refuse_damage(path, _WHOLE):
        if not content.startswith(_HDF5) and _version(content) == _V5:
            return _table(path, "MAT v5", mat_variables(content))
    h5py = optional_library("h5py", "hdf5", "MAT v7.3", path)
    with refuse_damage(path, "a whole HDF5 file, as version 7.3 is, its columns arrays of real numbers"):
        return _table(path, "MAT v7.3", hdf_variables(path, h5py))


def _table(path: Path, form: str, found: dict[str, StoredArray]) -> Table:
    """The table of a file's variables; ValueError where the index of a channel's times is damaged."""
    clocks = {name: clock for name in found if (clock := _clock(name, found))}
    found |= {clock: replace(found[clock], unit=found[clock].unit or "s") for clock in clocks.values()}
    return replace(table_of_arrays(path, form, _WHOLE, found), clocks=clocks)


def _clock(name: str, found: Mapping[str, StoredArray]) -> str | None:
    """Name of the times of a channel: X(k).Data of Y(i).Data in ControlDesk's files, time of signals in Simulink's."""
    path = _CHANNEL.fullmatch(name)
    if path is None:
        return None
    root, own, field = path["root"] or "", path["own"], path["field"]
    if own.startswith("signals") and field == "values":
        wanted = [f"{root}time"]
    elif own.startswith("Y") and field == "Data":
        index = found.get(f"{root}{own}.XIndex")
        k = int(index.read().reshape(-1)[0]) if index is not None and math.prod(index.shape) == 1 else 1
        wanted = [f"{root}X({k}).Data", f"{root}X.Data"]
    else:
        return None
    return next((time for time in wanted if time in found), None)


def _version(content: bytes) -> int:
    """The version a header states; ValueError where there is no header."""
    if len(content) < _HEADER or content[126:128] not in (b"IM", b"MI"):
        raise ValueError("no MAT header")
    order = "<" if content[126:128] == b"IM" else ">"
    version = int(struct.unpack_from(order + "H", content, 124)[0])
    if version not in (_V5, _V73):
        raise ValueError(f"unknown version {version:#06x}")
    return version


def mat_variables(content: bytes) -> dict[str, StoredArray]:
    """The variables of a MAT v5 file by name, members of structs as paths with dots; ValueError where it is damaged."""
    whole = memoryview(content)
    order = "<" if content[126:128] == b"IM" else ">"
    variables: dict[str, StoredArray] = {}
    for kind, body in _elements(whole[_HEADER:], order):
        packed = kind == _COMPRESSED
        if not packed and kind != _MATRIX:
            raise ValueError(f"unknown element {kind}")
        start = memoryview(zlib.decompressobj().decompress(body, _PEEK))[8:] if packed else body
        flags = _flags(start, order)
        if flags & 0xFF == _OPAQUE:
            continue  # an object of MATLAB's own, which no other program reads
        _, shape, name = _description(_elements(start, order), order)
        if flags & 0xFF == _STRUCT:
            variables |= _members(_unpack(body, packed), order, name, 0)
        elif name:  # what has none is MATLAB's own
            variables[name] = StoredArray(shape, partial(_read, name, order, packed, body))
    return variables


def _unpack(body: memoryview, packed: bool) -> memoryview:
    return memoryview(zlib.decompress(body))[8:] if packed else body


def _members(matrix: memoryview, order: str, path: str, depth: int) -> dict[str, StoredArray]:
    """Numeric members of a struct, and of those inside it; of an array of structs those of path(1), path(2), ..."""
    elements = _elements(matrix, order)
    _, shape, _ = _description(elements, order)
    if depth > DEEPEST:
        return {}
    try:
        (_, width), (_, names) = next(elements), next(elements)
        size = int(struct.unpack_from(order + "i", width)[0])
    except (RuntimeError, StopIteration, struct.error) as error:
        raise ValueError("cut off within a struct") from error
    if size <= 0 or len(names) % size:
        raise ValueError("a struct whose names are damaged")
    fields = [bytes(names[k : k + size]).partition(b"\0")[0].decode("latin-1") for k in range(0, len(names), size)]
    values = list(elements)
    found: dict[str, StoredArray] = {}
    for k in range(min(math.prod(shape), len(values))):
        own = path if math.prod(shape) == 1 else f"{path}({k + 1})"
        part = values[k * len(fields) : (k + 1) * len(fields)]
        found |= _fields(dict(zip(fields, part, strict=False)), order, own, depth)
    return found


def _fields(members: Mapping[str, tuple[int, memoryview]], order: str, path: str, depth: int) -> dict[str, StoredArray]:
    """Numeric members of one struct by their paths, its values with the label and the unit that stand beside them."""
    found: dict[str, StoredArray] = {}
    texts: dict[str, str] = {}
    for field, (kind, body) in members.items():
        if kind != _MATRIX or not len(body):
            continue
        own, name = _flags(body, order) & 0xFF, f"{path}.{field}"
        if own == _STRUCT:
            found |= _members(body, order, name, depth + 1)
        elif own in _NUMERIC_CLASSES:
            shape = _description(_elements(body, order), order)[1]
            found[name] = StoredArray(shape, partial(_read, name, order, False, body))
        elif own == _CHAR:
            texts[field.casefold()] = _text(body, order)
    return describe_values(found, path, texts)


def _text(matrix: memoryview, order: str) -> str:
    """An array of characters; empty where it is none that is understood."""
    elements = _elements(matrix, order)
    _description(elements, order)
    kind, data = next(elements, (0, memoryview(b"")))
    encoding = {2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16"}.get(kind, "")
    if encoding == "utf-16":
        encoding += "-le" if order == "<" else "-be"
    return bytes(data).decode(encoding, "replace").strip("\0 ") if encoding else ""


def _flags(matrix: memoryview, order: str) -> int:
    try:
        _, flags = next(_elements(matrix, order))
        return int(struct.unpack_from(order + "I", flags)[0])
    except (StopIteration, struct.error) as error:
        raise ValueError("cut off within a variable's description") from error


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
