"""The symbolic model of a machine: S-GMS friction, the axis that it acts on, and the effects beyond it."""

from sgms_mhe.model.axis import SIGNAL_NAMES, FreeParameter, StateSpec
from sgms_mhe.model.building import Model, build_model
from sgms_mhe.model.flow_table import FlowTable, flow_table, gate_ratio, gate_saturates
from sgms_mhe.model.friction import whole_shares

__all__ = [
    "SIGNAL_NAMES",
    "FlowTable",
    "FreeParameter",
    "Model",
    "StateSpec",
    "build_model",
    "flow_table",
    "gate_ratio",
    "gate_saturates",
    "whole_shares",
]
