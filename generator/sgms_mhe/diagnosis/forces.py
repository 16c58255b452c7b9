"""Effects under test that are plain forces: they stand beside a compiled model and need no code of their own.

A force of the signals and its own numbers alone leaves the elements' motion as it is, so the model with it is the one
without it, and that force. What is compiled is then one model for all of them, however they are combined.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from sgms_mhe.diagnosis.freeing import Structure, extended_machine
from sgms_mhe.host.evaluation import Evaluation
from sgms_mhe.host.packages import SYMBOLIC
from sgms_mhe.machine import Machine
from sgms_mhe.model import SIGNAL_NAMES, FreeParameter
from sgms_mhe.model.building import load_is_read, plain_force
from sgms_mhe.model.effects import Stage, effect_definition

Array = NDArray[np.float64]

AT_A_TIME: Final = 16_384  # samples whose intermediate values stay near the processor
KEPT: Final = 512  # structures that were looked at
MIXING: Final[tuple[Stage, ...]] = ("signal", "motor", "log", "actuator")
"""Stages of effects that change what a force reads, or what becomes of it."""


@dataclass(frozen=True, eq=False)
class Force:
    """A plain force.

    Attributes:
        parameters: its free ones, in their order.
        loads: whether it acts on the load.
    """

    parameters: tuple[FreeParameter, ...]
    loads: bool
    _evaluation: Evaluation

    def at(self, w: Array, theta: Array, *, derivatives: bool) -> tuple[Array, Array | None]:
        """Force (n) [N] at signals w (n, 5) with its theta (n_p), and its derivatives (n, n_p) where asked for."""
        n, n_p = len(w), len(self.parameters)
        force, slopes = np.empty(n), np.empty((n, n_p)) if derivatives else None
        numbers = {free.column: float(value) for free, value in zip(self.parameters, theta, strict=True)}
        for first in range(0, n, AT_A_TIME):
            part = slice(first, first + AT_A_TIME)
            signals = {name: w[part, i] for i, name in enumerate(SIGNAL_NAMES)}
            found = self._evaluation.at({**signals, **numbers})
            force[part] = found[0]
            if slopes is not None:
                for i in range(n_p):
                    slopes[part, i] = found[1 + i]
        return force, slopes


@lru_cache(maxsize=KEPT)
def force_of(structure: Structure) -> Force | None:
    """The last effect of a structure, if it is a plain force."""
    with SYMBOLIC:
        machine = extended_machine(structure)
        plain = plain_force(machine, machine.effects[-1].label)
        if plain is None:
            return None
        names = [free.column for free in plain.parameters]
        outputs = ca.vertcat(plain.force, ca.jacobian(plain.force, plain.theta).T)
        evaluation = Evaluation(outputs, {"w": plain.w, "theta": plain.theta}, {"w": SIGNAL_NAMES, "theta": names})
    return Force(plain.parameters, plain.loads, evaluation)


@lru_cache(maxsize=KEPT)
def _load_is_read(structure: Structure) -> bool:
    with SYMBOLIC:
        return load_is_read(extended_machine(structure))


def plain_places(machine: Machine, structures: Sequence[Structure]) -> tuple[int, ...]:
    """Which of some effects under test, each a structure with the machine, may stand beside a compiled model.

    None where one of them, or of the machine's, changes what forces read or what becomes of them.
    """
    names = [name for structure in structures for name, _ in structure.extras]
    stages = {effect_definition(name).stage for name in (*names, *(effect.name for effect in machine.effects))}
    if not stages.isdisjoint(MIXING):
        return ()
    forces = [force_of(structure) for structure in structures]
    compiled = tuple(s.extras[0] for s, force in zip(structures, forces, strict=True) if force is None)
    loaded = _load_is_read(Structure(machine, tuple(sorted(compiled))))
    return tuple(i for i, force in enumerate(forces) if force is not None and not (force.loads and loaded))
