"""What is fitted: the model of an axis along one record, as immutable values, and the fits that come of it."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.diagnosis.compiling import CompiledFit, bearing, compiled_fit
from sgms_mhe.diagnosis.groups import Extra, Group
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import effect_definition
from sgms_mhe.recordings.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
FitKey = tuple[object, ...]

ALIKE: Final = 0.1
"""Standard deviation of a change of friction, over its own."""
SEARCH_STEP: Final = 10.0
"""What a step of a search must promise [rows' worth of noise]: less decides nothing."""
FINAL_STEP: Final = 0.01
"""What a step must promise where numbers are reported [rows' worth of noise]: a tenth of a standard deviation."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A model fitted to a recording.

    Attributes:
        model: its compiled code.
        extras: effects under test, with the numbers found.
        theta: (n_p).
        free: parameters that were fitted (n_p).
        loose: those of them that no bound holds (n_p): the directions that the data may still move.
        residual: measured minus model (m) [N].
        slopes: d(model)/d(theta) (m, n_p).
        loss: sum of squared residuals per block (blocks).
        cross: the same, each block predicted by a fit without its fold (blocks).
        rows: used rows per block (blocks).
    """

    model: CompiledFit
    extras: tuple[Extra, ...]
    theta: Array
    free: Mask
    loose: Mask
    residual: Array
    slopes: Array
    loss: Array
    cross: Array
    rows: Array

    @property
    def extra_groups(self) -> tuple[Group, ...]:
        """Groups of the effects under test."""
        return tuple(Group.extra(extra.name, i) for i, extra in enumerate(self.extras))

    @property
    def rms(self) -> float:
        """RMS of the residual on used rows [N]."""
        return math.sqrt(float(self.loss.sum() / self.rows.sum()))

    @property
    def cross_rms(self) -> float:
        """RMS by cross-validation [N]."""
        return math.sqrt(max(0.0, float(self.cross.sum() / self.rows.sum())))

    def theta_without(self, groups: Collection[Group]) -> Array:
        """The same numbers (n_p), the sizes of these effects set to none."""
        theta = self.theta.copy()
        for i, column in enumerate(self.model.columns):
            if column.group in groups and effect_definition(column.group.cause).parameter(column.name).is_size:
                theta[i] = column.theta(column.none)
        return theta

    def values(self, group: Group) -> dict[str, float]:
        """SI values of a group's parameters."""
        return {
            c.name: c.si(t) for c, t in zip(self.model.columns, self.theta.tolist(), strict=True) if c.group == group
        }


@dataclass(frozen=True, eq=False)
class Alignment:
    """What was taken out of a record that says nothing about friction; see `aligned`.

    Attributes:
        measured: friction before any of it was (m) [N].
        sampled: coefficients (2) of jerk and snap that the sampling accounts for.
        later: what the length of the model's steps takes from its friction (m) [N]; None: nobody has asked.
        at: that friction (m) [N].
    """

    measured: Array
    sampled: Array
    later: Array | None = None
    at: Array | None = None

    def later_at(self, friction: Array) -> Array | None:
        """What the length of the steps takes from a friction (m) [N]; None where it has to be asked for.

        It is a part in a thousand of it, and of one that differs by little the same.
        """
        if self.later is None or self.at is None:
            return None
        return self.later if float(np.std(friction - self.at)) < ALIKE * float(np.std(friction)) else None


@dataclass(frozen=True, eq=False)
class Subject:
    """An axis's model and the record that it is fitted to.

    Attributes:
        machine: the axis.
        recording: the record, its measured friction in line with the model.
        alignment: what brought it there.
        noise: of the measured friction [N]; weight of the prior.
        enough: what a step of a fit must promise [rows' worth of noise].
        starts: SI values of machine numbers that fits start from, where the file gives no good idea of them.
        fine: the same at the record's full rate, where this one is thinned.
        known: fits by what was asked for. A model is fitted once to an aligned record, wherever it would start;
            copies share them, an alignment begins anew.
    """

    machine: Machine
    recording: Recording
    alignment: Alignment
    noise: float = 1.0
    enough: float = 0.0
    starts: Mapping[str, float] = field(default_factory=dict)
    fine: Subject | None = None
    known: dict[FitKey, Fit] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, machine: Machine, recording: Recording) -> Subject:
        """A machine along a record as it was prepared."""
        alignment = Alignment(recording.friction, np.zeros(2))
        return cls(machine, recording, alignment, enough=SEARCH_STEP)

    @property
    def whole(self) -> Subject:
        """The one at the record's full rate."""
        return self if self.fine is None else self.fine

    def model(self, extras: Sequence[Extra]) -> CompiledFit:
        """The machine with effects added, everything in it a free parameter."""
        return compiled_fit(self.machine, extras)

    def suited(self, extras: Sequence[Extra]) -> Subject:
        """The one whose rate suits these effects: this one, or the full rate.

        States that elements which slip almost at once depend on need its steps too.
        """
        borne = bearing(self.machine, extras) is not self.machine
        known = [effect_definition(extra.name) for extra in extras]
        return self.whole if any(e.full_rate or (borne and e.drives_elements) for e in known) else self

    def starting_from(self, starts: Mapping[str, float]) -> Subject:
        """The same with other values that fits start from."""
        fine = None if self.fine is None else replace(self.fine, starts=starts, known={})
        return replace(self, starts=starts, fine=fine, known={})

    def settled(self) -> Subject:
        """The same with fits that go on until their numbers can be reported."""
        fine = None if self.fine is None else replace(self.fine, enough=FINAL_STEP)
        return replace(self, enough=FINAL_STEP, fine=fine)

    def start(self, model: CompiledFit, extras: Sequence[Extra], warm: Fit | None = None) -> Array:
        """Theta (n_p) to start from: the machine's, a warm fit's where it has them, the proposals' otherwise."""
        known: dict[tuple[Group, str], float] = {}
        if warm is not None:
            known = {
                (c.group, c.name): c.si(t)
                for c, t in zip(warm.model.columns, warm.theta, strict=True)
                if not c.group.is_extra
            }
        wanted = {
            (Group.extra(extra.name, i), key): value
            for i, extra in enumerate(extras)
            for key, value in extra.parameters.items()
        }
        values = {**known, **wanted}
        theta = np.array(
            [
                c.theta(values[c.group, c.name])
                if (c.group, c.name) in values
                else c.theta(self.starts[c.name])
                if c.name in self.starts
                else c.machine_theta
                for c in model.columns
            ]
        )
        return np.asarray(np.clip(theta, [c.lower for c in model.columns], [c.upper for c in model.columns]))

    def friction(self, fit: Fit) -> Array:
        """Friction (m) [N] of this machine at this rate, with the numbers of a fit."""
        values = {(c.group, c.name): c.si(t) for c, t in zip(fit.model.columns, fit.theta, strict=True)}
        model = self.model(fit.extras)
        theta = np.array([c.theta(values[c.group, c.name]) for c in model.columns])
        return model.run(self.recording, theta, derivatives=False)[0]
