"""`sgms-mhe predict`."""

from __future__ import annotations

from pathlib import Path

import click

from sgms_mhe.commands.common import (
    check_output_file,
    example,
    json_option,
    json_text,
    log_argument,
    machine_argument,
    out_option,
    progress_bar,
    show,
)


@click.command(
    short_help="Run the model alone along a log.", epilog=example("predict etel_xy axis.csv --out predicted.csv")
)
@machine_argument
@log_argument
@out_option("CSV to write: time_s, friction_measured_N, friction_N at every sample.")
@json_option
def command(machine: str, log: Path, out: Path, as_json: bool) -> None:
    """Run MACHINE's model along the motion in LOG, without estimation.

    Prints the RMS of measured minus simulated friction over the valid samples: those where the filters have settled and
    nothing is missing. Elsewhere friction_measured_N is NaN.
    """
    from sgms_mhe.machine import load_machine

    resolved = load_machine(machine)
    check_output_file(out)

    from sgms_mhe.logs import read_log
    from sgms_mhe.prediction import predict_log, write_prediction

    recorded = read_log(log, resolved)
    with progress_bar(f"predict {resolved.name}"):
        prediction = predict_log(resolved, recorded)
    write_prediction(out, prediction)
    valid, total = len(prediction.residual_N), len(prediction.time_s)
    residual, measured = prediction.residual_rms_N, prediction.measured_rms_N
    if as_json:
        result = {
            "machine": resolved.name,
            "samples": total,
            "valid": valid,
            "residual_rms_N": residual,
            "measured_rms_N": measured,
        }
        show(json_text(result), out)
        return
    show(
        f"measured minus simulated: {residual:.6g} N rms over {valid} of {total} samples "
        f"(measured friction: {measured:.6g} N rms)",
        out,
    )
