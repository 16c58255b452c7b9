"""Fields of the machine file: every key states its meaning, unit, range and default; unknown keys are errors."""

from collections.abc import Iterable
from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field
from pydantic_core import PydanticCustomError, PydanticUndefined


def quantity(meaning: str, unit: str, default: Any = PydanticUndefined, **options: Any) -> Any:
    """A number whose description states meaning, unit, range and default; `options` are gt, ge, lt, le, alias."""
    signs = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
    span = " and ".join(f"{signs[key]} {limit:g}" for key, limit in options.items() if key in signs)
    start = "required" if default is PydanticUndefined else f"default {default}"
    return Field(default, description=f"{meaning} [{unit}]; {span or 'any finite number'}; {start}", **options)


def text(meaning: str, allowed: str, default: Any = PydanticUndefined, **options: Any) -> Any:
    """A field that is not a number: meaning, allowed values and default."""
    start = "required" if default is PydanticUndefined else f"default {default!r}"
    return Field(default, description=f"{meaning}; {allowed}; {start}", **options)


def refusal(where: str, value: object, allowed: str) -> PydanticCustomError:
    """A violated rule between keys; `where` is relative to the table that checks the rule."""
    return PydanticCustomError("rule", "{allowed}", {"where": where, "value": value, "allowed": allowed})


def listing(names: Iterable[str]) -> str:
    """Names as in a sentence."""
    return ", ".join(names)


class MachineTable(BaseModel):
    """A TOML table: unknown keys, coerced types and non-finite numbers are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)
    unknown: ClassVar[str] = "unknown key"


Positives = Annotated[tuple[Annotated[float, Field(gt=0, le=1e12)], ...], Field(strict=False)]
NonNegatives = Annotated[tuple[Annotated[float, Field(ge=0, le=1e9)], ...], Field(strict=False)]
Deviation = Annotated[float, Field(gt=0, le=1e12)]
Names = Annotated[tuple[str, ...], Field(strict=False)]
Pair = Annotated[tuple[Annotated[float, Field(ge=0)], float], Field(strict=False)]
