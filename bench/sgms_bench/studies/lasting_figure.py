"""Picture of one log with an error that stays: the estimate with the deviations of its covariance, and the stated."""

from typing import Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sgms_bench.studies.faults import VARIANTS
from sgms_bench.studies.lasting import erroneous_record
from sgms_bench.studies.lasting_errors import ERRORS
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.evaluation.plots import BAND, ESTIMATED
from sgms_mhe.model import build_model
from sgms_mhe.reference import NodeRecord, ReferenceIntegrator, run_ekf
from sgms_mhe.reference.lasting import LastingErrors

Array = NDArray[np.float64]

SHOWN: Final = "force's gain 1.005"
MOTION: Final = "mixed"
SEED: Final = 0
DEVIATIONS: Final = 3.0
TRUE: Final = "black"


class CovarianceRecord(NodeRecord):
    """A record whose estimators state the deviations of their covariance, without factors for errors that stay."""

    def start_lasting(self, *, drifts: bool = True) -> LastingErrors:
        """No factors."""
        return LastingErrors(drifts * self.weights.drift, 1, enabled=False)


def lasting_figure(duration_s: float) -> Figure:
    """One stiffness over nominal, true and estimated by the EKF, in bands of 3 deviations: of the covariance, stated.

    It is the one that is most often beyond those of the covariance.
    """
    error = next(error for error in ERRORS if error.name == SHOWN)
    log = erroneous_record(error, MOTION, SEED, duration_s)
    model = build_model(override_machine(load_machine("etel_xy"), VARIANTS["ekf double"]))
    kinds = {"of the covariance": CovarianceRecord, "stated": NodeRecord}
    found = {
        title: run_ekf(kind(model, log.signals, ReferenceIntegrator(model))).extra for title, kind in kinds.items()
    }
    off = {title: np.abs(extra["theta"] - log.theta) / extra["theta_std"] for title, extra in found.items()}
    p = int(np.argmax(np.mean(off["of the covariance"] > DEVIATIONS, axis=0)))
    figure = Figure(figsize=(7.2, 3.4), layout="constrained")
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    for axis, (title, extra) in zip(axes, found.items(), strict=True):
        value, band = extra["theta"][:, p], DEVIATIONS * extra["theta_std"][:, p]
        time = np.arange(1, len(value) + 1) / model.machine.sampling.update_rate
        axis.fill_between(
            time, value - band, value + band, color=BAND, linewidth=0, label=f"±{DEVIATIONS:g} deviations"
        )
        axis.plot(time, value, color=ESTIMATED, linewidth=1.2, label="estimate")
        axis.axhline(log.theta[p], color=TRUE, linewidth=1.0, linestyle="--", label="true")
        axis.spines[["top", "right"]].set_visible(False)
        axis.set_title(f"{title}: beyond in {np.mean(off[title][:, p] > DEVIATIONS):.0%} of updates", fontsize=10)
        axis.set_xlabel("time [s]")
    axes[0].set_ylim(0.0, 2.0)
    axes[0].set_xlim(0.0, duration_s)
    axes[0].set_ylabel(f"stiffness {p + 1} over nominal")
    axes[0].legend(loc="upper right", frameon=False, fontsize=8)
    return figure
