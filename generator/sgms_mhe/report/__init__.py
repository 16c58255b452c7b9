"""The report of a diagnosis, the page over a fleet, and the gain of an extended machine's estimator."""

from __future__ import annotations

from sgms_mhe.report.estimator import EstimatorGain, EstimatorRun, Wander, closed_loop_gain
from sgms_mhe.report.fleet import Band, FleetCourse, FleetLog, FleetPoint, NumberTrend
from sgms_mhe.report.page import (
    attempt_report,
    write_fleet_report,
    write_refusal_report,
    write_report,
    write_watch_page,
)
from sgms_mhe.report.watch import Watched

__all__ = [
    "Band",
    "EstimatorGain",
    "EstimatorRun",
    "FleetCourse",
    "FleetLog",
    "FleetPoint",
    "NumberTrend",
    "Wander",
    "Watched",
    "attempt_report",
    "closed_loop_gain",
    "write_fleet_report",
    "write_refusal_report",
    "write_report",
    "write_watch_page",
]
