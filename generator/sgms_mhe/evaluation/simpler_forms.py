"""Forces a simpler form of an axis loses along a measured motion."""

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.configuration import step_every_sample
from sgms_mhe.emission.axis_equations import axis_model
from sgms_mhe.emission.axis_forms import MICRO_VISCOUS, STRIBECK, WrittenAxis
from sgms_mhe.evaluation.prediction import predict_signals
from sgms_mhe.machine import Machine
from sgms_mhe.signals.chain import signals_from_log
from sgms_mhe.signals.logs import Log, align_velocity

_ALWAYS_FREE: Final = ("coulomb",)
PRESLIDING: Final = "presliding and rest"


@dataclass(frozen=True)
class LostForce:
    """A force of the axis a form does not hold, or not whole, over the valid samples of a log.

    Attributes:
        name: an effect's label, or a part of the law: `PRESLIDING`, `STRIBECK`, `MICRO_VISCOUS`.
        lost: RMS of the force that is not in the form [N, N m].
        rms: of the whole force.
    """

    name: str
    lost: float
    rms: float

    @property
    def relative(self) -> float | None:
        """Share of the force that is lost; None where it does not act along the log."""
        return self.lost / self.rms if self.rms > 0.0 else None


@dataclass(frozen=True)
class FormError:
    """Friction in a form minus friction of the machine's own model, over `rows` valid samples of a log.

    rms [N, N m] of the difference; model_rms [N, N m] of the model's friction; `forces`
    that are lost, each by itself, the largest loss first.
    """

    rows: int
    rms: float
    model_rms: float
    forces: tuple[LostForce, ...]

    @property
    def relative(self) -> float:
        """RMS of the difference over RMS of the model's friction; NaN where that is 0."""
        return self.rms / self.model_rms if self.model_rms > 0.0 else float("nan")

    @property
    def content(self) -> dict[str, Any]:
        """The error as `--json` has it."""
        forces = [{"name": f.name, "lost_rms_N": f.lost, "rms_N": f.rms, "relative": f.relative} for f in self.forces]
        return {"samples": self.rows, "rms_N": self.rms, "relative": self.relative, "forces": forces}


def form_error(machine: Machine, written: WrittenAxis, log: Log) -> FormError | None:
    """Compare the friction a form holds with the model's along the motion in a log, force by force.

    The force of an effect, or of the Stribeck effect, is the model's friction minus that of the model without it; the
    share of it that a form has as inertia is not lost. Presliding is the force of the law without all these; its loss
    is the difference from friction as the form's simulator computes it.

    Returns:
        The error; None where the form holds the whole law and every effect.

    Raises:
        InputError: no sample of the log is a valid measurement of friction.
        BuildError: the C compiler refused.
    """
    simple, left_out = written.simple, written.left_out
    if simple is None and not left_out:
        return None
    signals, stepped = signals_from_log(align_velocity(log), machine), step_every_sample(machine)

    def friction_without(parts: Collection[str]) -> NDArray[np.float64]:
        return predict_signals(_without(stepped, parts), signals, log.source).friction_N

    model = friction_without(())
    forces = {part: model - friction_without((part,)) for part in left_out}
    lost = dict(forces)
    if simple is None:
        friction = friction_without(left_out)
    else:
        for part in left_out if simple.inertia != machine.plant.moved else ():
            held = simple.inertia - axis_model(_without(stepped, (part,))).inertia
            lost[part] = forces[part] - held * signals.acceleration
        place = simple.place_force(signals.position)
        own = simple.friction(signals.velocity, signals.force - place, machine.sampling.step)
        friction = own + place + (simple.inertia - machine.plant.moved) * signals.acceleration
        law = friction_without((*left_out, *written.apart))
        forces[PRESLIDING], lost[PRESLIDING] = law - simple.viscous * signals.velocity, law - own
    valid = signals.valid & np.isfinite(friction) & np.isfinite(model)

    def rms(values: NDArray[np.float64]) -> float:
        return float(np.sqrt(np.mean(values[valid] ** 2)))

    losses = [LostForce(name, rms(lost[name]), rms(force)) for name, force in forces.items()]
    losses.sort(key=lambda loss: -loss.lost)
    return FormError(int(valid.sum()), rms(friction - model), rms(model), tuple(losses))


def _without(machine: Machine, parts: Collection[str]) -> Machine:
    """The machine without some effects or parts of its law, and with something to estimate."""
    friction = machine.friction
    if STRIBECK in parts:
        friction = friction.model_copy(update={"stribeck_ratio": 0.0})
    if MICRO_VISCOUS in parts:
        friction = friction.model_copy(update={"micro_viscous": (0.0,) * friction.n_z})
    effects = tuple(effect for effect in machine.effects if effect.label not in parts)
    free = machine.estimator.model_copy(update={"parameters": _ALWAYS_FREE, "prior": {}, "bounds": {}})
    return replace(machine, friction=friction, effects=effects, estimator=free)
