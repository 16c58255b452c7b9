"""Estimates of an observer of any kind at every update, and their file."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from sgms_mhe.machine import OF_KIND, Kind
from sgms_mhe.signals.logs import write_columns
from sgms_mhe.support.arrays import AnyArray, Array, Index
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.libraries import data_frame
from sgms_mhe.support.notebooks import Presentation, Shown, labelled_axes
from sgms_mhe.support.numbers import SIGMAS, interval

READING_COLUMNS: Final = ("innovation_N", "test_ratio", "noise_scale")
"""Of the newest measurement; files that were written without them read as NaN."""


@dataclass(frozen=True, repr=False)
class Estimates(Shown):
    """One row per update; u updates, n_z elements, n_p estimated parameters, all in SI units.

    time_s, friction_measured_N, friction_N (u,); z_m (u, n_z); parameters, std (u, n_p); status (u,) int; of the newest
    measurement innovation_N, test_ratio (its square over the variance predicted for it), noise_scale (u,), NaN where an
    observer does not predict measurements;
    parameter_names (n_p): `stiffness_1`, ..., `coulomb`. Of a rotary axis angles and torques stand where this says m
    and N; `kind` says which it is, and a file's columns are named so. `extra` holds other results of a solver
    (arrays by name); it is not written.
    """

    time_s: Array
    friction_measured_N: Array
    friction_N: Array
    z_m: Array
    parameters: Array
    std: Array
    status: Index
    innovation_N: Array
    test_ratio: Array
    noise_scale: Array
    parameter_names: tuple[str, ...]
    kind: Kind = "linear"
    extra: Mapping[str, AnyArray] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def columns(self) -> dict[str, AnyArray]:
        """Columns (u,) of the estimates' file, as this kind of axis names them."""
        names = self.parameter_names
        columns = {name: getattr(self, name) for name in ("time_s", "friction_measured_N", "friction_N")}
        columns |= {f"z_{i + 1}_m": z for i, z in enumerate(self.z_m.T)}
        columns |= dict(zip(names, self.parameters.T, strict=True))
        columns |= {f"std_{name}": std for name, std in zip(names, self.std.T, strict=True)}
        columns["status"] = self.status.astype(np.int64)
        columns |= {name: getattr(self, name) for name in READING_COLUMNS}
        return {OF_KIND[self.kind].named(name): values for name, values in columns.items()}

    def to_frame(self) -> Any:
        """A pandas.DataFrame with the columns of the estimates' file, a row per update."""
        return data_frame(self.columns)

    def plot(self, name: str | None = None, axes: Any | None = None) -> Any:
        """Draw friction measured and estimated, or a parameter with two standard deviations, over time.

        Args:
            name: of an estimated parameter; None: friction.
            axes: of matplotlib, to draw on; None: new ones.

        Returns:
            The axes.

        Raises:
            InputError: no parameter of this name is estimated; matplotlib is not installed.
        """
        units = OF_KIND[self.kind]
        if name is None:
            axes = labelled_axes(axes, "time [s]", units.balance)
            axes.plot(self.time_s, self.friction_measured_N, linewidth=0.6, color="0.6", label="measured")
            axes.plot(self.time_s, self.friction_N, linewidth=1.0, label="estimated")
        elif name in self.parameter_names:
            k = self.parameter_names.index(name)
            value, wide = self.parameters[:, k], SIGMAS * self.std[:, k]
            axes = labelled_axes(axes, "time [s]", name)
            axes.fill_between(self.time_s, value - wide, value + wide, alpha=0.25, label="two standard deviations")
            axes.plot(self.time_s, value, linewidth=1.0, label="estimated")
        else:
            raise InputError("plot", "name", name, f"a parameter that is estimated: {', '.join(self.parameter_names)}")
        axes.legend()
        return axes

    def _shown(self) -> Presentation:
        units = OF_KIND[self.kind]
        rows = [
            (name, interval(value, std))
            for name, value, std in zip(self.parameter_names, self.parameters[-1], self.std[-1], strict=True)
        ]
        title = f"{len(self)} updates; the last: friction {self.friction_N[-1]:.4g} {units.force}"
        return title, ("parameter", "value +- 2 sigma"), rows


def write_estimates(path: str | Path, estimates: Estimates) -> None:
    """Write the estimates' CSV atomically: time, friction, deflections, parameters, their std, status."""
    write_columns(path, estimates.columns)
