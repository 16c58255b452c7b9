"""Table [log]: from the variables of a measured file to the columns of a log."""

from __future__ import annotations

from typing import Annotated, Any, Final, Self

from pydantic import BeforeValidator, Field, model_validator

from sgms_mhe.machine.fields import Table, listing, quantity, refusal, text

LOG_UNITS: Final[dict[str, dict[str, tuple[float, float]]]] = {
    "time_s": {"s": (1.0, 0.0), "ms": (1e-3, 0.0), "us": (1e-6, 0.0), "min": (60.0, 0.0)},
    "position_m": {"m": (1.0, 0.0), "mm": (1e-3, 0.0), "um": (1e-6, 0.0), "nm": (1e-9, 0.0)},
    "force_N": {"N": (1.0, 0.0), "mN": (1e-3, 0.0), "kN": (1e3, 0.0)},
    "velocity_m_s": {"m/s": (1.0, 0.0), "mm/s": (1e-3, 0.0), "um/s": (1e-6, 0.0)},
    "acceleration_m_s2": {"m/s^2": (1.0, 0.0), "mm/s^2": (1e-3, 0.0)},
    "friction_N": {"N": (1.0, 0.0), "mN": (1e-3, 0.0), "kN": (1e3, 0.0)},
    "temperature_degC": {"degC": (1.0, 0.0), "K": (1.0, -273.15)},
}
"""Columns of a log, and the units in which a recorded file may hold them: SI value = factor * value + shift."""


class LogColumn(Table):
    """Where a log's column comes from: column = scale * variable + offset, given in `unit`."""

    variable: str = text("variable or header of the measured file", "a name", min_length=1)
    scale: float = quantity("factor on the variable; not 0", "unit per recorded unit", 1.0)
    offset: float = quantity("added after scaling", "unit", 0.0)
    unit: str | None = text("unit after scale and offset", "see the column; the column's own where absent", None)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.scale == 0.0:
            raise refusal("scale", self.scale, "a number other than 0")
        return self


def _as_column(data: Any) -> Any:
    return {"variable": data} if isinstance(data, str) else data


Source = Annotated[LogColumn | None, BeforeValidator(_as_column, json_schema_input_type=LogColumn | str | None)]


def _column(name: str) -> Any:
    allowed = f"a variable's name or {{ variable, scale, offset, unit }} with unit {listing(LOG_UNITS[name])}"
    return Field(None, description=f"source of the log's column {name}; {allowed}; default: a variable named {name}")


class LogMapping(Table):
    """Variables, scales and units of a measured file, for recorded files that are read as they are."""

    time_s: Source = _column("time_s")
    position_m: Source = _column("position_m")
    force_N: Source = _column("force_N")
    velocity_m_s: Source = _column("velocity_m_s")
    acceleration_m_s2: Source = _column("acceleration_m_s2")
    friction_N: Source = _column("friction_N")
    temperature_degC: Source = _column("temperature_degC")

    @model_validator(mode="after")
    def _check(self) -> Self:
        for name, units in LOG_UNITS.items():
            column: LogColumn | None = getattr(self, name)
            if column is not None and column.unit is not None and column.unit not in units:
                raise refusal(f"{name}.unit", column.unit, f"one of {listing(units)}")
        return self
