"""`sgms-mhe simulate`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

import click

from sgms_mhe.commands import common

if TYPE_CHECKING:
    from sgms_mhe.signals.logs import Log


LARGEST_SCALE: Final = 1e6
"""Of a true parameter over its nominal value, whatever its sign."""


def _scales(ctx: click.Context, param: click.Parameter, texts: tuple[str, ...]) -> dict[str, float]:
    """The option --scale: name and factor of each `name=factor`."""
    scales: dict[str, float] = {}
    for text in texts:
        name, _, number = text.partition("=")
        try:
            factor = float(number)
        except ValueError:
            factor = math.nan
        if not (name.strip() and abs(factor) <= LARGEST_SCALE):
            raise click.BadParameter(
                f"{text!r} is not NAME=FACTOR with a number up to {LARGEST_SCALE:g}, as in stiffness=1.2", ctx, param
            )
        scales[name.strip()] = scales.get(name.strip(), 1.0) * factor
    return scales


@click.command(
    short_help="Log a simulated axis in closed loop.",
    epilog=common.example(
        "simulate etel_xy --out axis.csv",
        "simulate etel_xy --out axis.npz --trajectory mixed --duration 60 --scale stiffness_1=1.2",
        "simulate etel_xy --out next.csv --trajectory plan.csv",
    ),
)
@common.machine_argument
@common.out_option("The log to write: .csv or .npz.")
@click.option(
    "--trajectory",
    metavar="NAME|FILE",
    default="paper",
    show_default=True,
    help="Reference motion by name, or a CSV file of one, as plan writes it.",
)
@click.option(
    "--duration",
    type=common.NumberType(1e-3, 86400.0),
    metavar="S",
    help="Repeat or cut the motion to this long; default once.",
)
@click.option("--seed", type=click.IntRange(0), metavar="N", default=0, show_default=True, help="Seed of the noise.")
@click.option(
    "--law",
    type=click.Choice(["sgms", "maxwell_slip"]),
    help="Friction law of the plant; maxwell_slip switches instead of smoothing; default: the machine file's.",
)
@click.option(
    "--force-noise",
    type=common.NumberType(0.0, 1e6),
    metavar="N",
    default=0.1,
    show_default=True,
    help="1 sigma [N, N m].",
)
@click.option(
    "--encoder-resolution",
    type=common.NumberType(0.0, 1.0),
    metavar="M",
    default=1e-9,
    show_default=True,
    help="Step [m, rad].",
)
@click.option(
    "--scale",
    "scales",
    metavar="NAME=FACTOR",
    callback=_scales,
    multiple=True,
    help="True over nominal value of a parameter: mass (of a rotary axis inertia), stiffness, stiffness_1, coulomb, "
    "effect.parameter, ... Repeatable.",
)
def command(
    machine: str,
    out: Path,
    trajectory: str,
    duration: float | None,
    seed: int,
    law: Literal["sgms", "maxwell_slip"] | None,
    force_noise: float,
    encoder_resolution: float,
    scales: dict[str, float],
) -> None:
    """Move a simulated axis in closed position loop and log position and drive force.

    The plant is integrated apart from the model that estimators are generated from.
    """
    from sgms_mhe.configuration import load_machine

    resolved = load_machine(machine)
    common.check_output_file(out, (".csv", ".npz"))

    from sgms_mhe.api import simulation
    from sgms_mhe.signals.logs import write_log

    with common.progress_bar(f"simulate {resolved.name}"):
        run = simulation.simulate(
            resolved,
            trajectory,
            duration_s=duration,
            scale=scales,
            law=law,
            force_noise_N=force_noise,
            encoder_resolution_m=encoder_resolution,
            seed=seed,
        )
    write_log(out, run.log)
    common.show(f"{out}: {describe(run.log)}", out)


def describe(log: Log) -> str:
    """One line about a log."""
    import numpy as np

    units = log.units
    position, force = log.position_m[np.isfinite(log.position_m)], log.force_N[np.isfinite(log.force_N)]
    return (
        f"{len(log)} samples at {log.rate:g} Hz ({len(log) / log.rate:g} s), "
        f"position {position.min():.6g} to {position.max():.6g} {units.position}, "
        f"{units.push} {force.min():.6g} to {force.max():.6g} {units.force}"
    )
