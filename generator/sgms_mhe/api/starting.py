"""A machine file to begin with, from the few numbers that somebody who sets up an axis knows."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Final

from sgms_mhe.configuration import make_machine
from sgms_mhe.identification.sampling import UPDATE_RATE
from sgms_mhe.machine import OF_KIND, Kind, Machine
from sgms_mhe.machine.writing import toml_line, toml_table
from sgms_mhe.support.options import Option

SPREAD: Final = (0.03, 0.1, 0.3, 1.0)
"""Break-away distances of the elements over that of the last one: a decade and a half, evenly in their logarithm."""
SHARES: Final = (0.1, 0.15, 0.25, 0.5)
"""Of the Coulomb level."""
NOISE: Final = 0.02
"""Of the Coulomb level: noise of the force, until `tune` says what it is."""
CUTOFFS: Final = (500.0, 0.1)
"""Cutoff of the velocity: so many Hz, or that share of the rate."""
COMMENT_COLUMN: Final = 52

_ASSUMED: Final = "assumed"


def start_text(
    path: Path,
    kind: Kind,
    mass: float,
    rate: float,
    *,
    coulomb: Annotated[float | None, Option("N", 1e-12, 1e9)] = None,
    viscous: Annotated[float | None, Option("N_S_M", 1e-12, 1e9)] = None,
    break_away: Annotated[float | None, Option("M", 1e-12, 1e9)] = None,
    max_velocity: Annotated[float, Option("M_S", 1e-12, 1e9)] = 1.0,
) -> tuple[str, Machine]:
    """The machine file, every number with its unit and where it comes from, and the machine it describes.

    An unknown number has a usual value and is marked as assumed: friction of 1 % of the weight (of an axis that turns,
    of a tenth of the inertia at 1 rad/s^2), a break-away distance of 50 um or 50 urad.

    Args:
        path: where the file will be; its stem is the machine's name.
        kind: whether it goes or turns.
        mass: moved mass [kg], of an axis that turns its inertia [kg m^2].
        rate: samples per second [Hz].
        coulomb: level of sliding friction [N, N m], if known.
        viscous: its rise with speed [N s/m, N m s/rad], if known.
        break_away: distance after a reversal until all slides [m, rad], if known.
        max_velocity: highest speed [m/s, rad/s], up to which the estimate is right.

    Raises:
        InputError: a number no machine file may have.
    """
    units = OF_KIND[kind]
    linear = kind == "linear"
    level = float(f"{mass * (0.0981 if linear else 0.1):.2g}") if coulomb is None else coulomb
    last = 5e-5 if break_away is None else break_away
    stiffness = [float(f"{share * level / (part * last):.3g}") for share, part in zip(SHARES, SPREAD, strict=True)]
    from_distance = f"of break-away distances up to {last:g} {units.position}"
    samples = max(1, round(rate / UPDATE_RATE))
    tables: list[tuple[str, Sequence[tuple[str, Any, str]]]] = [
        (
            "plant",
            [("kind", kind, "")] * (not linear)
            + [("mass" if linear else "inertia", mass, f"{units.mass}, all that moves")],
        ),
        (
            "friction",
            [
                ("coulomb", level, _said(coulomb, f"{units.force}, level of sliding")),
                ("viscous", level if viscous is None else viscous, _said(viscous, f"{units.damping}, rise with speed")),
                ("stiffness", stiffness, _said(break_away, f"{units.stiffness}, {from_distance}")),
                ("fraction", list(SHARES), f"of the level, one per stiffness; {_ASSUMED}"),
                ("stribeck_ratio", 0.0, f"rise towards standstill over the level; {_ASSUMED}"),
                ("stribeck_velocity", 1e-3, f"{units.velocity}, speed at which it is gone; {_ASSUMED}"),
            ],
        ),
        (
            "sampling",
            [
                ("rate", rate, "Hz, position and force samples"),
                ("update_rate", rate / samples, "Hz, estimator"),
                ("velocity_cutoff", min(CUTOFFS[0], CUTOFFS[1] * rate), "Hz, second-order low-pass"),
                ("max_velocity", max_velocity, f"{units.velocity}, the estimate is right up to here"),
                ("integrator", {"scheme": "flow"}, "constant work at any speed"),
            ],
        ),
        (
            "estimator",
            [
                ("kind", "mhe", "or ekf, which keeps no window"),
                ("horizon", 20, "shooting intervals, one per update"),
                ("relinearise", "auto", "intervals are linearised anew where it matters"),
                ("parameters", ["coulomb", "viscous"], "what changes: temperature, wear, grease"),
            ],
        ),
        (
            "estimator.noise",
            [("measurement", float(f"{NOISE * level:.2g}"), f"{units.force}, 1 sigma; {_ASSUMED}, tune measures it")],
        ),
        ("estimator.bounds", [("coulomb", [0.3, 3.0], "times nominal"), ("viscous", [0.1, 5.0], "times nominal")]),
    ]
    head = [
        f"# {path.stem}: a beginning. What is marked as assumed is no measurement:",
        "#   sgms-mhe identify LOG --out FILE   measures all of [friction] from a log,",
        "#   sgms-mhe check FILE                shows what this file resolves to,",
        "#   sgms-mhe schema                    lists every key.",
        toml_line("name", path.stem),
        toml_line("description", "a beginning"),
    ]
    lines = [line for name, entries in tables for line in _commented_table(name, entries)]
    text = "\n".join([*head, *lines]) + "\n"
    return text, make_machine(tomllib.loads(text), path)


def _said(stated: float | None, meaning: str) -> str:
    return meaning if stated is not None else f"{meaning}; {_ASSUMED}"


def _commented_table(name: str, entries: Sequence[tuple[str, Any, str]]) -> list[str]:
    values, notes = {key: value for key, value, _ in entries}, {key: note for key, _, note in entries}
    return toml_table(f"[{name}]", values, notes=notes, column=COMMENT_COLUMN)
