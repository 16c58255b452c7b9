"""Records of one small simulated axis: other origins, temperatures and payloads."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from cli_cases import SMALL
from sgms_mhe.configuration.resolution import make_machine
from sgms_mhe.machine import Machine
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import make_trajectory
from sgms_mhe.signals.logs import Log

Hidden = tuple[str, Mapping[str, float]]
RIPPLE: Hidden = ("force_ripple", {"amplitude_N": 1.2, "pitch_m": 0.0171, "phase_rad": 0.4})
ASYMMETRY: Hidden = ("asymmetric_coulomb", {"ratio": 0.2})


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
    run = simulate_axis(machine, motion, AxisConfig(seed=seed), hidden_effects=effects, scale=scale or {}, truth=False)
    return replace(run.log, position_m=run.log.position_m - origin, source=f"record {seed}")
