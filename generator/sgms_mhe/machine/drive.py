"""Table [drive]: the force a commanded axis makes of its command, where no force was recorded."""

from typing import Any, ClassVar, Final, Literal, Self

from pydantic import Field, model_validator

from sgms_mhe.machine.fields import MachineTable, listing, refusal, text

_LOOP: Final = ("gain", "gain_unit", "speed_limit", "start")


def _number(meaning: str, unit: str, most: float, default: float | None = None) -> Any:
    said = f"{meaning} [{unit}]; > 0 and <= {most:g}; default {'none' if default is None else default}"
    return Field(default, gt=0, le=most, description=said)


class Drive(MachineTable):
    """Drive of an axis: its command is a force, a voltage (or a share of the supply), or the goal of a position loop.

    voltage = supply clip(gain gain_unit (goal - position) +- start, +- clamp); force = (voltage - k velocity) k /
    resistance, k: torque_constant. The goal goes to its place at speed_limit. A drive that is not enabled makes no
    force.
    """

    STEEP: ClassVar[float] = 10.0
    """Slope of the least share at the goal, where a step would have the loop chatter."""

    kind: Literal["force", "voltage", "position_loop"] = text("command", "force, voltage or position_loop", "force")
    torque_constant: float | None = _number("torque over current, at the axis", "N m/A, N/A", 1e6)
    resistance: float | None = _number("of the windings", "ohm", 1e6)
    supply: float | None = _number("voltage of the supply", "V", 1e5)
    gain: float | None = _number(
        "of the position loop, as the firmware counts; that of a run stands before it", "1", 1e9
    )
    gain_unit: float | None = _number("share of the supply per error of position and unit of gain", "1/rad, 1/m", 1e9)
    start: float = Field(
        0.0, ge=0, lt=1, description="least share of the supply towards the goal [1]; >= 0 and < 1; default 0.0"
    )
    clamp: float | None = _number("largest share of the supply", "1", 1.0)
    delay: float = Field(0.0, ge=0, le=1, description="until a command acts [s]; >= 0 and <= 1; default 0.0")
    speed_limit: float | None = _number("speed at which the goal of the loop goes to its place", "rad/s, m/s", 1e6)

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of a log that may be the command, by the names of a linear axis."""
        return {"force": (), "voltage": ("voltage_V", "duty"), "position_loop": ("goal_m",)}[self.kind]

    @model_validator(mode="after")
    def _check(self) -> Self:
        given = {key for key in type(self).model_fields if key != "kind" and getattr(self, key) not in (None, 0.0)}
        other = given if self.kind == "force" else given & set(_LOOP) if self.kind == "voltage" else ()
        for key in sorted(other):
            raise refusal(key, getattr(self, key), f"a kind that has it; where kind is {self.kind} it does nothing")
        motor = ("torque_constant", "resistance")
        needed = {"force": (), "voltage": motor}.get(self.kind, (*motor, "supply", "gain", "gain_unit"))
        if self.clamp is not None:
            needed = (*needed, "supply")
        for key in needed:
            if getattr(self, key) is None:
                raise refusal(key, None, f"required where kind is {self.kind}: {listing(dict.fromkeys(needed))}")
        return self
