"""Interface of every reader of a file: named columns, read when they are asked for, and where their rows stand."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sgms_mhe.support.arrays import AnyArray, Array
from sgms_mhe.support.errors import InputError


@dataclass(frozen=True)
class Column:
    """A column, variable or channel found in a file.

    Attributes:
        name: unique within the file; of names that occur twice `name (1)`, `name (2)`.
        header: the name as it stands there.
        unit: stated by the file beside the name (a unit row, an attribute); empty where it states nothing.
        shape: of the values where it is known before reading, else empty.
    """

    name: str
    header: str
    unit: str = ""
    shape: tuple[int, ...] = ()


def columns_of(headers: Sequence[str], units: Sequence[str] = ()) -> tuple[Column, ...]:
    """Columns of these names, made unique."""
    totals = {header: headers.count(header) for header in set(headers)} if len(set(headers)) < len(headers) else {}
    seen: dict[str, int] = {}
    columns = []
    for k, header in enumerate(headers):
        seen[header] = seen.get(header, 0) + 1
        name = f"{header} ({seen[header]})" if totals.get(header, 1) > 1 else header
        columns.append(Column(name, header, units[k] if units else ""))
    return tuple(columns)


@dataclass(frozen=True)
class Table:
    """A file, its format understood.

    Attributes:
        form: the format, for people.
        dialect: understood parts of the format, as (what, how) for people; empty where there is nothing to choose.
        columns: everything that was found, in the file's order.
        read: values of columns by name: real numbers (n,) or (rows, n), or seconds since the first time stamp (n,);
            raises InputError otherwise.
        row: where sample i (from 0) stands in the file.
        stamped: names of the columns that hold time stamps.
        notes: sentences on omitted data.
        clocks: name of the column that holds the time of another one, where columns have clocks of their own.
        run: stated by the file, as `Log` has it.
    """

    form: str
    columns: tuple[Column, ...]
    read: Callable[[Sequence[str]], Mapping[str, AnyArray]]
    row: Callable[[int], str]
    dialect: tuple[tuple[str, str], ...] = ()
    stamped: frozenset[str] = frozenset()
    notes: tuple[str, ...] = ()
    clocks: Mapping[str, str] = field(default_factory=dict)
    run: Mapping[str, float] = field(default_factory=dict)

    def named(self, name: str) -> Column:
        """The column of a name."""
        return next(column for column in self.columns if column.name == name)


def damage_error(path: Path, allowed: str, error: Exception) -> InputError:
    """The error of a file its reader stumbles over."""
    return InputError(path, "file", None, f"{allowed} ({type(error).__name__}: {error})")


@contextmanager
def refuse_damage(path: Path, allowed: str) -> Iterator[None]:
    """Refuse a file its reader stumbles over in the block: readers of a damaged one do so in many ways."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        raise damage_error(path, allowed, error) from None


@dataclass(frozen=True)
class StoredArray:
    """An array of a file, found and not yet read.

    Attributes:
        shape: as its values have it.
        read: its values as real numbers; raises as its library does where they are damaged.
        label, unit: as the file states them beside it.
    """

    shape: tuple[int, ...]
    read: Callable[[], Array]
    label: str = ""
    unit: str = ""


def table_of_arrays(path: Path, form: str, allowed: str, found: Mapping[str, StoredArray]) -> Table:
    """The table of a file's variables by name; `allowed`: form wanted instead of a damaged file."""

    def read(names: Sequence[str]) -> Mapping[str, Array]:
        with refuse_damage(path, allowed):
            return {name: found[name].read() for name in names}

    columns = tuple(Column(name, v.label or name, v.unit, v.shape) for name, v in found.items())
    return Table(form, columns, read, array_row)


def array_row(index: int) -> str:
    """Where a row stands in a file of arrays."""
    return f"row {index + 1}"


def real(path: Path, name: str, value: Any) -> Array:
    """Values as real numbers in their own shape. Raises InputError for anything else."""
    array = np.asarray(value)
    if array.dtype.kind not in "fiub":
        raise InputError(path, f"variable {name}", f"{array.dtype} array of shape {array.shape}", "real numbers")
    return array.astype(np.float64)


def seconds(stamps: AnyArray) -> Array:
    """datetime64 (n,) as seconds since the first; NaN where there is none."""
    whole = stamps.astype("datetime64[ns]")
    known = ~np.isnat(whole)
    if not known.any():
        return np.full(len(whole), np.nan)
    since = (whole - whole[known][0]).astype(np.int64) / 1e9
    return np.where(known, since, np.nan)
