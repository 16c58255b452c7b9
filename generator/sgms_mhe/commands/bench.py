"""`sgms-mhe bench`."""

from __future__ import annotations

import shlex
from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from sgms_mhe.commands.common import example, json_option, json_text, machine_argument, progress_bar, show, table_text

if TYPE_CHECKING:
    from sgms_mhe.benchmark import Benchmark


@click.command(
    short_help="Time, instructions and errors of an update.",
    epilog=example("bench etel_xy", "bench etel_xy --trajectory mixed --json"),
)
@machine_argument
@click.option("--trajectory", metavar="NAME", default="paper", show_default=True, help="Simulated motion to replay.")
@click.option(
    "--updates", type=click.IntRange(1, 100_000), metavar="N", default=500, show_default=True, help="Updates to time."
)
@click.option("--cflags", metavar="FLAGS", help="Compiler flags; default -std=c99 -O3 -ffp-contract=off.")
@json_option
def command(machine: str, trajectory: str, updates: int, cflags: str | None, as_json: bool) -> None:
    """Measure what an update of MACHINE's estimator costs on this host, in double and single precision.

    Time and instructions (valgrind; null without it) are those of all the work between two updates: the samples,
    feedback, prepare. feedback_us is the time from the newest sample to the estimate. state_error and
    sensitivity_error are the largest errors of one interval's integration, in scaled units, against a converged one.
    """
    from sgms_mhe.machine import load_machine

    resolved = load_machine(machine)

    from sgms_mhe.benchmark import run_benchmark
    from sgms_mhe.build import DEFAULT_FLAGS

    flags = DEFAULT_FLAGS if cflags is None else shlex.split(cflags)
    with progress_bar(f"bench {resolved.name}") as progress:
        benchmark = run_benchmark(resolved, trajectory=trajectory, updates=updates, flags=flags, progress=progress)
    show(json_text(asdict(benchmark)) if as_json else _text(benchmark))


def _text(benchmark: Benchmark) -> str:
    rows = [
        (
            variant.name,
            f"{variant.update_us:.1f}",
            f"{variant.feedback_us:.2f}",
            _number(variant.instructions_mean, ".0f"),
            _number(variant.instructions_max, "d"),
            _number(variant.state_error, ".1e"),
            _number(variant.sensitivity_error, ".1e"),
        )
        for variant in benchmark.variants
    ]
    rows += [
        (peer.name, f"{peer.update_us:.1f}", "", _number(peer.instructions_mean, ".0f"), "", "", "")
        for peer in benchmark.peers
    ]
    header = ("variant", "update us", "feedback us", "instructions", "at most", "state error", "sensitivity error")
    return table_text(header, rows)


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
