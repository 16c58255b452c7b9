"""The report of a diagnosis, the page over a fleet, and the gain of an extended machine's estimator."""

from sgms_mhe.report.estimator import EstimatorGain as EstimatorGain
from sgms_mhe.report.estimator import closed_loop_gain as closed_loop_gain
from sgms_mhe.report.fleet import Band as Band
from sgms_mhe.report.fleet import FleetCourse as FleetCourse
from sgms_mhe.report.fleet import FleetLog as FleetLog
from sgms_mhe.report.fleet import FleetPoint as FleetPoint
from sgms_mhe.report.fleet import NumberChange as NumberChange
from sgms_mhe.report.fleet import NumberTrend as NumberTrend
from sgms_mhe.report.page import attempt_report as attempt_report
from sgms_mhe.report.page import write_fleet_report as write_fleet_report
from sgms_mhe.report.page import write_report as write_report
from sgms_mhe.report.page import write_survey_page as write_survey_page
from sgms_mhe.report.page import write_unread_page as write_unread_page
from sgms_mhe.report.page import write_watch_page as write_watch_page
from sgms_mhe.report.watch import Watched as Watched
