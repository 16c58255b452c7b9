"""A machine under another law of friction."""

from typing import Any, Final

from sgms_mhe.configuration.resolution import override_machine
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import effect_definition
from sgms_mhe.support.errors import InputError

LAW_KEYS: Final = ("law", "stiffness", "micro_viscous", "smoothing")
"""Keys of [friction] that another law may change."""


def switch_law(machine: Machine, least: float = 0.0) -> Machine | None:
    """The machine with the other law: switching, or smooth as by default.

    Args:
        machine: with either law.
        least: smallest distance within which a smooth element breaks away [m]; stiffer ones become as soft as that.

    Returns:
        None where an effect of the machine does not stand with the law.
    """
    if machine.friction.switches:
        return smooth_elements(machine, least)
    if any(effect_definition(effect.name).smooth_only for effect in machine.effects):
        return None
    # The damping of an element would jump where it breaks away.
    changes = {"law": "switching", "micro_viscous": [0.0] * machine.friction.n_z}
    try:
        return override_machine(machine, {"friction": changes})
    except InputError:  # an effect of another package, or an integrator that the file insists on
        return None


def smooth_elements(machine: Machine, least: float, **changes: Any) -> Machine:
    """The machine with smooth elements and changes of [friction]; `least` as of `switch_law`."""
    levels = [share * machine.friction.coulomb for share in machine.friction.fraction]
    pairs = zip(levels, machine.friction.stiffness, strict=True)
    stiffness = [min(own, level / least) if least > 0.0 else own for level, own in pairs]
    return override_machine(machine, {"friction": {"law": "sgms", "stiffness": stiffness, **changes}})


def law_changes(machine: Machine, other: Machine) -> dict[str, Any]:
    """Keys of [friction] that take a machine to another one's law; empty where it is the same."""
    before, after = machine.friction, other.friction
    changes: dict[str, Any] = {}
    for key in LAW_KEYS:
        value = getattr(after, key)
        if value != getattr(before, key) and value is not None:
            changes[key] = list(value) if isinstance(value, tuple) else value
    if after.smoothing is not None and "smoothing" in changes:
        changes["smoothing"] = after.smoothing.model_dump(by_alias=True)
    return changes
