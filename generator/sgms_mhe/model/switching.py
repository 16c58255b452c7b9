"""Conditions on an axis whose elements switch: each element takes a step in closed form."""

from typing import NoReturn

import casadi as ca

from sgms_mhe.machine import Machine
from sgms_mhe.model.axis import SymbolicAxis
from sgms_mhe.model.friction import Elements
from sgms_mhe.support.errors import InputError


def check_switching(machine: Machine, axis: SymbolicAxis, elements: Elements) -> None:
    """Refuse an axis whose elements are no clips of the axis' displacement at a level known in closed form.

    This package's effects say so themselves (`smooth_only`), and are refused where the machine file is read.

    Raises:
        InputError: the obstacle, and its reason.
    """

    def refuse(why: str) -> NoReturn:
        effects = [effect.label for effect in machine.effects]
        raise InputError(machine.source, "friction.law", machine.friction.law, f"sgms with effects {effects}: {why}")

    if not axis.engagement.is_one():
        refuse("one of them moves elements by another velocity than the axis has")
    if not axis.micro_viscous.is_zero():
        refuse("one of them damps elements, a force that would jump where they break away")
    chi = ca.vertcat(*(state.chi for state in axis.states))
    for k, state in enumerate(axis.states):
        if not ca.depends_on(elements.level, state.chi):
            continue
        rate = state.rate if state.rate is not None else ca.SX(0)
        slope = ca.gradient(rate, state.chi)
        alone = not any(ca.depends_on(rate, chi[j]) for j in range(chi.numel()) if j != k)
        if state.spec.element is not None or not alone or ca.depends_on(slope, chi) or slope.is_zero():
            refuse(f"the level depends on {state.spec.name}, which has no linear equation of its own")
