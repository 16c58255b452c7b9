"""Logs of simulated axes: effects hidden in them, other origins, temperatures and payloads."""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from cli_cases import SMALL
from sgms_mhe.configuration import load_machine, make_machine, override_machine
from sgms_mhe.machine import Machine
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import Trajectory, make_trajectory
from sgms_mhe.signals.logs import Log

Hidden = tuple[str, Mapping[str, float]]
RIPPLE: Hidden = ("force_ripple", {"amplitude_N": 1.2, "pitch_m": 0.0171, "phase_rad": 0.4})
ASYMMETRY: Hidden = ("asymmetric_coulomb", {"ratio": 0.2})


def slow_axis() -> Machine:
    """etel_xy where only every tenth sample is logged."""
    return override_machine(load_machine("etel_xy"), {"sampling": {"rate": 1000.0, "velocity_cutoff": 100.0}})


def simulate_log(
    machine: Machine,
    *hidden: tuple[str, Mapping[str, Any]],
    path: str | Trajectory = "mixed",
    seconds: float | None = None,
    fastest: float = 1.0,
    scale: Mapping[str, Any] | None = None,
    **config: Any,
) -> Log:
    """Log an axis along a motion, with effects in it that its file has not.

    Args:
        machine: the axis.
        hidden: effects with their parameters.
        path: a motion, or the name of one.
        seconds: that it lasts; None: a period.
        fastest: largest speed of a motion that is named [m/s].
        scale: of the axis's numbers.
        config: of the simulation.
    """
    if isinstance(path, str):
        path = make_trajectory(path, machine.sampling.rate, duration_s=seconds, max_velocity=fastest)
    return simulate_axis(machine, path, AxisConfig(**config), hidden_effects=hidden, scale=scale or {}, truth=False).log


def small_axis() -> Machine:
    return make_machine(tomllib.loads(SMALL), Path("small.toml"))


def record_axis(
    machine: Machine,
    seed: int,
    hidden: Sequence[Hidden] = (),
    *,
    scale: Mapping[str, float] | None = None,
    offset: float = 0.0,
    payload: float = 0.0,
    origin: float = 0.0,
    reach: float = 1.0,
) -> Log:
    """A record of an axis with effects in it, and what is its own.

    Args:
        machine: the axis.
        seed: of the noise, and the record's name.
        hidden: effects of the axis.
        scale: of its numbers in this record, as at another temperature.
        offset: of the force [N].
        payload: that it moves [kg].
        origin: that its position counts from [m].
        reach: strokes so many times as long and as fast.
    """
    own = (("constant_offset", "force_N", offset), ("mass_mismatch", "mass_kg", payload))
    effects = [*hidden, *((name, {parameter: size}) for name, parameter, size in own if size)]
    motion = make_trajectory("mixed", machine.sampling.rate, duration_s=6.0)
    motion = replace(motion, position_m=reach * motion.position_m)
    log = simulate_log(machine, *effects, path=motion, scale=scale, seed=seed)
    return replace(log, position_m=log.position_m - origin, source=f"record {seed}")
