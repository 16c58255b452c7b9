"""The report of a diagnosis, and the gain of the estimator that is generated from the extended machine."""

from __future__ import annotations

from sgms_mhe.report.estimator import EstimatorGain, EstimatorRun, Wander, closed_loop_gain
from sgms_mhe.report.page import write_refusal_report, write_report

__all__ = ["EstimatorGain", "EstimatorRun", "Wander", "closed_loop_gain", "write_refusal_report", "write_report"]
