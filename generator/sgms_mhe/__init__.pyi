"""The public interface, for type checkers: what `__init__.py` hands on when it is asked for."""

from sgms_mhe.api.diagnosis import diagnose as diagnose
from sgms_mhe.api.estimation import estimate as estimate
from sgms_mhe.api.estimation import find_origin as find_origin
from sgms_mhe.api.estimation import predict as predict
from sgms_mhe.api.experiments import effects as effects
from sgms_mhe.api.experiments import plan as plan
from sgms_mhe.api.exporting import ExportedAxis as ExportedAxis
from sgms_mhe.api.exporting import export as export
from sgms_mhe.api.fleets import fleet as fleet
from sgms_mhe.api.identification import identify as identify
from sgms_mhe.api.inputs import load as load
from sgms_mhe.api.inputs import read_log as read_log
from sgms_mhe.api.packages import generate as generate
from sgms_mhe.api.simulation import simulate as simulate
from sgms_mhe.api.tuning import tune as tune
from sgms_mhe.diagnosis.other_record import Origin as Origin
from sgms_mhe.diagnosis.plan import MotionPlan as MotionPlan
from sgms_mhe.diagnosis.result import Diagnosis as Diagnosis
from sgms_mhe.emission.package import Package as Package
from sgms_mhe.evaluation.prediction import PredictedFriction as PredictedFriction
from sgms_mhe.evaluation.tuning import Tuned as Tuned
from sgms_mhe.identification.result import Identification as Identification
from sgms_mhe.machine.resolved import Machine as Machine
from sgms_mhe.plant.simulation import SimulatedRun as SimulatedRun
from sgms_mhe.signals.estimates import Estimates as Estimates
from sgms_mhe.signals.logs import Log as Log
from sgms_mhe.support.errors import BuildError as BuildError
from sgms_mhe.support.errors import ImplausibleError as ImplausibleError
from sgms_mhe.support.errors import InputError as InputError
from sgms_mhe.support.errors import LogWarning as LogWarning
from sgms_mhe.support.errors import MachineWarning as MachineWarning

__version__: str
__all__ = [
    "BuildError",
    "Diagnosis",
    "Estimates",
    "ExportedAxis",
    "Identification",
    "ImplausibleError",
    "InputError",
    "Log",
    "LogWarning",
    "Machine",
    "MachineWarning",
    "MotionPlan",
    "Origin",
    "Package",
    "PredictedFriction",
    "SimulatedRun",
    "Tuned",
    "diagnose",
    "effects",
    "estimate",
    "export",
    "find_origin",
    "fleet",
    "generate",
    "identify",
    "load",
    "plan",
    "predict",
    "read_log",
    "simulate",
    "tune",
]
