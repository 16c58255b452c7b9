"""`sgms-mhe diagnose`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import click

from sgms_mhe.commands import common
from sgms_mhe.commands.options import make_command
from sgms_mhe.support.decisions import trace_decisions
from sgms_mhe.support.errors import ImplausibleError, InputError
from sgms_mhe.support.options import Option

if TYPE_CHECKING:
    from sgms_mhe.diagnosis.result import Diagnosis
    from sgms_mhe.machine import Machine
    from sgms_mhe.report import EstimatorGain
    from sgms_mhe.signals.logs import Log


@make_command(
    "diagnose etel_xy log.csv --out diagnosis", "diagnose etel_xy first.csv second.csv", of="diagnosis.diagnose"
)
def command(
    machine: Machine,
    log: tuple[Path, ...],
    *,
    out: Annotated[Path | None, Option("DIR")] = None,
    unseen: Annotated[Path | None, Option("LOG")] = None,
    start_s: Annotated[float, Option("S", 0.0, 1e8, "--from")] = 0.0,
    end_s: Annotated[float, Option("S", 0.0, 1e8, "--to")] = math.inf,
    held_out_s: Sequence[tuple[float, float]] | None = None,
    objective: Literal["force", "motion", "both"] = "force",
    standalone: bool = False,
    trace: Annotated[Path | None, Option("DIR")] = None,
    json: bool = False,
) -> bool:
    """Find errors of the simulation along LOG, and causes.

    With further LOGs of the same axis causes are sought in all, and numbers fitted to all: a cause transfers if it
    holds there too.

    Writes report.html, diagnosis.json and, where a cause is named, the extended machine file. The
    verdict is explained, adequate (nothing is missing), ambiguous (the record cannot distinguish causes; the report has
    the move that does) or unexplained (structure is left that no known effect accounts for; nothing is invented).

    Exit code 1: unexplained; so is a log whose force or position has another sign, scale or unit, which is said.

    Args:
        out: folder of the results; None: MACHINE's name and _diagnosis.
        unseen: another log, on which the estimators of the machine and of the extended machine are compared.
        start_s: use the first log from here on [s since its start] as a log of its own, whose time starts here.
        end_s: and until here [s].
    """
    common.note_broken_effects()
    folder = out or Path(f"{machine.name}_diagnosis")
    common.check_output_folder(folder)

    from sgms_mhe.api.inputs import read_log
    from sgms_mhe.diagnosis import diagnose, write_diagnosis
    from sgms_mhe.logfiles.plausibility import check_has_force, check_plausible
    from sgms_mhe.report import attempt_report, closed_loop_gain

    recorded = read_log(log[0], machine, start_s=start_s, end_s=end_s, note=common.note)
    check_has_force(recorded)
    try:
        check_plausible(recorded, machine)
    except ImplausibleError as error:
        _say_implausible(error, machine, recorded, folder, json)
        return True
    others = [common.recorded_log(other, machine) for other in log[1:]]
    another = common.recorded_log(unseen, machine) if unseen else None
    with trace_decisions(trace), common.steps_bar() as progress:
        found = diagnose(
            machine, recorded, others=others, progress=progress, held_out_s=held_out_s, objective=objective
        )
    found = replace(found, standalone=standalone)
    write_diagnosis(found, folder)
    gain, refused = None, None
    if another is not None and found.extended is not None:
        try:
            with common.step_notes() as progress:
                progress("estimators of the machine and of the extended machine on the unseen log")
                gain = closed_loop_gain(machine, found.extended, another)
        except InputError as error:  # said after the verdict, which does not hang on this log
            refused = error
    report = attempt_report(found, folder, partial(click.echo, err=True), estimator=gain)
    units = machine.plant.units
    if json:
        common.show(common.json_text(found.to_json() | ({} if gain is None else {"unseen": units.keyed(_gain(gain))})))
    else:
        common.show(_text(found, folder, report, gain))
    if refused is not None:
        raise refused
    return found.verdict == "unexplained"


def _say_implausible(error: ImplausibleError, machine: Machine, log: Log, folder: Path, as_json: bool) -> None:
    """The verdict on a log whose columns contradict their names: nothing is fitted to it."""
    from sgms_mhe.diagnosis import write_refusal
    from sgms_mhe.report import write_unread_page

    content = write_refusal(str(error), machine, folder)
    report = write_unread_page(folder / "report.html", str(error), log, {"file": log.source}, machine)
    common.show(common.json_text(content) if as_json else f"unexplained: {error}\nreport: {report}")


def _gain(gain: EstimatorGain) -> dict[str, object]:
    """Error of the friction that both estimators predict, and the share by which it falls, with the 95 % interval."""
    return {
        "log": gain.source,
        "predicted_rms_N": {"before": gain.base.predicted_rms_N, "after": gain.extended.predicted_rms_N},
        "reduction": gain.reduction,
        "reduction_interval": list(gain.reduction_interval),
    }


def _text(diagnosis: Diagnosis, folder: Path, report: Path | None, gain: EstimatorGain | None) -> str:
    lines = [f"{diagnosis.verdict}: {diagnosis.summary}", *(f"  {s.line}" for s in diagnosis.said[1:])]
    units = diagnosis.machine.plant.units
    if diagnosis.separating_experiment:
        lines.append(f"next: {diagnosis.separating_experiment}")
    if gain is not None:
        lines.append(gain.state(units.force).sentence)
    lines += [f"note: {warning}" for warning in diagnosis.warnings]
    if diagnosis.extended_name:
        lines.append(f"extended machine: {folder / diagnosis.extended_name}")
    if report is not None:
        lines.append(f"report: {report}")
    return "\n".join(lines)
