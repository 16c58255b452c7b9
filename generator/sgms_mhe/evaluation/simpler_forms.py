"""The error that a simpler form of an axis makes along a measured motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from sgms_mhe.evaluation.prediction import predict_signals
from sgms_mhe.machine import Machine
from sgms_mhe.model.simple import SimpleAxis, simple_friction
from sgms_mhe.signals.chain import signals_from_log
from sgms_mhe.signals.logs import Log, align_velocity

_ALWAYS_FREE: Final = ("coulomb",)


@dataclass(frozen=True)
class FormError:
    """Friction in a form minus friction of the machine's own model, over `rows` valid samples of a log.

    rms [N, N m] of the difference; model_rms [N, N m] of the model's friction.
    """

    rows: int
    rms: float
    model_rms: float

    @property
    def relative(self) -> float:
        """RMS of the difference over RMS of the model's friction; NaN where that is 0."""
        return self.rms / self.model_rms if self.model_rms > 0.0 else float("nan")


def form_error(
    machine: Machine, form: str, simple: SimpleAxis | None, left_out: tuple[str, ...], log: Log
) -> FormError | None:
    """Compare the friction that a form holds with the model's along the motion in a log.

    Args:
        machine: the axis.
        form: name of the form.
        simple: its friction, where that is Coulomb and viscous alone; None: the whole law.
        left_out: labels of the effects that are not in the whole law.
        log: of the axis.

    Returns:
        The error; None where the form holds the whole law and every effect.

    Raises:
        InputError: no sample of the log is a valid measurement of friction.
        BuildError: the C compiler refused.
    """
    if simple is None and not left_out:
        return None
    signals = signals_from_log(align_velocity(log), machine)
    model = predict_signals(machine, signals, log.source).friction_N
    if simple is not None:
        added = (simple.inertia - machine.plant.moved) * signals.acceleration
        place = simple.place_force(signals.position)
        friction = added + place + simple_friction(form, simple, signals.velocity, signals.force - place)
    else:
        friction = predict_signals(_without(machine, left_out), signals, log.source).friction_N
    valid = signals.valid & np.isfinite(friction) & np.isfinite(model)
    rms, model_rms = (float(np.sqrt(np.mean(x[valid] ** 2))) for x in (friction - model, model))
    return FormError(int(valid.sum()), rms, model_rms)


def _without(machine: Machine, labels: tuple[str, ...]) -> Machine:
    """The machine without some effects, and with something to estimate."""
    effects = tuple(effect for effect in machine.effects if effect.label not in labels)
    free = machine.estimator.model_copy(update={"parameters": _ALWAYS_FREE, "prior": {}, "bounds": {}})
    return replace(machine, effects=effects, estimator=free)
