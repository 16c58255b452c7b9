"""Table [log]: from the variables of a measured file to the columns of a log."""

from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal, Self

from pydantic import BeforeValidator, Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from sgms_mhe.machine.fields import MachineTable, listing, quantity, refusal, text
from sgms_mhe.machine.log_units import BY_COLUMN, COUNTS, QUANTITIES, Quantity, normal_unit
from sgms_mhe.machine.units import Kind
from sgms_mhe.support.errors import InputError

SEPARATORS: Final = (",", ";", "\t", "|", " ")
"""What stands between the fields of a text; the space for any number of spaces and tabs."""


class _Spare(MachineTable):
    """A table that is written back without those of its later keys that say nothing, so that digests stay."""

    @model_serializer(mode="wrap")
    def _write(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        silent = {key for key, field in type(self).model_fields.items() if getattr(self, key) == field.default}
        return {key: value for key, value in write(self).items() if key in _ALWAYS or key not in silent}


class LogColumn(_Spare):
    """Where a log's column comes from: column = scale * variable + offset, given in `unit`."""

    variable: str | None = text("variable or header of the measured file", "a name", None, min_length=1)
    scale: float = quantity("factor on the variable; not 0", "unit per recorded unit", 1.0)
    offset: float = quantity("added after scaling", "unit", 0.0)
    unit: str | None = text("unit after scale and offset", "see the column; what the file states where absent", None)
    member: str | None = text(
        "member of a struct or group, its path with dots, `variable` before it if given", "a name", None, min_length=1
    )
    row: int | None = Field(
        None, ge=1, le=1_000_000, description="row of a matrix [1], counted from 1; default none: a vector"
    )
    counts_per: float | None = Field(
        None,
        gt=0,
        le=1e15,
        description="counts of an encoder per metre, or per revolution of a rotary axis [1]; with unit counts; "
        "default none",
    )
    wrap: float | None = Field(
        None,
        gt=0,
        le=1e15,
        description="period after which the recorded variable starts over, in its own unit (65536 counts, 360 deg); "
        "a position goes on, anything else is centred about zero; default none",
    )
    signed: int | None = Field(
        None, ge=2, le=64, description="bits of a signed number that was recorded unsigned [1]; default none"
    )

    @property
    def name(self) -> str:
        """The variable with its member, as one path with dots; empty where a row alone is named."""
        return ".".join(part for part in (self.variable, self.member) if part)

    @property
    def description(self) -> str:
        """Name and row, as messages say them."""
        row = "" if self.row is None else f"row {self.row}"
        return f"{self.name}, {row}" if self.name and row else self.name or row or "its usual name"

    @property
    def is_bare(self) -> bool:
        """True where no variable is named: the keys hold for the one found by its own or usual name."""
        return not self.name and self.row is None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.scale == 0.0:
            raise refusal("scale", self.scale, "a number other than 0")
        if not self.model_fields_set:
            raise refusal("variable", None, "required key is missing: a variable, a member, a row, or a unit")
        return self

    def check_unit(self, where: str, quantity: Quantity) -> None:
        """Refuse a unit the quantity does not have, or one without the number it needs."""
        if self.unit is None:
            if self.counts_per is not None:
                raise refusal(f"{where}.unit", None, f"{COUNTS[0]}, where counts_per is given")
            return
        unit = normal_unit(self.unit)
        if unit not in quantity.allowed:
            raise refusal(f"{where}.unit", self.unit, f"one of {listing(quantity.allowed)}")
        if unit in COUNTS and self.counts_per is None:
            per = "revolution" if quantity.unit.startswith("rad") else "metre"
            raise refusal(f"{where}.counts_per", None, f"counts per {per}, where unit is {unit}")
        if unit not in COUNTS and self.counts_per is not None:
            raise refusal(f"{where}.unit", self.unit, f"{COUNTS[0]}, where counts_per is given")
        if unit in quantity.recorded and "scale" not in self.model_fields_set:
            raise refusal(f"{where}.scale", None, f"{quantity.unit} per {unit}, where unit is {unit}")


def _as_column(data: Any) -> Any:
    return {"variable": data} if isinstance(data, str) else data


Source = Annotated[LogColumn | None, BeforeValidator(_as_column, json_schema_input_type=LogColumn | str | None)]


def _column(name: str) -> Any:
    units = listing(filter(None, BY_COLUMN[name].allowed)) or "none"
    keys = ", ".join(LogColumn.model_fields)
    allowed = f"a variable's name or {{ {keys} }}; unit {units}"
    return Field(None, description=f"source of the log's column {name}; {allowed}; default: a variable named {name}")


class LogMapping(_Spare):
    """Variables, scales and units of a measured file, for recorded files read as they are."""

    time_s: Source = _column("time_s")
    position_m: Source = _column("position_m")
    force_N: Source = _column("force_N")
    velocity_m_s: Source = _column("velocity_m_s")
    acceleration_m_s2: Source = _column("acceleration_m_s2")
    friction_N: Source = _column("friction_N")
    temperature_degC: Source = _column("temperature_degC")
    position_rad: Source = _column("position_rad")
    torque_Nm: Source = _column("torque_Nm")
    velocity_rad_s: Source = _column("velocity_rad_s")
    acceleration_rad_s2: Source = _column("acceleration_rad_s2")
    friction_Nm: Source = _column("friction_Nm")
    goal_m: Source = _column("goal_m")
    goal_rad: Source = _column("goal_rad")
    voltage_V: Source = _column("voltage_V")
    duty: Source = _column("duty")
    enabled: Source = _column("enabled")
    rate: float | None = Field(
        None,
        gt=0,
        le=1e7,
        description="samples per second of a file without a time column, or to resample to [Hz]; default none",
    )
    resample: bool = text("uneven time, or another rate, interpolated to the machine's", "true or false", False)
    homed: bool = text("position means the same in every record: absolute, or homed", "true or false", False)
    payload: bool = text("each record moves a payload of its own, which nobody knows", "true or false", False)
    separator: Literal[",", ";", "\t", "|", " "] | None = text(
        "between the fields of a text", "one of , ; | tab, or a space for any number of them", None
    )
    decimal: Literal[".", ","] | None = text("decimal mark of a text", ". or ,", None)
    encoding: str | None = text("of a text", "utf-8, utf-16, latin-1, ...: a name that Python knows", None)
    dates: Literal["dmy", "mdy"] | None = text("order in dates with slashes", "dmy or mdy", None)
    header_line: int | None = Field(
        None, ge=0, description="line of a text that holds the names [1], from 1; 0: there is none; default: found"
    )
    channel: str | None = text(
        "column of a text in long format that holds the variables' names", "a name", None, min_length=1
    )

    @property
    def columns(self) -> dict[str, LogColumn]:
        """The columns the file maps, by name."""
        found = {name: getattr(self, name) for name in BY_COLUMN}
        return {name: column for name, column in found.items() if column is not None}

    @property
    def kind(self) -> Kind | None:
        """The kind of axis whose columns are named, or else have a unit; None where that is no one kind."""
        own = {name: kinds[0] for name in self.columns if len(kinds := kinds_of(name)) == 1}
        named = [kind for name, kind in own.items() if not self.columns[name].is_bare]
        told = {kind for name, kind in own.items() if self.columns[name].unit is not None}
        return named[0] if named else told.pop() if len(told) == 1 else None

    @model_validator(mode="after")
    def _check(self) -> Self:
        for name, column in self.columns.items():
            column.check_unit(name, BY_COLUMN[name])
        known = [quantity.column for quantity in QUANTITIES[self.kind]] if self.kind else list(self.columns)
        for name, column in self.columns.items():
            if name not in known and not column.is_bare:
                raise refusal(name, getattr(self, name).description, f"columns of one kind of axis: {listing(known)}")
        return self


def log_line(column: str, **keys: object) -> str:
    """The line of [log] that states these keys of a column; `...` for values its user knows."""

    def write(value: object) -> str:
        if isinstance(value, str):
            return f'"{value}"'
        return "..." if value is ... else str(float(f"{value:.10g}") if isinstance(value, float) else value)

    return f"{column} = {{ {', '.join(f'{key} = {write(value)}' for key, value in keys.items())} }}"


def kinds_of(column: str) -> list[Kind]:
    """Kinds of axis whose logs have a column."""
    return [kind for kind, quantities in QUANTITIES.items() if column in {q.column for q in quantities}]


_ALWAYS: Final = frozenset(
    "variable scale offset unit time_s position_m force_N velocity_m_s acceleration_m_s2 friction_N "
    "temperature_degC".split()
)
"""Keys that a table is always written with."""


def table_of_flags(
    rate: float | None, wrap: float | None, units: Mapping[str, str], force_scale: float | None
) -> dict[str, Any]:
    """A table [log] of keys for columns of either kind of axis found by their usual names.

    Args:
        rate: samples per second of a file without a time column [Hz].
        wrap: period of position, in its recorded unit.
        units: by quantity (position, torque, ...) or column (position_m).
        force_scale: N, or N m, per recorded unit of force or torque.

    Raises:
        InputError: a name that is no quantity, a unit it does not have.
    """
    table: dict[str, Any] = {} if rate is None else {"rate": rate}

    def state(role: str, key: str, value: float | str) -> None:
        for column, known in BY_COLUMN.items():
            if role in (column, known.role) and (key != "unit" or normal_unit(str(value)) in known.allowed):
                table.setdefault(column, {})[key] = value

    if wrap is not None:
        state("position", "wrap", wrap)
    if force_scale is not None:
        state("force", "scale", force_scale)
    for name, unit in units.items():
        role = {"torque": "force"}.get(name, name)
        quantities = [q for column, q in BY_COLUMN.items() if role in (column, q.role)]
        allowed = dict.fromkeys(unit for quantity in quantities for unit in quantity.allowed)
        if normal_unit(unit) not in allowed:
            roles = listing(dict.fromkeys(quantity.role for quantity in BY_COLUMN.values()))
            wanted = f"{name}={' or '.join(allowed)}" if quantities else f"a quantity out of {roles}, torque"
            raise InputError("command line", "--unit", f"{name}={unit}", wanted)
        if normal_unit(unit) in COUNTS:
            lines = " or ".join(
                f'{q.column} = {{ unit = "{normal_unit(unit)}", counts_per = ... }}' for q in quantities if q.counted
            )
            wanted = f"counts per metre or revolution, as a table [log] says, --log FILE.toml: {lines}"
            raise InputError("command line", "--unit", f"{name}={unit}", wanted)
        state(role, "unit", unit)
    return table
