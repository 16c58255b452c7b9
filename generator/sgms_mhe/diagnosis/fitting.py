"""Fits of a machine with effects added to a record, each once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.diagnosis.compiling import CompiledFit
from sgms_mhe.diagnosis.descent import FitError, LeastSquares, Prior, held_at_bounds
from sgms_mhe.diagnosis.groups import Column, Extra, Group
from sgms_mhe.diagnosis.subject import Fit, FitKey, Subject
from sgms_mhe.recordings.evidence import cross_loss

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ITERATIONS: Final = 12
"""Steps of a fit, at most [1]: it starts from a proposal, near its end."""
MACHINE_PRIOR: Final = 1.0
"""Prior of the machine's numbers, 1 sigma [nominal value]: holds what the record does not excite."""
EFFECT_PRIOR: Final = 10.0
"""Prior of an effect's numbers in a step, 1 sigma [nominal value]: it damps the step and says nothing of a size."""


def fit_model(
    subject: Subject,
    extras: Sequence[Extra],
    *,
    refitted: Sequence[Group] | None = None,
    warm: Fit | None = None,
    rows: Mask | None = None,
    held: frozenset[str] = frozenset(),
    iterations: int | None = None,
    again: bool = False,
) -> Fit:
    """Fit a machine with effects added to a record.

    Args:
        subject: the machine and the record.
        extras: effects under test and their starting values.
        refitted: groups of the machine's own numbers that are free; None: all.
        warm: a fit whose machine numbers to start from.
        rows: rows that the fit sees (m); None: all used ones.
        held: columns of the machine's own numbers that stay at its file's, whatever is refitted.
        iterations: at most; None: the usual ones.
        again: fit even what is known, from `warm`, and keep the better one.

    Raises:
        FitError: the model is not finite where its fit starts.
    """
    key: FitKey = (
        tuple((e.name, tuple(e.parameters.items())) for e in extras),
        None if refitted is None else frozenset(refitted),
        None if rows is None else rows.tobytes(),
        held,
    )
    known = subject.known.get(key)
    if known is None or again:
        wanted = _Wanted(refitted, rows, held, iterations or ITERATIONS)
        fit = _fit(subject, extras, warm, wanted)
        subject.known[key] = fit if known is None or fit.rms < known.rms else known
    return subject.known[key]


@dataclass(frozen=True, eq=False)
class _Wanted:
    """What a fit may move and see; as the arguments of `fit_model`."""

    refitted: Sequence[Group] | None
    rows: Mask | None
    held: frozenset[str]
    iterations: int

    def frees(self, column: Column) -> bool:
        """Whether a column is fitted."""
        if column.group.is_extra:
            return not column.frozen
        wanted = self.refitted is None or column.group in self.refitted
        return wanted and not column.frozen and column.name not in self.held


def _fit(subject: Subject, extras: Sequence[Extra], warm: Fit | None, wanted: _Wanted) -> Fit:
    """At the rate that suits the effects, and where a thinned model is not finite at the full one."""
    if subject.suited(extras) is subject:
        try:
            return _fit_here(subject, extras, warm, wanted)
        except FitError:
            if subject.fine is None:
                raise
    return fit_model(
        subject.whole,
        extras,
        refitted=wanted.refitted,
        warm=warm,
        rows=wanted.rows,
        held=wanted.held,
        iterations=wanted.iterations,
    )


def _fit_here(subject: Subject, extras: Sequence[Extra], warm: Fit | None, wanted: _Wanted) -> Fit:
    """At the subject's own rate."""
    recording, model = subject.recording, subject.model(extras)
    columns = model.columns
    theta = subject.start(model, extras, warm)
    free = np.array([wanted.frees(c) for c in columns], dtype=np.bool_)
    kept = ~free & np.array([not c.group.is_extra for c in columns], dtype=np.bool_)
    theta[kept] = [c.machine_theta for c, k in zip(columns, kept, strict=True) if k]
    seen = recording.used if wanted.rows is None else wanted.rows
    problem = LeastSquares(model, recording, seen, free, _prior(subject, model, free))
    found = problem.descend(theta, wanted.iterations, subject.enough)
    # A parameter that its bound holds moves neither with a candidate nor from fold to fold.
    loose = free & ~held_at_bounds(columns, found, seen, recording)
    return Fit(
        model=model,
        extras=tuple(
            Extra(
                e.name,
                {
                    c.name: c.si(t)
                    for c, t in zip(columns, found.theta, strict=True)
                    if c.group == Group.extra(e.name, i)
                },
            )
            for i, e in enumerate(extras)
        ),
        theta=found.theta,
        free=free,
        loose=loose,
        residual=found.residual,
        slopes=found.slopes,
        loss=recording.sum_blocks(found.residual**2),
        cross=cross_loss(recording, found.slopes[:, loose], found.residual, prior_information(subject, model, loose)),
        rows=recording.sum_blocks(np.ones(len(recording.time))),
    )


def prior_information(subject: Subject, model: CompiledFit, free: Mask) -> Array:
    """Information of the prior of the parameters `free` (n_p) in units of the sum of squares, (free)."""
    sd = np.array([EFFECT_PRIOR if c.group.is_extra else MACHINE_PRIOR for c in model.columns])
    return np.asarray((subject.noise / sd[free]) ** 2)


def _prior(subject: Subject, model: CompiledFit, free: Mask) -> Prior:
    information = prior_information(subject, model, free)
    own = np.array([not c.group.is_extra for c in model.columns])[free]
    centre = np.array(
        [c.theta(subject.starts[c.name]) if c.name in subject.starts else c.machine_theta for c in model.columns]
    )
    return Prior(information, np.where(own, information, 0.0), centre[free])
