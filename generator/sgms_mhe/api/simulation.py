"""A simulated axis and the log it leaves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

from sgms_mhe.api.inputs import load
from sgms_mhe.machine import Machine, estimable_names
from sgms_mhe.model.effects import Value
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import SimulatedRun, simulate_axis
from sgms_mhe.plant.trajectories import Trajectory, make_trajectory
from sgms_mhe.plant.trajectory_files import read_trajectory
from sgms_mhe.support.notebooks import read_only
from sgms_mhe.support.options import Option


def simulate(
    machine: str | Path | Machine,
    trajectory: Annotated[str | Path | Trajectory, Option("NAME|FILE")] = "paper",
    *,
    duration_s: Annotated[float | None, Option(least=1e-3, most=86400.0)] = None,
    scale: Annotated[Mapping[str, float] | None, Option("NAME=FACTOR", most=1e6)] = None,
    hidden_effects: Sequence[tuple[str, Mapping[str, Value]]] = (),
    law: Annotated[Literal["sgms", "maxwell_slip"] | None, Option()] = None,
    force_noise_N: Annotated[float, Option(least=0.0, most=1e6)] = 0.1,
    encoder_resolution_m: Annotated[float, Option(least=0.0, most=1.0)] = 1e-9,
    seed: Annotated[int, Option("N", 0)] = 0,
    truth: bool = False,
) -> SimulatedRun:
    """Move a simulated axis in closed position loop and log position and drive force.

    The plant is integrated apart from the model that estimators are generated from.

    Args:
        machine: file, name, or loaded.
        trajectory: reference motion by name, or a CSV file of one, whose name has a suffix, as `plan` writes it.
        duration_s: repeat or cut the motion to this long [s]; None: once.
        scale: true over nominal value by parameter: mass (of a rotary axis inertia), stiffness, stiffness_1, coulomb,
            effect.parameter, ... As often as needed.
        hidden_effects: (name, parameters) of effects the plant has and the machine does not know; `effects()` has
            them.
        law: friction law of the plant; maxwell_slip switches; None: the machine's.
        force_noise_N: one standard deviation of the logged force [N, N m].
        encoder_resolution_m: step of the encoder [m, rad]; 0: none.
        seed: seed of the noise: the same seed, the same log.
        truth: keep the quantities seen by no sensor.

    Returns:
        The log, one row per sample, and the truth where it was asked for.

    Raises:
        InputError: a name, a file or a number that does not fit; an axis its controller cannot hold.
    """
    axis = load(machine)
    sampling = axis.sampling
    if isinstance(trajectory, Trajectory):
        reference = trajectory
    elif Path(trajectory).suffix:
        reference = read_trajectory(trajectory, axis, duration_s=duration_s)
    else:
        reference = make_trajectory(
            str(trajectory), sampling.rate, duration_s=duration_s, max_velocity=sampling.max_velocity
        )
    names = {axis.plant.units.named(name): name for name in ("mass", *estimable_names(axis.effects))}
    config = AxisConfig(law=law, force_noise_N=force_noise_N, encoder_resolution_m=encoder_resolution_m, seed=seed)
    scales = {names.get(name, name): factor for name, factor in (scale or {}).items()}
    run = simulate_axis(axis, reference, config, scale=scales, hidden_effects=hidden_effects, truth=truth)
    return read_only(run)
