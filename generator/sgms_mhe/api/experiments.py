"""Motion that shows the causes of an error, and the effects that may be among them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from sgms_mhe.api.inputs import load
from sgms_mhe.diagnosis.plan import MotionPlan, list_open_causes, make_plan
from sgms_mhe.machine import Kind, Machine
from sgms_mhe.model.effects import EffectDefinition, effect_definition, effect_names
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.options import Option


def plan(
    machine: str | Path | Machine,
    separate: Annotated[tuple[str, str] | None, Option("A B")] = None,
    open_in: Annotated[Path | None, Option("FILE.json", name="--open")] = None,
) -> MotionPlan:
    """Make the reference trajectory that separates two causes, answers open questions, or excites every effect.

    Args:
        machine: file, name, or loaded.
        separate: two causes by name; None: a motion that excites every effect.
        open_in: statements of start, identify --json or diagnose; the motion answers their open questions.

    Returns:
        The trajectory and the reason for it.

    Raises:
        InputError: the machine; a cause that does not exist; a result that leaves nothing to a motion.
    """
    if separate is not None and open_in is not None:
        raise InputError("plan", "--open", str(open_in), "none beside --separate")
    return make_plan(load(machine), separate, () if open_in is None else list_open_causes(Path(open_in)))


def effects(kind: Kind | None = None) -> dict[str, EffectDefinition]:
    """Return the effects an axis may have beyond friction.

    Args:
        kind: of axis, linear or rotary; None: both.

    Returns:
        By name the meaning of each, its parameters with units, and the excitation needed in a log.
    """
    return {name: effect_definition(name) for name in effect_names(kind)}
