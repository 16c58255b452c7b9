"""From a measured log and a machine file to a named cause, an extended machine file and a measured gain."""

from sgms_mhe.diagnosis.parts import Alternative as Alternative
from sgms_mhe.diagnosis.parts import BaseParameter as BaseParameter
from sgms_mhe.diagnosis.parts import Cause as Cause
from sgms_mhe.diagnosis.parts import RivalFit as RivalFit
from sgms_mhe.diagnosis.parts import Rms as Rms
from sgms_mhe.diagnosis.parts import Score as Score
from sgms_mhe.diagnosis.result import Diagnosis as Diagnosis
from sgms_mhe.diagnosis.structure import ResidualStructure as ResidualStructure
from sgms_mhe.diagnosis.together import diagnose as diagnose
from sgms_mhe.diagnosis.traces import Traces as Traces
from sgms_mhe.diagnosis.writing import write_diagnosis as write_diagnosis
from sgms_mhe.diagnosis.writing import write_extended as write_extended
from sgms_mhe.diagnosis.writing import write_refusal as write_refusal
