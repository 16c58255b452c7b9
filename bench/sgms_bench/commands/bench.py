"""`sgms-mhe bench`."""

from __future__ import annotations

import shlex
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from sgms_bench.commands.common import split_flags
from sgms_mhe.commands.common import check_output_folder, json_text, make_folder, progress_bar, show
from sgms_mhe.commands.options import make_command
from sgms_mhe.support.options import Option

if TYPE_CHECKING:
    from sgms_bench.benchmark.results import Benchmark, BenchVariant, Peer
    from sgms_mhe.machine import Machine

UPDATES = 500
"""The paper's motion with all that costs: its first second, a standstill and a crawl, costs half."""


@make_command("bench etel_xy --quick", "bench etel_xy --out build/benchmark", "bench etel_xy --json")
def command(
    machine: Machine,
    *,
    trajectory: Annotated[str, Option("NAME")] = "paper",
    updates: Annotated[int, Option("N", 1, 100_000)] = UPDATES,
    cflags: Annotated[str | None, Option("FLAGS")] = None,
    quick: bool = False,
    out: Annotated[Path | None, Option("DIR")] = None,
    json: bool = False,
) -> None:
    """Measure time, instructions and errors of an update, beside a peer.

    The update is that of MACHINE's estimator on this host; the peer is the same problem exported by CasADi.

    Time and instructions (valgrind; null without it) of a variant are those of all the work between two updates: the
    samples, feedback, prepare; instructions_plain are those of -O2 alone. feedback_us is the time from the newest
    sample to the estimate. Those of a peer are residual and Jacobian of one window alone. state_error and
    sensitivity_error are the largest errors of one interval's integration, in scaled units, against a converged one.

    Args:
        trajectory: simulated motion to replay.
        updates: number of updates to time.
        cflags: compiler flags; None: -std=c99 -O3 -ffp-contract=off -DSGMS_VECTORS=1.
        quick: a minute: the machine as it is written, and the peers, on one motion.
        out: folder for the figures, as PNG and SVG, and the numbers, as JSON.
    """
    flags = split_flags(cflags)
    if out is not None:
        check_output_folder(out)

    from sgms_bench.benchmark.running import run_benchmark
    from sgms_mhe.support.toolchain import DEFAULT_FLAGS

    flags = DEFAULT_FLAGS if flags is None else flags
    with progress_bar(f"bench {machine.name}") as progress:
        benchmark = run_benchmark(
            machine, trajectory=trajectory, updates=updates, quick=quick, flags=flags, progress=progress
        )
    content = json_text(asdict(benchmark))
    if out is not None:
        from sgms_bench.benchmark.figures import benchmark_figures
        from sgms_mhe.evaluation.plots import save_figure
        from sgms_mhe.support.files import write_text

        make_folder(out)
        write_text(out / "benchmark.json", content + "\n")
        for name, figure in benchmark_figures(benchmark, machine.name).items():
            for suffix in (".png", ".svg"):
                save_figure(out / f"{name}{suffix}", figure)
    show(content if json else _text(benchmark, machine.name, shlex.join(flags)))


def _text(benchmark: Benchmark, machine: str, flags: str) -> str:
    from sgms_mhe.support.tables import CsvTable

    rows = [_row(variant, benchmark.peer) for variant in benchmark.variants]
    rows += [_row(peer, benchmark.peer) for peer in benchmark.peers]
    trajectory = benchmark.variants[0].trajectory
    tables = [
        CsvTable(
            f"{machine}, motion {trajectory}, compiled with {flags}",
            COLUMNS,
            rows,
            ()
            if benchmark.peer is None
            else (
                "a variant: the whole update; a peer: residual and Jacobian of one window, nothing else",
                f"time ratio, instr ratio: those of {benchmark.peer.name} over the row's",
            ),
        )
    ]
    if benchmark.motions:
        rows = [{"motion": entry.trajectory} | _row(entry, None) for entry in benchmark.motions]
        columns = {"motion": ""} | {name: form for name, form in COLUMNS.items() if "ratio" not in name}
        tables.append(CsvTable("other motions", columns, rows))
    if benchmark.integrators:
        rows = [_row(variant, benchmark.peer) for variant in benchmark.integrators]
        tables.append(
            CsvTable(f"other integrators, {benchmark.integrators[0].precision}, motion {trajectory}", COLUMNS, rows)
        )
    for sweep in benchmark.sweeps:
        rows = [
            {sweep.over: point.size, "update us": point.update_us, "instructions": point.instructions_mean}
            for point in sweep.points
        ]
        note = (
            f"{sweep.unit} ~ {sweep.over}^{sweep.exponent:.2f} from {sweep.points[0].size} to {sweep.points[-1].size}; "
            f"without the constant part ^{sweep.marginal_exponent:.2f}"
        )
        columns = {sweep.over: "d", "update us": ".1f", "instructions": ".0f"}
        tables.append(CsvTable(f"cost over {sweep.over}, {sweep.precision}", columns, rows, (note,)))
    return "\n\n".join(map(str, tables))


COLUMNS = {
    "": "",
    "integrator": "",
    "update us": ".1f",
    "feedback us": ".2f",
    "instructions": ".0f",
    "at most": "d",
    "at -O2": ".0f",
    "state error": ".1e",
    "sensitivity error": ".1e",
    "time ratio": ".1f",
    "instr ratio": ".1f",
}


def _row(entry: BenchVariant | Peer, peer: Peer | None) -> dict[str, Any]:
    """Cells of a variant or a peer, and how many times as much `peer` takes."""
    row = {
        "": entry.name,
        "update us": entry.update_us,
        "instructions": entry.instructions_mean,
        "state error": entry.state_error,
        "sensitivity error": entry.sensitivity_error,
        # What a peer has not: it is no estimator.
        "integrator": getattr(entry, "integrator", None),
        "feedback us": getattr(entry, "feedback_us", None),
        "at most": getattr(entry, "instructions_max", None),
        "at -O2": getattr(entry, "instructions_plain", None),
    }
    if peer is not None:
        row["time ratio"] = peer.update_us / entry.update_us
        if peer.instructions_mean is not None and entry.instructions_mean is not None:
            row["instr ratio"] = peer.instructions_mean / entry.instructions_mean
    return row
