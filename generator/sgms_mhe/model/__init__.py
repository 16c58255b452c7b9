"""The symbolic model of a machine: S-GMS friction, the axis it acts on, and the effects beyond it."""

from sgms_mhe.model.axis import SIGNAL_NAMES as SIGNAL_NAMES
from sgms_mhe.model.axis import FreeParameter as FreeParameter
from sgms_mhe.model.axis import StateSpec as StateSpec
from sgms_mhe.model.building import Model as Model
from sgms_mhe.model.building import build_model as build_model
from sgms_mhe.model.flow_table import FlowTable as FlowTable
from sgms_mhe.model.flow_table import flow_table as flow_table
from sgms_mhe.model.flow_table import gate_ratio as gate_ratio
from sgms_mhe.model.flow_table import gate_saturates as gate_saturates
from sgms_mhe.model.friction import whole_shares as whole_shares
