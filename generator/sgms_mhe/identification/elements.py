"""Single friction elements along a motion, with derivatives, by the emitted C of an axis of elements alone.

The elements of an axis know nothing of one another: each obeys its own equation, given the velocity. With unit level

    y = sum_k L_k chi(D_k, beta, v_s),    L_k = nu_k f_C,    D_k = nu_k f_C / kappa_k

so that compiled elements of one level serve any number of them, and levels are linear. A load adds to the level and
not to the stiffness: the element breaks away later, and of its force the share of the level without the load counts.
"""

import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Final, Literal

import numpy as np

from sgms_mhe.configuration import make_machine
from sgms_mhe.host.compiled import CompiledModel
from sgms_mhe.identification.records import ElementMotion
from sgms_mhe.model.effects import effect_definition, effect_names
from sgms_mhe.model.effects.search import Columns
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.parallel import run_parallel

Law = Literal["sgms", "switching"]

RATIO_SCALE: Final = 1e-3
"""Nominal ratio of the Stribeck rise: what scales its parameter, no value of its own."""
COARSE: Final = 2.0
"""Factor between the Stribeck velocities that elements are compiled for: few serve all fits."""
DISTANCE: Final = 1e-9
SLOW_STEP: Final = 0.05
"""Longest step of smooth elements below the gate, in break-away distances: off by 4e-5 of a level at most."""
MOST_STEPS: Final = 100
"""Such steps in one sample, at most: more would be spent on what a row cannot tell from less."""
GATE: Final = 0.36
"""Speed over the Stribeck velocity from which the gate of the smooth law, with its usual smoothing, is saturated."""
RATE: Final = 1000.0
"""Break-away distance [m] and sample rate [Hz] that elements are compiled for."""
LOAD_RATIO: Final = 0.5
"""Level over load that a loaded element is compiled for."""
BANK: Final = 4
"""Elements that run side by side: lanes of a vector of 256 bits."""

_one_at_a_time = threading.Lock()


@dataclass(frozen=True)
class Stribeck:
    """Rise of the level towards low speed: s(v) = 1 + ratio exp(-(v / velocity)^2)."""

    ratio: float
    velocity: float


NO_RISE: Final = Stribeck(0.0, 1e-3)
"""Of an axis without one; the velocity [m/s], the machine file's default, still sets how soon smooth elements turn."""


@dataclass(frozen=True, eq=False)
class ElementRuns:
    """Elements of unit level along rows: chi (m, k), and its derivatives in log D, beta and log v_s (m, k, 3).

    No derivatives where they were not asked for (m, k, 0).
    """

    chi: Array
    jacobian: Array


def run_bank(
    motion: ElementMotion, law: Law, distances: Array, rise: Stribeck, *, jacobian: bool = True
) -> ElementRuns:
    """Elements that break away after `distances` (k) [m], relaxed at first, along a motion.

    At most BANK of them, in as many steps of a sample as the least asks for.
    They run in a unit of length in which the least is DISTANCE, and of time in which a sample is 1 / RATE: one compiled
    bank then serves all that have about the same Stribeck velocity in these. A bank that has just run is not run again.
    """
    unit = DISTANCE / float(distances.min()) * RATE / motion.rate
    code = _compile(law, _nominal(law, rise.velocity * unit), motion.load is not None)
    # Lanes that are left over run what the last one does.
    stiffness = distances.min() / np.pad(distances, (0, BANK - len(distances)), mode="edge")
    scales = np.array([p.nominal for p in code.model.parameters[BANK:]])
    theta = np.append(stiffness, np.array([rise.ratio, rise.velocity * unit]) / scales)

    def run() -> tuple[Array, Array | None]:
        w = np.zeros((len(motion.velocity), 5))
        w[:, 1] = motion.velocity * unit
        if motion.load is not None:
            w[:, 2] = motion.load / LOAD_RATIO
        n = len(w) // motion.steps
        chi, d = np.empty((n, BANK)), np.empty((n, BANK, 3)) if jacobian else None
        code.advance(w, theta, np.zeros(BANK), np.zeros((BANK, len(theta))), chi, d)
        if d is not None:
            # d/d(log D) = -theta d/d(theta); the others in their own units.
            d[..., 0] *= -stiffness
            d[..., 1:] *= np.array([1.0, rise.velocity * unit]) / scales
            d = d[:, : len(distances)]
        chi = chi[:, : len(distances)]
        if motion.load is not None:
            chi, d = _take_load_off(
                motion.pick_samples(motion.load), motion.pick_samples(motion.velocity), rise, chi, d
            )
        return motion.to_rows(chi), None if d is None else motion.to_rows(d.reshape(n, -1))

    # The unit says which distances these are: values alone are those of others at another speed as well.
    chi, d = motion.runs.get(code, motion.velocity, np.append(theta, unit), jacobian, run)
    return ElementRuns(chi, np.empty((*chi.shape, 0)) if d is None else d.reshape(*chi.shape, 3))


