"""Reference solvers: judges of the generated C, written from docs/ and not from the C."""

from typing import Literal

from sgms_mhe.machine import Machine
from sgms_mhe.model import Model, build_model
from sgms_mhe.reference.ekf import run_ekf as run_ekf
from sgms_mhe.reference.integrator import ReferenceIntegrator as ReferenceIntegrator
from sgms_mhe.reference.mhe import run_mhe as run_mhe
from sgms_mhe.reference.problem import NodeRecord as NodeRecord
from sgms_mhe.reference.problem import Progress
from sgms_mhe.reference.problem import Start as Start
from sgms_mhe.reference.problem import UpdateStatus as UpdateStatus
from sgms_mhe.reference.problem import Weights as Weights
from sgms_mhe.reference.smoother import run_smoother
from sgms_mhe.signals.chain import Signals
from sgms_mhe.signals.estimates import Estimates

Kind = Literal["mhe", "ekf", "smoother"]

_SOLVERS = {"mhe": run_mhe, "ekf": run_ekf, "smoother": run_smoother}


def estimate_model(
    model: Model, signals: Signals, kind: Kind, *, progress: Progress | None = None, compiled: bool = True
) -> Estimates:
    """Run one of the reference solvers on a symbolic model; `compiled=False` does without a C compiler."""
    record = NodeRecord(model, signals, ReferenceIntegrator(model, compiled=compiled))
    return _SOLVERS[kind](record, progress)


def estimate_reference(
    machine: Machine, signals: Signals, kind: Kind | None = None, *, progress: Progress | None = None
) -> Estimates:
    """Estimate as the machine file says (`estimator.kind`), or with the solver named."""
    return estimate_model(build_model(machine), signals, kind or machine.estimator.kind, progress=progress)
