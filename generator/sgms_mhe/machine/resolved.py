"""The machine a file describes, with nothing left open, for all later stages."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sgms_mhe.machine.axis import BASE_PARAMETERS, Friction, Plant
from sgms_mhe.machine.code import Code, Compensation
from sgms_mhe.machine.diagnosis import DiagnosisTable
from sgms_mhe.machine.drive import Drive
from sgms_mhe.machine.estimator import Disturbance, Estimator
from sgms_mhe.machine.log_mapping import LogMapping
from sgms_mhe.machine.sampling import Sampling
from sgms_mhe.machine.units import Units
from sgms_mhe.support.notebooks import Presentation, Shown


@dataclass(frozen=True)
class ResolvedEffect:
    """One effect of a machine.

    Attributes:
        name: of the effect.
        label: unique within the machine: the name; of the second effect of that name, `name_2`.
        parameters: value of every parameter, or its values where it is a list, in the catalogue's order and by the
            catalogue's names, those of a linear axis; in SI units.
    """

    name: str
    label: str
    parameters: Mapping[str, float | tuple[float, ...]]

    def entry(self, units: Units) -> dict[str, Any]:
        """The effect as [[effects]] of a file has it, keys in the units of its axis."""
        return {"name": self.name, **units.keyed(self.parameters)}


def estimable_names(effects: Sequence[ResolvedEffect]) -> tuple[str, ...]:
    """Names that [estimator] parameters, prior and bounds may use, on an axis with these effects."""
    return BASE_PARAMETERS + tuple(f"{effect.label}.{key}" for effect in effects for key in effect.parameters)


@dataclass(frozen=True, repr=False)
class Machine(Shown):
    """A machine file, resolved and checked; made by `sgms_mhe.configuration` alone.

    Attributes:
        name, description, plant, friction, sampling, drive, compensation, code, effects, diagnosis, log: keys and
            tables of the file.
        source: the file this machine was read from.
        estimator: its parameters have the catalogue's names, those of a linear axis, as `effects` has.
        content: of the file, `extends` merged, defaults not filled in, in the names of this kind of axis.
    """

    name: str
    description: str
    plant: Plant
    friction: Friction
    sampling: Sampling
    drive: Drive
    estimator: Estimator
    compensation: Compensation
    code: Code
    effects: tuple[ResolvedEffect, ...]
    diagnosis: DiagnosisTable
    log: LogMapping | None
    source: Path
    content: Mapping[str, Any]

    def _shown(self) -> Presentation:
        return f"{self.name}: {self.plant.kind}, {self.friction.n_z} friction elements, from {self.source}", (), ()

    @property
    def digest(self) -> str:
        """SHA-256 (hex) of the resolved content: the same wherever the file lies and however it is written.

        `[diagnosis]` is left out: it stands in every emitted file, and changes none.
        """
        emitted = {key: value for key, value in self.as_dict().items() if key != "diagnosis"}
        content = json.dumps(emitted, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(content.encode()).hexdigest()

    def as_dict(self, *, by_alias: bool = False) -> dict[str, Any]:
        """The resolved content as plain data; `by_alias`: keys as a machine file spells them (`lambda`)."""
        units = self.plant.units
        tables = ("plant", "friction", "sampling", "estimator", "compensation", "code", "diagnosis")
        content = {key: getattr(self, key).model_dump(mode="json", by_alias=by_alias) for key in tables}
        content["plant"] = {key: value for key, value in content["plant"].items() if value is not None}
        estimator = content["estimator"]
        estimator["parameters"] = [units.named(name) for name in estimator["parameters"]]
        estimator |= {key: units.keyed(estimator[key]) for key in ("prior", "bounds")}
        if self.estimator.disturbance == Disturbance():
            del estimator["disturbance"]
        if not self.code.accuracy:
            del content["code"]["accuracy"]
        return {
            "name": self.name,
            "description": self.description,
            **content,
            **({} if self.drive == Drive() else {"drive": self.drive.model_dump(exclude_none=True)}),
            "effects": [effect.entry(units) for effect in self.effects],
            "log": None if self.log is None else self.log.model_dump(mode="json", by_alias=by_alias),
        }
