"""Figures of a benchmark: work against precision, cost against the size of the problem."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

from sgms_bench.benchmark.results import Benchmark, BenchVariant, Peer, Sweep

WIDTH_IN = 9.0
# Apart for the colour-blind, and by marker in print without colour.
STYLES: Final = {
    "flow": ("#0b5394", "o"),
    "rk4": ("#d95f02", "s"),
    "clip": ("tab:brown", "P"),
    "CasADi": ("black", "x"),
}
SWEPT: Final = {"horizon": "horizon N", "elements": "elements n_z"}


def benchmark_figures(benchmark: Benchmark, machine: str) -> dict[str, Figure]:
    """Figures by name: `work_precision`, and `cost` where sizes were swept."""
    figures = {"work_precision": work_precision_figure(benchmark, machine)}
    if benchmark.sweeps:
        figures["cost"] = cost_figure(benchmark.sweeps, machine)
    return figures


def work_precision_figure(benchmark: Benchmark, machine: str) -> Figure:
    """Error of the end state and of its sensitivities over the work of an update; peers without their solution."""
    entries: list[tuple[str, str, BenchVariant | Peer]] = []
    for variant in benchmark.integrators or benchmark.variants:
        scheme = variant.integrator.split()[0]
        entries.append((scheme, scheme if variant.precision == "double" else f"{scheme}, {variant.precision}", variant))
    entries += [("CasADi", "CasADi's export, rk4, no solution", peer) for peer in benchmark.peers]
    counted = all(entry.instructions_mean is not None for _, _, entry in entries)
    figure = Figure(figsize=(WIDTH_IN, 4.2), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    labelled: dict[str, Any] = {}
    for axis, error, title in zip(
        axes, ("state_error", "sensitivity_error"), ("end state", "sensitivities"), strict=True
    ):
        for key, label, entry in entries:
            precision = getattr(entry, error)
            if precision is None:
                continue
            colour, marker = STYLES[key]
            hollow = "single" in label
            (labelled[label],) = axis.loglog(
                precision,
                entry.instructions_mean if counted else entry.update_us,
                marker,
                color=colour,
                markerfacecolor="none" if hollow else colour,
                linestyle="none",
            )
            if isinstance(entry, Peer):
                words = entry.name.removeprefix("CasADi ").replace(", rk4", "")
                work = entry.instructions_mean if counted else entry.update_us
                axis.annotate(
                    words, (precision, work), (-6, 0), textcoords="offset points", ha="right", fontsize="x-small"
                )
        axis.set_xlabel(f"largest error of the {title} [scaled units]")
        axis.grid(which="major", color="0.9")
    axes[0].set_ylabel("instructions per update" if counted else "time per update [us]")
    figure.suptitle(f"{machine}, motion {benchmark.variants[0].trajectory}: work against precision")
    figure.legend(
        labelled.values(),
        labelled.keys(),
        loc="outside lower center",
        ncols=len(labelled),
        frameon=False,
        fontsize="small",
    )
    return figure


def cost_figure(sweeps: Sequence[Sweep], machine: str) -> Figure:
    """Cost of an update over horizon and elements, with the fitted powers."""
    names = [name for name in SWEPT if any(sweep.over == name for sweep in sweeps)]
    figure = Figure(figsize=(WIDTH_IN, 4.2), layout="constrained")
    axes = figure.subplots(1, len(names), squeeze=False)[0]
    for axis, name in zip(axes, names, strict=True):
        for sweep, colour, marker in zip(
            [sweep for sweep in sweeps if sweep.over == name], ("#0b5394", "#d95f02"), ("o", "s"), strict=False
        ):
            size = np.array([point.size for point in sweep.points], dtype=float)
            is_counted = sweep.unit == "instructions"
            cost = np.array([p.instructions_mean if is_counted else p.update_us for p in sweep.points], dtype=float)
            axis.loglog(size, cost, marker, color=colour, label=f"{sweep.precision}, fit ~ size^{sweep.exponent:.2f}")
            level = np.exp(np.mean(np.log(cost) - sweep.exponent * np.log(size)))
            axis.loglog(size, level * size**sweep.exponent, color=colour, linewidth=0.8)
        axis.set_xlabel(SWEPT[name])
        axis.set_xticks(size, [f"{s:g}" for s in size])
        axis.minorticks_off()
        axis.set_ylabel("instructions per update" if sweep.unit == "instructions" else "time per update [us]")
        axis.grid(which="major", color="0.9")
        axis.legend(frameon=False)
    figure.suptitle(f"{machine}: cost of an update against the size of the problem")
    return figure
