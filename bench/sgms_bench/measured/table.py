"""Table of measured records: files, columns, protocol and published numbers, as TOML."""

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from sgms_mhe.support.errors import InputError

Beginning = Literal["file", "start", "identify"]
TABLE_NAME: Final = "measured.toml"
"""File of a data folder in which the table is looked for."""
PUBLIC: Final = Path(__file__).with_name("public.toml")
"""Table of public records, for a folder that has none of its own."""
_Positive = Annotated[float, Field(gt=0.0)]
_Interval = tuple[Annotated[float, Field(ge=0.0)], _Positive]


class StartNumbers(BaseModel):
    """Numbers that `start` is told of an axis."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    mass: _Positive = 1.0
    coulomb: _Positive | None = None
    viscous: _Positive | None = None
    break_away: _Positive | None = None
    max_velocity: _Positive | None = None


class MeasuredRecord(BaseModel):
    """One entry `[[records]]`.

    Attributes:
        name: of the row.
        log: file, beside the table.
        table: content of a table `[log]`.
        machine: name, or file beside the table, that a diagnosis begins from; absent: `start` and `identify` make one.
        begin: beginnings to run; default: the machine's file, or both others.
        start: what `start` is told.
        fit: stretch of the log that models see [s since its start]; default: the first half.
        predict: stretch that they are compared on; default: the second half, of another log all of it.
        other: log to compare on instead.
        lowpass: low-pass of the comparison [Hz]; default: the machine's.
        decimate: samples per compared one [1].
        published: errors of others by name: RMS in the force's unit, or in percent of the force.
        published_in: which of the two.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    log: str
    table: dict[str, Any] = Field(default_factory=dict)
    machine: str | None = None
    begin: tuple[Beginning, ...] = ()
    start: StartNumbers = StartNumbers()
    fit: _Interval | None = None
    predict: _Interval | None = None
    other: str | None = None
    lowpass: _Positive | None = None
    decimate: Annotated[int, Field(ge=1, le=100)] = 1
    published: dict[str, float] = Field(default_factory=dict)
    published_in: Literal["rms", "percent"] = "rms"

    @property
    def beginnings(self) -> tuple[Beginning, ...]:
        """Beginnings of a diagnosis that are run."""
        return self.begin or (("start", "identify") if self.machine is None else ("file",))


class MotorConstants(BaseModel):
    """Published constants of a motor, which motion alone does not tell from its clamp."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    torque_constant: _Positive
    resistance: _Positive


class MeasuredMotion(BaseModel):
    """One entry `[[motions]]`: a commanded axis, judged by the motion that its commands make.

    Attributes:
        name: of the row.
        logs: pattern of the files that are fitted.
        other: pattern of those that they are compared on: the same runs again, in the same order.
        unseen: patterns of the fitted files' names that a second fit leaves out, by what they have in common.
        published: mean absolute errors of others by name [m, rad].
        wanted: the same, that ours is to be below.
        constants: of the motor, by which the clamp is stated.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    logs: str
    other: str
    unseen: dict[str, str] = Field(default_factory=dict)
    published: dict[str, float] = Field(default_factory=dict)
    wanted: _Positive | None = None
    constants: MotorConstants | None = None


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    records: tuple[MeasuredRecord, ...] = ()
    motions: tuple[MeasuredMotion, ...] = ()

    @property
    def entries(self) -> tuple[MeasuredRecord | MeasuredMotion, ...]:
        """All rows."""
        return (*self.records, *self.motions)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not self.records and not self.motions:
            raise ValueError("at least one of [[records]] or [[motions]]")
        return self


@dataclass(frozen=True)
class MeasuredTable:
    """Records of a table, and the folder that its files are in.

    Attributes:
        records: whose files the folder has.
        folder: that their paths begin at.
        motions: of commanded axes, likewise.
        absent: names of public records whose files it does not have.
    """

    records: tuple[MeasuredRecord, ...]
    folder: Path
    motions: tuple[MeasuredMotion, ...] = ()
    absent: tuple[str, ...] = ()

    def locate(self, name: str) -> Path:
        """Path of a file that the table names."""
        return self.folder / name


def read_table(data: Path, table: Path | None = None) -> MeasuredTable:
    """Read the table of a data folder.

    Args:
        data: folder that the table's files are in.
        table: its file; None: `measured.toml` in the folder, or else the public records that the folder has.

    Raises:
        InputError: no such file, no TOML, or an entry that no table may have; a folder without any public record.
    """
    path = table or data / TABLE_NAME
    if table is None and not path.is_file():
        return _read_public(data)
    content = _read_content(path)
    for record in content.entries:
        for name in _missing(record, data):
            raise InputError(path, f"{record.name}: log", name, f"a file in {data}")
    return MeasuredTable(content.records, data, content.motions)


def _read_public(data: Path) -> MeasuredTable:
    content = _read_content(PUBLIC)
    records = tuple(record for record in content.records if not _missing(record, data))
    motions = tuple(motion for motion in content.motions if not _missing(motion, data))
    if not records and not motions:
        files = {*(r.log for r in content.records), *(m.logs for m in content.motions)}
        wanted = f"{TABLE_NAME}, or files of public records ({', '.join(sorted(files))})"
        raise InputError(data, "measured records", None, f"{wanted}; TABLE=FILE names another table")
    absent = tuple(one.name for one in content.entries if _missing(one, data))
    return MeasuredTable(records, data, motions, absent)


def _read_content(path: Path) -> _Table:
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError:
        raise InputError(path, "table of measured records", None, "a file; TABLE=FILE names another one") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(path, "content", None, f"TOML: {error}") from None
    try:
        table = _Table.model_validate(content)
    except ValidationError as error:
        raise _refusal(path, error) from None
    for record in table.records:
        if "file" in record.begin and record.machine is None:
            raise InputError(path, f"{record.name}: begin", list(record.begin), "start, identify: there is no machine")
    return table


def _missing(record: MeasuredRecord | MeasuredMotion, data: Path) -> list[str]:
    """Return the logs of a record that are no files of the folder."""
    if isinstance(record, MeasuredMotion):
        return [pattern for pattern in (record.logs, record.other) if not any(data.glob(pattern))]
    return [name for name in (record.log, record.other) if name is not None and not (data / name).is_file()]


def _refusal(path: Path, error: ValidationError) -> InputError:
    first = error.errors()[0]
    where = ".".join(str(key + 1 if isinstance(key, int) else key) for key in first["loc"])
    value = None if first["type"] == "missing" else first["input"]
    return InputError(path, where or "content", value, first["msg"])
