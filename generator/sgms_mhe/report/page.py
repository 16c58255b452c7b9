"""The pages: of a diagnosis, a first look, a fleet, a run that is watched; each works without a network."""

import json
import logging
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import jinja2
from markupsafe import Markup

from sgms_mhe.diagnosis import Diagnosis, write_extended
from sgms_mhe.identification.survey import Survey
from sgms_mhe.machine import LINEAR, Machine
from sgms_mhe.report import content
from sgms_mhe.report.estimator import EstimatorGain
from sgms_mhe.report.fleet import FleetCourse, FleetLog, fleet_content
from sgms_mhe.report.learned import learned_plots
from sgms_mhe.report.plots import log_plots, plots, survey_plots
from sgms_mhe.report.rivals import rivals_in_place
from sgms_mhe.report.series import views
from sgms_mhe.report.survey import survey_content, unread_content
from sgms_mhe.report.units import use_units
from sgms_mhe.report.watch import Watched, watch_content, watch_plots
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.files import write_text

_LOGGER: Final = logging.getLogger(__name__)
_HERE: Final = Path(__file__).resolve().parent


def write_report(diagnosis: Diagnosis, out_dir: str | Path, *, estimator: EstimatorGain | None = None) -> Path:
    """Write report.html and the extended machine file.

    Args:
        diagnosis: to be reported.
        out_dir: folder; made where it does not exist.
        estimator: gain of the estimator on another log (`closed_loop_gain`), where there is one.

    Returns:
        Path of report.html.
    """
    folder = Path(out_dir)
    folder.mkdir(parents=True, exist_ok=True)
    with use_units(diagnosis.machine.plant.units):
        return _written(diagnosis, folder, estimator)


def attempt_report(
    diagnosis: Diagnosis, out_dir: str | Path, say: Callable[[str], None], *, estimator: EstimatorGain | None = None
) -> Path | None:
    """Write the report; return its path, or None where it cannot be written.

    A verdict costs minutes and a report is only its picture: a full disk or a defect of a plot must not lose it. The
    failure is said in a sentence and logged with its traceback.

    Args:
        diagnosis, out_dir, estimator: as of `write_report`.
        say: called with the sentence.
    """
    try:
        return write_report(diagnosis, out_dir, estimator=estimator)
    except Exception as error:
        _LOGGER.debug("report of %s", diagnosis.source, exc_info=True)
        say(f"no report: {type(error).__name__}: {error}; verdict, causes and diagnosis.json are whole")
        return None


def _written(diagnosis: Diagnosis, folder: Path, estimator: EstimatorGain | None) -> Path:
    shown, rivals = views(diagnosis.traces), rivals_in_place(diagnosis)
    write_extended(diagnosis, folder)
    # Last: where it is, everything that it links to is.
    page, drawn = content.page(diagnosis, folder, shown, rivals, estimator), plots(diagnosis, shown, rivals)
    if diagnosis.learned is not None:
        drawn |= learned_plots(diagnosis.learned)
    return _write_page(folder / "report.html", "report.html.jinja", page, drawn)


def write_fleet_report(
    verb: str, table: str, logs: Sequence[FleetLog], courses: Sequence[FleetCourse], out_dir: str | Path
) -> Path:
    """Write fleet.html: failures, numbers outside of their band, every number of every axis over its logs.

    Args:
        verb: applied to every log.
        table: as its user calls it.
        logs: in the table's order.
        courses: numbers of axes over their logs.
        out_dir: folder; made where it does not exist.

    Returns:
        Path of fleet.html.
    """
    path = Path(out_dir) / "fleet.html"
    path.parent.mkdir(parents=True, exist_ok=True)
    page = fleet_content(verb, table, logs, courses)
    return _write_page(path, "fleet.html.jinja", page, {}, style="fleet.css")


def write_watch_page(path: Path, watched: Watched) -> None:
    """Write the page over a run; atomically, so that it is whole whenever it is read."""
    with use_units(watched.course.machine.plant.units):
        _write_page(path, "watch.html.jinja", watch_content(watched), watch_plots(watched.course))


def write_survey_page(path: Path, found: Survey, columns: Mapping[str, Any], command: str) -> None:
    """Write the page of a first look.

    Args:
        path: of the page.
        found: the look.
        columns: of the log, as `inspect` has them.
        command: that plans the next motion.
    """
    with use_units(found.units):
        _write_page(path, "survey.html.jinja", survey_content(found, columns, command), survey_plots(found))


def write_unread_page(
    path: Path, reason: str, log: Log | None, columns: Mapping[str, Any], machine: Machine | None = None
) -> Path:
    """Write the page of a log to which nothing was fitted; return its path.

    Args:
        path: of the page; its folder is made where it does not exist.
        reason: in a sentence.
        log: as it was read; None: it was not.
        columns: of the log, as `inspect` has them; or its `file` alone.
        machine: whose file refuses the log; None: there is none yet.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with use_units(LINEAR if log is None else log.units):
        page = unread_content(reason, columns, machine, has_log=log is not None)
        return _write_page(path, "survey.html.jinja", page, {} if log is None else log_plots(log))


def _write_page(path: Path, template: str, page: dict[str, Any], drawn: dict[str, Any], *, style: str = "") -> Path:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_HERE),
        undefined=jinja2.StrictUndefined,
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    # Within a script element only "</" could end it.
    data = json.dumps({"plots": drawn}, separators=(",", ":"), allow_nan=False).replace("</", "<\\/")
    text = environment.get_template(template).render(
        page, css=_safe("report.css") + (_safe(style) if style else ""), script=_safe("report.js"), data=Markup(data)
    )
    write_text(path, text)
    return path


def _safe(name: str) -> Markup:
    return Markup((_HERE / name).read_text(encoding="utf-8"))
