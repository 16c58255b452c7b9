"""The public interface, for type checkers: what `__init__.py` hands on when it is asked for."""

from sgms_mhe.api.diagnosis import diagnose as diagnose
from sgms_mhe.api.estimation import estimate as estimate
from sgms_mhe.api.estimation import predict as predict
from sgms_mhe.api.exporting import export as export
from sgms_mhe.api.identification import identify as identify
from sgms_mhe.api.inputs import load as load
from sgms_mhe.api.inputs import read_log as read_log
from sgms_mhe.api.packages import generate as generate
from sgms_mhe.api.simulation import simulate as simulate

__version__: str
__all__ = ["diagnose", "estimate", "export", "generate", "identify", "load", "predict", "read_log", "simulate"]
