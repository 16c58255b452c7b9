"""The symbolic model of a machine: S-GMS friction, the axis that it acts on, and the effects beyond it."""

from sgms_mhe.model.axis import SIGNAL_NAMES, StateSpec
from sgms_mhe.model.building import FreeParameter, Model, build_model
from sgms_mhe.model.friction import whole_shares

__all__ = ["SIGNAL_NAMES", "FreeParameter", "Model", "StateSpec", "build_model", "whole_shares"]
