"""`sgms-mhe bench-diagnosis`."""

from __future__ import annotations

from pathlib import Path

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
@json_option
def command(machine: str, out: Path, draws: int, seed: int, jobs: int, planned: bool, as_json: bool) -> None:
    """Hide effects in simulated logs of MACHINE, diagnose each, and count what is found, missed and invented.

    Hidden are single effects, wrong numbers, pairs of effects, forces that no effect can represent, and nothing; with
    two friction laws, several motions and noise levels. An interrupted run goes on when it is called again.

    With --planned: of every two causes that look alike one is hidden, the move that `plan --separate` writes is run,
    and the one name is asked for; both ways round, on both friction laws.
    """
    from sgms_mhe.configuration import load_machine

    resolved = load_machine(machine)
    check_output_folder(out)

    from sgms_mhe.diagnosis_benchmark import run_diagnosis_benchmark, run_planned, summary_json, summary_text

    if planned:
        with progress_bar(f"planned moves on {resolved.name}") as progress:
            table = run_planned(resolved, out, jobs=jobs, progress=progress)
        show(json_text(table.as_dict()) if as_json else str(table))
        return
    with progress_bar(f"diagnoses on {resolved.name}") as progress:
        summary = run_diagnosis_benchmark(resolved, out, draws=draws, seed=seed, jobs=jobs, progress=progress)
    show(json_text(summary_json(summary)) if as_json else summary_text(summary))
