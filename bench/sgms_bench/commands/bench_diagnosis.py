"""`sgms-mhe bench-diagnosis`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import click

from sgms_mhe.commands.common import check_output_folder, json_text, progress_bar, show
from sgms_mhe.commands.options import make_command
from sgms_mhe.support.options import Option

if TYPE_CHECKING:
    from sgms_mhe.machine import Machine

LARGEST: Final = 0.8
"""Size of a hidden cause, over the Coulomb level."""


def _read_sizes(text: str) -> tuple[float, ...]:
    """Sizes from a list with commas."""
    try:
        sizes = tuple(float(word) for word in text.split(",") if word.strip())
    except ValueError:
        sizes = ()
    if not (sizes and all(0.0 < size <= LARGEST for size in sizes)):
        allowed = f"{text!r} is no list of numbers above 0 and up to {LARGEST:g}"
        raise click.BadParameter(allowed, param_hint="'--sizes'")
    return sizes


@make_command("bench-diagnosis etel_xy --out build/benchmark-diagnosis --draws 40")
def command(
    machine: Machine,
    *,
    out: Annotated[Path, Option("DIR")],
    draws: Annotated[int, Option("N", 1, 100_000)] = 600,
    seed: Annotated[int, Option("S", 0)] = 1,
    jobs: Annotated[int, Option("J", 1, 256)] = 2,
    planned: bool = False,
    sizes: Annotated[str | None, Option("X,...")] = None,
    json: bool = False,
) -> None:
    """Diagnose simulated logs of MACHINE with hidden effects.

    Counts the causes that are found, missed and invented.

    Hidden are single effects, wrong numbers, pairs of effects, forces that no effect can represent, and nothing; with
    two friction laws, several motions and noise levels. An interrupted run goes on when it is called again.

    With --planned: of every two causes that look alike one is hidden, the move that `plan --separate` writes is run,
    and the one name is asked for; both ways round, on both friction laws.

    With --sizes: each cause alone, in each of these sizes, on both friction laws: what share of N logs it is found in,
    and how often its numbers are inside their intervals.

    Args:
        out: folder of results; a run that it holds is continued.
        draws: logs to diagnose.
        seed: seed of all draws.
        jobs: processes at a time.
        planned: run the moves that tell two causes apart instead of draws.
        sizes: hide every cause alone in these sizes, peak force over f_C, instead of draws.
    """
    wanted = () if sizes is None else _read_sizes(sizes)
    check_output_folder(out)

    from sgms_bench.diagnosis.planned import run_planned
    from sgms_bench.diagnosis.running import run_diagnosis_benchmark
    from sgms_bench.diagnosis.scoring import summary_json, summary_text
    from sgms_bench.diagnosis.small import run_small

    if planned:
        with progress_bar(f"planned moves on {machine.name}") as progress:
            table = run_planned(machine, out, jobs=jobs, progress=progress)
        show(json_text(table.as_dict()) if json else str(table))
        return
    if wanted:
        with progress_bar(f"causes of given size on {machine.name}") as progress:
            tables = run_small(machine, out, wanted, draws=draws, seed=seed, jobs=jobs, progress=progress)
        show(json_text([table.as_dict() for table in tables]) if json else "\n".join(map(str, tables)))
        return
    with progress_bar(f"diagnoses on {machine.name}") as progress:
        summary = run_diagnosis_benchmark(machine, out, draws=draws, seed=seed, jobs=jobs, progress=progress)
    show(json_text(summary_json(summary)) if json else summary_text(summary))
