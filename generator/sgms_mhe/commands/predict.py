"""`sgms-mhe predict`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from sgms_mhe.commands import common
from sgms_mhe.commands.log_options import load_for_log, log_options
from sgms_mhe.support.errors import InputError

if TYPE_CHECKING:
    from sgms_mhe.diagnosis.other_record import Origin


@click.command(
    short_help="Run the model alone along a log.",
    epilog=common.example(
        "predict etel_xy axis.csv --out predicted.csv",
        "predict emps DATA_EMPS.mat --out predicted.csv --from 12.5 --lowpass 100 --decimate 10",
    ),
)
@common.machine_argument
@common.log_argument
@log_options
@common.out_option("CSV to write: time_s, friction_measured_N, friction_N (of a rotary axis _Nm) at every sample.")
@common.part_options("Compare from here on [s since the log's start]; the model runs through the whole log.")
@click.option(
    "--lowpass", type=common.NumberType(1e-3, 1e7), metavar="HZ", help="In place of the machine's velocity_cutoff."
)
@click.option(
    "--decimate",
    "factor",
    type=click.IntRange(1),
    metavar="N",
    default=1,
    show_default=True,
    help="Compare every N-th sample, behind an anti-aliasing filter.",
)
@click.option("--find-origin", is_flag=True, help="Find the position that forces over place count from, first.")
@click.option(
    "--within",
    type=common.NumberType(1e-9, 1e6),
    metavar="M",
    help="How far from 0 the origin may be [m, rad]; needed where forces over place do not repeat.",
)
@common.json_option
def command(
    machine: str,
    log: Path,
    table: dict[str, Any],
    out: Path,
    start_s: float,
    end_s: float,
    lowpass: float | None,
    factor: int,
    find_origin: bool,
    within: float | None,
    as_json: bool,
) -> None:
    """Run MACHINE's model along the motion in LOG, without estimation.

    Prints the RMS of measured minus simulated friction over the valid samples: those where the filters have settled and
    nothing is missing; and residual and noise floor of the whole record as diagnose states them. Elsewhere
    friction_measured_N is NaN. The force error is that RMS over the RMS of the drive
    force, as inverse dynamic models are judged.

    With --find-origin the log's positions count from the origin that is found; exit code 1 where it is not determined,
    and they count as they are.
    """
    if within is not None and not find_origin:
        raise InputError("command line", "--within", within, "beside --find-origin")
    resolved = load_for_log(machine, table)
    common.check_output_file(out)

    from sgms_mhe.configuration import override_machine
    from sgms_mhe.diagnosis import origin
    from sgms_mhe.diagnosis.record_residual import measure_residual
    from sgms_mhe.evaluation.prediction import force_error, predict_log, write_prediction

    recorded = common.recorded_log(log, resolved)
    if lowpass is not None:
        resolved = override_machine(resolved, {"sampling": {"velocity_cutoff": lowpass}})
    with common.progress_bar(f"predict {resolved.name}"):
        found = origin.find_origin(resolved, recorded, within) if find_origin else None
        if found is not None and found.position_m is not None:
            recorded = replace(recorded, position_m=recorded.position_m - found.position_m)
        prediction = predict_log(resolved, recorded)
        try:
            measured = measure_residual(resolved, recorded)
        except InputError:  # too few samples for a diagnosis
            measured = None
    units = resolved.plant.units
    error = force_error(prediction, start_s=start_s, end_s=end_s, factor=factor)
    write_prediction(out, prediction)
    if as_json:
        result = {
            "machine": resolved.name,
            "samples": len(prediction.time_s),
            "valid": error.rows,
            "residual_rms_N": error.residual_rms_N,
            "measured_rms_N": error.friction_rms_N,
            "force_rms_N": error.force_rms_N,
            "force_error": error.relative,
            "residual": None if measured is None else measured.to_json(),
            "origin": None if found is None else found.to_json(),
        }
        common.show(common.json_text(units.keyed(result)), out)
        _end(found)
        return
    total = len(prediction.time_s)
    residual = "" if measured is None else f"\n{measured.describe(units)}, as diagnose has them"
    place = "" if found is None else f"{found.describe(units)}\n"
    common.show(
        f"{place}"
        f"measured minus simulated: {error.residual_rms_N:.6g} {units.force} rms over {error.rows} of {total} samples "
        f"(measured friction: {error.friction_rms_N:.6g} {units.force} rms)\n"
        f"{units.push} error: {100.0 * error.relative:.3g} % of {error.force_rms_N:.6g} {units.force} rms"
        f"{residual}",
        out,
    )
    _end(found)


def _end(found: Origin | None) -> None:
    """End with exit code 1 where an origin was asked for and is not determined."""
    if found is not None and not found.is_determined:
        click.get_current_context().exit(1)
