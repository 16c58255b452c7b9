"""From a measured log and a machine file to a named cause, an extended machine file and a measured gain."""

from __future__ import annotations

from sgms_mhe.diagnosis.result import (
    Alternative,
    BaseParameter,
    Cause,
    Diagnosis,
    Limit,
    RivalFit,
    Rms,
    Score,
)
from sgms_mhe.diagnosis.structure import ResidualStructure
from sgms_mhe.diagnosis.together import diagnose
from sgms_mhe.diagnosis.traces import Traces
from sgms_mhe.diagnosis.writing import write_diagnosis, write_extended, write_refusal

__all__ = [
    "Alternative",
    "BaseParameter",
    "Cause",
    "Diagnosis",
    "Limit",
    "ResidualStructure",
    "RivalFit",
    "Rms",
    "Score",
    "Traces",
    "diagnose",
    "write_diagnosis",
    "write_extended",
    "write_refusal",
]
