"""Numbers each of several joined logs has of its own, beside those that they have in common."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from sgms_mhe.diagnosis.parametrisation import JacobianColumn, ParameterGroup
from sgms_mhe.machine import Units
from sgms_mhe.model.effects import EFFECT_NAMES, cause, effect_definition, reported_name
from sgms_mhe.recordings.recording import Recording
from sgms_mhe.support.arrays import Array, Mask
from sgms_mhe.support.statements import Rule, Statement


def is_of_record(name: str, recording: Recording) -> bool:
    """Return True if a cause belongs to a record more than to the axis; a mass does where each moves a payload."""
    moves_mass = name in EFFECT_NAMES and bool(effect_definition(name).adds_mass)
    return cause(name).of_record or (moves_mass and recording.has_payload)


@dataclass(frozen=True)
class OwnDifference:
    """A number that records of one axis do not agree on.

    Attributes:
        group: it belongs to.
        name: in SI results.
        values: of each record, the first one's first [SI].
    """

    group: ParameterGroup
    name: str
    values: tuple[float, ...]

    @property
    def reported_name(self) -> str:
        """Return its name in reports, as of a linear axis."""
        return reported_name(self.name) if self.group.kind == "base" else f"{self.group.name}.{self.name}"

    @property
    def estimated(self) -> dict[str, float]:
        """Return its name in a machine file's estimator, and its deviation before any data; of none without an effect.

        The largest distance from the first record's value: of the friction law over that, of an effect in its unit.
        """
        first = self.values[0]
        far = max(abs(value - first) for value in self.values)
        if self.group.kind == "own":
            return {f"{self.group.label}.{self.name}": far}
        return {self.name: far / first} if self.group.kind == "base" and first > 0.0 else {}

    def state(self, units: Units) -> Statement:
        """Return the statement on it."""
        values = " and ".join(f"{value:.4g}" for value in self.values)
        unit = units.unit(self.reported_name)
        return Statement(Rule.DIFFERING, units.named(self.reported_name), unit=unit, numbers={"values": values})


@dataclass(frozen=True, eq=False)
class OwnNumbers:
    """Numbers of each log: an offset, a stated payload; and, about the mean of all, the base model's of a record.

    Attributes:
        columns: derivatives of the friction in them (m, q).
        force: explained by them in a residual (m) [N].
    """

    columns: Array
    force: Array

    @classmethod
    def of(
        cls, recording: Recording, model: Sequence[JacobianColumn], jacobian: Array, residual: Array, seen: Mask
    ) -> Self | None:
        """Return those that leave least of a residual (m) [N] on the rows seen (m); None where there is one log.

        `jacobian` (m, n_p): of the model's friction. To first order about the mean of the logs.
        """
        if recording.of_log is None:
            return None
        own = [i for i, c in enumerate(model) if not c.group.is_candidate and is_of_record(c.group.cause, recording)]
        inside = recording.of_log[:, None] == np.arange(int(recording.of_log[-1]) + 1)
        apart = inside[:, 1:].astype(np.float64) - inside[:, :1]
        about = (jacobian[:, own, None] * apart[:, None, :]).reshape(len(residual), -1)
        columns = np.column_stack((inside, about))
        if recording.has_payload:
            columns = np.column_stack((columns, recording.acceleration[:, None] * inside))
        return cls(columns, columns @ np.linalg.lstsq(columns[seen], residual[seen], rcond=1e-9)[0])

    def project(self, series: Array, seen: Mask) -> Array:
        """Return columns (m, k) without the part explained by these numbers on the rows seen (m)."""
        return np.asarray(series - self.columns @ np.linalg.lstsq(self.columns[seen], series[seen], rcond=1e-9)[0])
