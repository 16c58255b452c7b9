"""`sgms-mhe predict`."""

from __future__ import annotations

from dataclasses import replace
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from sgms_mhe.commands import common
from sgms_mhe.commands.options import make_command
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.libraries import optional_library
from sgms_mhe.support.options import Option

if TYPE_CHECKING:
    from sgms_mhe.evaluation.prediction import PredictedFriction
    from sgms_mhe.machine import Machine


@make_command(
    "predict etel_xy axis.csv --out predicted.csv",
    "predict emps DATA_EMPS.mat --out predicted.csv --from 12.5 --lowpass 100 --decimate 10",
    "predict emps DATA_EMPS.mat --out predicted.csv --free-run --plot figures",
    of="estimation.predict",
)
def command(
    machine: Machine,
    log: Path,
    *,
    out: Path,
    start_s: Annotated[float, Option("S", 0.0, 1e8, "--from")] = 0.0,
    end_s: Annotated[float, Option("S", 0.0, 1e8, "--to")] = inf,
    lowpass_Hz: float | None = None,
    decimate: Annotated[int, Option("N", 1)] = 1,
    free_run: bool = False,
    tolerance_m: Annotated[float | None, Option("M", 1e-12, 1e6)] = None,
    plot: Annotated[Path | None, Option("DIR")] = None,
    find_origin: bool = False,
    within_m: Annotated[float | None, Option(least=1e-9, most=1e6)] = None,
    json: bool = False,
) -> bool:
    """Run the model alone along a log.

    Prints the RMS of measured minus simulated friction over the valid samples: those where the filters have settled and
    nothing is missing; and residual and noise floor of the whole record as diagnose states them. Elsewhere
    friction_measured_N is NaN. The force error is that RMS over the RMS of the drive
    force, as inverse dynamic models are judged.

    With --find-origin the log's positions count from the origin that is found; exit code 1 where it is not determined,
    and they count as they are.

    With --free-run the model moves by the logged force alone, or by the command where [drive] describes its effect,
    from the first samples of the part that is compared and anew after every gap: error, drift, and the time for which
    it stays near the measured motion. Of a log without a force this is all.

    Args:
        out: CSV to write: time_s, friction_measured_N, friction_N (of a rotary axis _Nm) at every sample.
        start_s: compare from here on [s since the log's start]; the model runs through the whole log.
        end_s: and until here [s].
        decimate: compare every N-th sample, behind an anti-aliasing filter.
        free_run: also the motion the logged force, or command, alone makes of the model.
        tolerance_m: error of the free run's horizon [m, rad]; None: 1 % of the range of the positions.
        plot: also draw friction.png, and of a free run motion.png.
        find_origin: find the position that forces over place count from, first.
        within_m: how far from 0 the origin may be [m, rad]; needed where forces over place do not repeat.
    """
    if within_m is not None and not find_origin:
        raise InputError("command line", "--within", within_m, "beside --find-origin")
    if tolerance_m is not None and not free_run:
        raise InputError("command line", "--tolerance", tolerance_m, "beside --free-run")
    common.check_output_file(out)
    if plot is not None:
        common.check_output_folder(plot)
        optional_library("matplotlib", "plot", "a figure", "--plot")

    from sgms_mhe.configuration import carry_load, override_machine
    from sgms_mhe.diagnosis import origin
    from sgms_mhe.diagnosis.record_residual import measure_residual
    from sgms_mhe.evaluation.prediction import force_error, predict_log, write_prediction
    from sgms_mhe.recordings.free_run import run_freely

    recorded = common.recorded_log(log, machine, commanded=True)
    machine = carry_load(machine, recorded.run)
    if lowpass_Hz is not None:
        machine = override_machine(machine, {"sampling": {"velocity_cutoff": lowpass_Hz}})
    with common.progress_bar(f"predict {machine.name}"):
        found = origin.find_origin(machine, recorded, within_m) if find_origin else None
        if found is not None and found.position_m is not None:
            recorded = replace(recorded, position_m=recorded.position_m - found.position_m)
        motion = None
        if free_run:
            motion = run_freely(machine, recorded, start_s=start_s, end_s=end_s, tolerance_m=tolerance_m)
        prediction = predict_log(machine, recorded, motion)
    window: dict[str, Any] = {"start_s": start_s, "end_s": end_s, "factor": decimate}
    error = None if prediction.is_motion else force_error(prediction, **window)
    write_prediction(out, prediction)
    if plot is not None:
        _draw(prediction, plot)
    units, undetermined = machine.plant.units, found is not None and not found.is_determined
    result: dict[str, Any] = {"machine": machine.name, "samples": len(prediction.time_s)}
    said = [] if found is None else [found.describe(units)]
    if error is not None:
        try:
            measured = measure_residual(machine, recorded)
        except InputError:  # too few samples for a diagnosis
            measured = None
        result |= {
            "valid": error.rows,
            "residual_rms_N": error.residual_rms_N,
            "measured_rms_N": error.friction_rms_N,
            "force_rms_N": error.force_rms_N,
            "force_error": error.relative,
            "residual": None if measured is None else measured.to_json(),
            "origin": None if found is None else found.to_json(),
        }
        said += [
            f"measured minus simulated: {error.residual_rms_N:.6g} {units.force} rms over {error.rows} of "
            f"{len(prediction.time_s)} samples (measured friction: {error.friction_rms_N:.6g} {units.force} rms)",
            f"{units.push} error: {100.0 * error.relative:.3g} % of {error.force_rms_N:.6g} {units.force} rms",
        ]
        said += [] if measured is None else [f"{measured.describe(units)}, as diagnose has them"]
    result["free_run"] = None if motion is None else motion.to_json()
    said += [] if motion is None else [motion.describe()]
    common.show(common.json_text(units.keyed(result)) if json else "\n".join(said), out)
    return undetermined


def _draw(prediction: PredictedFriction, folder: Path) -> None:
    from sgms_mhe.evaluation.plots import blank_figure

    drawings = {} if prediction.is_motion else {"friction.png": prediction.plot}
    drawings |= {"motion.png": m.plot} if (m := prediction.motion) else {}
    figures = {name: blank_figure(4.5) for name in drawings}
    for name, draw in drawings.items():
        draw(figures[name].subplots())
    common.save_figures(folder, figures)
