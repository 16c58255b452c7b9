"""`sgms-mhe bench-diagnosis`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

import click

from sgms_mhe.commands.common import (
    check_output_folder,
    example,
    json_option,
    json_text,
    machine_argument,
    out_option,
    progress_bar,
    show,
)

LARGEST: Final = 0.8
"""Size of a hidden cause, over the Coulomb level."""


def _sizes(_context: click.Context, _option: click.Parameter, value: str | None) -> tuple[float, ...]:
    """Sizes from a list with commas."""
    try:
        sizes = tuple(float(word) for word in (value or "").split(",") if word.strip())
    except ValueError:
        sizes = (math.nan,)
    if value is not None and not (sizes and all(0.0 < size <= LARGEST for size in sizes)):
        raise click.BadParameter(f"{value!r} is no list of numbers above 0 and up to {LARGEST:g}")
    return sizes


@click.command(epilog=example("bench-diagnosis etel_xy --out build/benchmark-diagnosis --draws 40"))
@machine_argument
@out_option("Folder of results; a run that it holds is continued.", metavar="DIR")
@click.option(
    "--draws", type=click.IntRange(1, 100_000), metavar="N", default=600, show_default=True, help="Logs to diagnose."
)
@click.option("--seed", type=click.IntRange(0), metavar="S", default=1, show_default=True, help="Of all draws.")
@click.option(
    "--jobs", type=click.IntRange(1, 256), metavar="J", default=2, show_default=True, help="Processes at a time."
)
@click.option("--planned", is_flag=True, help="Run the moves that tell two causes apart instead of draws.")
@click.option(
    "--sizes",
    metavar="X,...",
    callback=_sizes,
    help="Hide every cause alone in these sizes, peak force over f_C, instead of draws.",
)
@json_option
def command(
    machine: str,
    out: Path,
    draws: int,
    seed: int,
    jobs: int,
    planned: bool,
    sizes: tuple[float, ...],
    as_json: bool,
) -> None:
    """Hide effects in simulated logs of MACHINE, diagnose each, and count what is found, missed and invented.

    Hidden are single effects, wrong numbers, pairs of effects, forces that no effect can represent, and nothing; with
    two friction laws, several motions and noise levels. An interrupted run goes on when it is called again.

    With --planned: of every two causes that look alike one is hidden, the move that `plan --separate` writes is run,
    and the one name is asked for; both ways round, on both friction laws.

    With --sizes: each cause alone, in each of these sizes, on both friction laws: what share of N logs it is found in,
    and how often its numbers are inside their intervals.
    """
    from sgms_mhe.configuration import load_machine

    resolved = load_machine(machine)
    check_output_folder(out)

    from sgms_bench.diagnosis.planned import run_planned
    from sgms_bench.diagnosis.running import run_diagnosis_benchmark
    from sgms_bench.diagnosis.scoring import summary_json, summary_text
    from sgms_bench.diagnosis.small import run_small

    if planned:
        with progress_bar(f"planned moves on {resolved.name}") as progress:
            table = run_planned(resolved, out, jobs=jobs, progress=progress)
        show(json_text(table.as_dict()) if as_json else str(table))
        return
    if sizes:
        with progress_bar(f"causes of given size on {resolved.name}") as progress:
            tables = run_small(resolved, out, sizes, draws=draws, seed=seed, jobs=jobs, progress=progress)
        show(json_text([table.as_dict() for table in tables]) if as_json else "\n".join(map(str, tables)))
        return
    with progress_bar(f"diagnoses on {resolved.name}") as progress:
        summary = run_diagnosis_benchmark(resolved, out, draws=draws, seed=seed, jobs=jobs, progress=progress)
    show(json_text(summary_json(summary)) if as_json else summary_text(summary))
