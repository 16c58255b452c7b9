"""Axes of the logs: linear or turning, and the law of friction that their machine files state."""

from dataclasses import dataclass
from typing import Final, Literal

from numpy.random import Generator

from sgms_mhe.configuration import make_machine, switch_law
from sgms_mhe.machine import Kind, Machine

PlantLaw = Literal["sgms", "maxwell_slip"]
LAWS: Final[tuple[PlantLaw, ...]] = ("sgms", "maxwell_slip")
ROTARY: Final = 0.2
"""Share of draws whose axis turns."""
OTHER_LAW: Final = 0.35
"""Share of draws whose machine file states the other law, whatever the axis obeys."""


@dataclass(frozen=True)
class DrawnAxis:
    """An axis of the benchmark.

    Attributes:
        kind: of the plant.
        other_law: whether its file states the law that the machine given does not.
        obeys: the law of the simulated axis.
    """

    kind: Kind
    other_law: bool
    obeys: PlantLaw

    @property
    def switches(self) -> bool:
        """Return True if its elements slip at once."""
        return self.obeys == "maxwell_slip"


def draw_axis(random: Generator, machine: Machine) -> DrawnAxis:
    """Any of them; a machine that turns stays one that turns."""
    turns, other, obeys = random.uniform(), random.uniform(), random.choice(["sgms", "maxwell_slip"])
    kind: Kind = "rotary" if turns < ROTARY else machine.plant.kind
    return DrawnAxis(kind, bool(other < OTHER_LAW), "sgms" if obeys == "sgms" else "maxwell_slip")


def machine_file(machine: Machine, axis: DrawnAxis) -> Machine:
    """The file of that axis: turned round, metres are radians and kilograms are kg m^2 of the same number.

    Of the machine given where an effect of its own does not stand with the other law.
    """
    if axis.kind != machine.plant.kind:
        plant = {"kind": axis.kind, "inertia": machine.plant.moved}
        machine = make_machine({**machine.content, "plant": plant}, machine.source)
    other = switch_law(machine) if axis.other_law else None
    return machine if other is None else other
