"""Tables [compensation] and [code]: the emitted C's feed-forward, and its numbers."""

from typing import Literal

from sgms_mhe.machine.fields import MachineTable, quantity, text


class Compensation(MachineTable):
    """The friction that tick feeds forward to the drive."""

    delay: float = quantity("from a sample until the force that answers it acts, mean", "s", 0.0, ge=0, le=0.1)
    ramp: float = quantity("from off to fully on, and back", "s", 0.0, ge=0, le=100)
    limit: float | None = quantity(
        "largest force fed forward; default twice the friction at max_velocity with parameters at their upper bounds, "
        "none on an axis with effects or where coulomb or viscous is estimated without bounds",
        "N",
        None,
        gt=0,
        le=1e9,
    )
    hold: float = quantity(
        "speed below which the force fed forward holds; two encoder steps over the filters' delay end hunting at rest",
        "m/s",
        0.0,
        ge=0,
        le=10,
    )
    on_doubt: Literal["keep", "ramp"] = text(
        "the force while the status says DOUBT: stays, or ramps to zero until it does not", "keep or ramp", "keep"
    )
    enabled: bool = text("on from init on; otherwise the compensate call turns it on", "true or false", True)


class Code(MachineTable):
    """The emitted C."""

    precision: Literal["double", "single"] = text("floating-point type", "double or single", "double")
    accuracy: float = quantity(
        "share of the stated noise that keeping less may cost, rounded or found again; 0: all is kept",
        "1",
        0.0,
        ge=0,
        le=0.1,
    )
    tick_budget: float | None = quantity(
        "operations that the longest tick may take; default 250e6 per second, a Cortex-M7's, over rate",
        "1",
        None,
        gt=0,
        le=1e15,
    )
