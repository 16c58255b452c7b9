"""`sgms-mhe estimate`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from sgms_mhe.commands import common
from sgms_mhe.commands.options import make_command
from sgms_mhe.support.libraries import optional_library
from sgms_mhe.support.options import Option

if TYPE_CHECKING:
    from sgms_mhe.machine import Machine
    from sgms_mhe.signals.estimates import Estimates

PRIOR_FITS: Final = 3.0
"""Deviations of its prior from the machine file within which a parameter is where that expects it."""


@make_command(
    "estimate etel_xy axis.csv --out estimates.csv",
    "estimate machines/emps.toml DATA_EMPS.mat --out estimates.csv --plot figures",
    of="estimation.estimate",
)
def command(
    machine: Machine,
    log: Path,
    *,
    out: Path,
    solver: Any,
    plot: Annotated[Path | None, Option("DIR")] = None,
    json: bool = False,
) -> None:
    """Estimate friction and parameters from a log.

    The generated C takes position and force through its own signal chain; a log that brings velocity_m_s,
    acceleration_m_s2 or friction_N goes through the Python one, which uses those columns.

    Args:
        out: CSV to write: one row per update.
        plot: also draw friction.png and parameters.png.
    """
    common.check_output_file(out)
    if plot is not None:
        common.check_output_folder(plot)
        optional_library("matplotlib", "plot", "a figure", "--plot")

    from sgms_mhe.api import estimation
    from sgms_mhe.signals.estimates import write_estimates

    with common.progress_bar(f"estimate {machine.name}") as progress:
        estimates = estimation.estimate(machine, log, solver=solver, progress=progress, note=common.note)
    write_estimates(out, estimates)
    if plot is not None:
        _draw(machine, estimates, plot)
    note_wrong_noise(machine, estimates)
    note_wrong_priors(machine, estimates)
    note_doubt(estimates)
    summary = summarise(machine, estimates, solver)
    common.show(common.json_text(machine.plant.units.keyed(summary)) if json else summary_text(machine, summary), out)


def note_wrong_noise(machine: Machine, estimates: Estimates) -> None:
    """Say where the innovations contradict the noise the machine file states."""
    from sgms_mhe.signals.innovations import NOISE_FITS, stated_noise

    share, unit = stated_noise(estimates), machine.plant.units.force
    least, most = NOISE_FITS
    if least <= share <= most or math.isnan(share):
        return
    stated = machine.estimator.noise.measurement
    common.note(
        f"the file states noise of {stated:g} {unit} (estimator.noise.measurement); the readings speak for "
        f"{share * stated:.2g} {unit}: sgms-mhe tune finds weights that suit a log"
    )


def note_wrong_priors(machine: Machine, estimates: Estimates) -> None:
    """Say which parameters end farther from the machine file than the prior that it states of them allows."""
    from sgms_mhe.model import build_model
    from sgms_mhe.support.numbers import interval

    model, units = build_model(machine), machine.plant.units
    for parameter, prior in zip(model.parameters, model.prior, strict=True):
        column = estimates.parameter_names.index(parameter.column)
        value, std = estimates.parameters[-1, column], estimates.std[-1, column]
        stated = prior * abs(parameter.scale)
        off = abs(value - parameter.nominal) / stated
        if off > PRIOR_FITS:
            common.note(
                f"{units.named(parameter.column)} ends at {interval(value, std)}, {off:.1f} deviations of its prior "
                f"({stated:.3g}) from the file's {parameter.nominal:.4g}: the file is off, or the prior too narrow "
                f"(estimator.prior, estimator.noise.parameter)"
            )


def note_doubt(estimates: Estimates) -> None:
    """Say that the measurements contradict the model, and the remedy."""
    from sgms_mhe.signals.status import MOST_DOUBT, measure_doubt

    share = measure_doubt(estimates.status)
    if share > MOST_DOUBT:
        common.note(
            f"in DOUBT of {100.0 * share:.0f} % of the updates: measurements contradict the model, beyond what it is "
            "known for; sgms-mhe diagnose looks for what it lacks"
        )


def summarise(machine: Machine, estimates: Estimates, solver: str) -> dict[str, Any]:
    """Return the content of --json: residual over the updates with a measurement, final parameters, status counts."""
    from sgms_mhe.evaluation.watching import RunSummary
    from sgms_mhe.model import build_model

    run = RunSummary(machine, build_model(machine))
    run.add(estimates)
    summary = run.summary()
    shown = ("updates", "measured", "start_s", "end_s", "residual_rms_N", "parameters", "status")
    return {"machine": machine.name, "solver": solver} | {key: summary[key] for key in shown}


def summary_text(machine: Machine, summary: dict[str, Any]) -> str:
    """The summary for people."""
    units = machine.plant.units
    counts = ", ".join(f"{count} {name}" for name, count in summary["status"].items() if count)
    return "\n".join(
        [
            f"{summary['machine']}, solver {summary['solver']}: {common.updates_text(units, summary)}",
            common.parameters_text(units, summary["parameters"]),
            f"updates: {counts}",
        ]
    )


def _draw(machine: Machine, estimates: Estimates, folder: Path) -> None:
    from sgms_mhe.evaluation.plots import friction_figure, parameter_figure
    from sgms_mhe.model import build_model

    figures = {
        "friction.png": friction_figure(estimates, machine.name),
        "parameters.png": parameter_figure(estimates, build_model(machine).parameters, machine.name),
    }
    common.save_figures(folder, figures)