def _take_load_off(
    load: Array, velocity: Array, rise: Stribeck, chi: Array, slopes: Array | None
) -> tuple[Array, Array | None]:
    """Return of loaded elements' forces (n, k) and slopes (n, k, 3) the share of the level without the load (n)."""
    bell = np.exp(-((velocity / rise.velocity) ** 2))
    level = 1.0 + rise.ratio * bell
    share = level / (level + load)
    if slopes is not None:
        d_level = np.column_stack(
            (np.zeros_like(bell), bell, 2.0 * rise.ratio * bell * (velocity / rise.velocity) ** 2)
        )
        by_level = chi * (load / (level + load) ** 2)[:, None]
        slopes = share[:, None, None] * slopes + d_level[:, None] * by_level[..., None]
    return share[:, None] * chi, slopes


def run_elements(
    motions: Sequence[ElementMotion], law: Law, distances: Array, rise: Stribeck, *, jacobian: bool = True
) -> ElementRuns:
    """Elements of these distances (k) along all logs, their rows behind one another."""
    # Neighbours run side by side: they ask for about as many steps.
    order = np.argsort(distances, kind="stable").tolist()
    banks = [(i, order[k : k + BANK]) for i in range(len(motions)) for k in range(0, len(order), BANK)]
    tasks = [
        partial(run_bank, motions[i], law, distances[of] * motions[i].scale, rise, jacobian=jacobian) for i, of in banks
    ]
    ends = np.cumsum([0, *(motion.rows for motion in motions)])
    chi = np.empty((ends[-1], len(distances)))
    slopes = np.empty((*chi.shape, 3 if jacobian else 0))
    for (i, of), found in zip(banks, run_parallel(tasks), strict=True):
        rows, scale = slice(ends[i], ends[i + 1]), motions[i].scale
        chi[rows, of], slopes[rows, of] = scale * found.chi, scale * found.jacobian
    return ElementRuns(chi, slopes)


def least_distance(law: Law, rise: Stribeck, rate: float) -> float:
    """Smallest break-away distance [m] of which a sample at the speed of the gate takes no more than MOST_STEPS steps.

    A smaller one could not be told from it there, but would take for ever. Elements that switch take one step.
    """
    if law == "switching":
        return 0.0
    return GATE * rise.velocity / (rate * SLOW_STEP * MOST_STEPS)


def _nominal(law: Law, velocity: float) -> float:
    """Stribeck velocity an element is compiled for.

    Not below its own, or a smooth one would be taken for slipping freely too early. Elements that switch are exact
    whatever it is.
    """
    return 1.0 if law == "switching" else COARSE ** math.ceil(math.log(velocity, COARSE))


def _compile(law: Law, velocity: float, loaded: bool) -> CompiledModel:
    """Return the cached value of `_compile_once`, for one thread at a time."""
    with _one_at_a_time:
        return _compile_once(law, velocity, loaded)


def _load_entry() -> dict[str, float | str]:
    """Return the entry of [[effects]] of the one whose level grows with the load, LOAD_RATIO times it."""
    for name in effect_names("rotary"):
        definition = effect_definition(name)
        if isinstance(definition.search, Columns) and definition.search.rise:
            return {"name": name, **definition.search.parameters({}, np.array([LOAD_RATIO]))}
    raise AssertionError("no effect of the level grows with a load")


@lru_cache(maxsize=64)
def _compile_once(law: Law, velocity: float, loaded: bool) -> CompiledModel:
    """The emitted model of an axis with elements of one level, 1 in all, and nothing else.

    One that is loaded carries its own inertia of 1 alone, so that the acceleration is the load.
    """
    content = {
        "name": "elements",
        "plant": {"kind": "rotary", "inertia": 1.0} if loaded else {"mass": 1.0},
        "effects": [_load_entry()] if loaded else [],
        "friction": {
            "law": law,
            "stiffness": [1.0 / (BANK * DISTANCE)] * BANK,
            "fraction": [1.0 / BANK] * BANK,
            "coulomb": 1.0,
            "stribeck_ratio": RATIO_SCALE,
            "stribeck_velocity": velocity,
        },
        "sampling": {
            "rate": RATE,
            "update_rate": RATE,
            "velocity_cutoff": 0.2 * RATE,
            "integrator": {"scheme": "flow", "slow_displacement": SLOW_STEP} if law == "sgms" else {},
        },
        "estimator": {"parameters": ["stiffness", "stribeck_ratio", "stribeck_velocity"]},
    }
    return CompiledModel(make_machine(content, Path("elements.toml")), states=True)
