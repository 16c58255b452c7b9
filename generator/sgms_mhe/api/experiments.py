"""Motion that shows the causes of an error, and the effects that may be among them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from sgms_mhe.api.inputs import load
from sgms_mhe.diagnosis.plan import MotionPlan, make_plan
from sgms_mhe.machine import Kind, Machine
from sgms_mhe.model.effects import EffectDefinition, effect_definition, effect_names
from sgms_mhe.support.options import Option


def plan(
    machine: str | Path | Machine, separate: Annotated[tuple[str, str] | None, Option("A B")] = None
) -> MotionPlan:
    """Make the reference trajectory that separates two causes, or that excites every effect.

    Args:
        machine: file, name, or loaded.
        separate: two causes by name; None: a motion that excites every effect.

    Returns:
        The trajectory and the reason for it.

    Raises:
        InputError: the machine; a cause that does not exist.
    """
    return make_plan(load(machine), separate)


def effects(kind: Kind | None = None) -> dict[str, EffectDefinition]:
    """Return the effects that an axis may have beyond friction.

    Args:
        kind: of axis, linear or rotary; None: both.

    Returns:
        By name what each is, its parameters with units, and what a log must hold to show it.
    """
    return {name: effect_definition(name) for name in effect_names(kind)}
