"""An axis for other simulators."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Final

from sgms_mhe.api.axis_fmu import write_fmu
from sgms_mhe.api.inputs import LogSource, Note, load, recorded_log
from sgms_mhe.emission.axis_forms import TABLES, TEXT_FORMS, Form, check_title
from sgms_mhe.emission.friction_table import write_table
from sgms_mhe.evaluation.simpler_forms import FormError, form_error
from sgms_mhe.machine import Machine
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.files import atomic_write
from sgms_mhe.support.names import did_you_mean
from sgms_mhe.support.notebooks import Presentation, Shown
from sgms_mhe.support.options import Option

FORMS: Final[Mapping[str, Form]] = {
    **TEXT_FORMS,
    "twincat-table": Form((".lis", ".txt"), partial(write_table, form="twincat-table")),
    "sinamics-table": Form((".txt",), partial(write_table, form="sinamics-table")),
    "fmu2": Form((".fmu",), lambda machine, _: write_fmu(machine, 2)),
    "fmu3": Form((".fmu",), lambda machine, _: write_fmu(machine, 3)),
}
"""Forms by name."""


@dataclass(frozen=True, repr=False)
class ExportedAxis(Shown):
    """An axis in the form of another simulator.

    Attributes:
        machine: whose axis it is.
        form: name of the form.
        content: of the file; `text` where it is no archive.
        holds, lost: sentences on the parts of the axis in the form, and the missing ones.
        error: that the form makes along a log, with each force that is lost; None without a log, or where none is.
        missing: why an FMU has no binary; None where it has one, or needs none.
    """

    machine: Machine
    form: str
    content: bytes
    holds: tuple[str, ...]
    lost: tuple[str, ...]
    error: FormError | None = None
    missing: str | None = None

    def _shown(self) -> Presentation:
        return f"{self.machine.name} as {self.form}, {len(self.content)} bytes", (), ()

    @property
    def text(self) -> str:
        """The file as text; ValueError of an archive."""
        return self.content.decode()


def find_form(name: str) -> Form:
    """Return a form by its name.

    Raises:
        InputError: there is none.
    """
    if name not in FORMS:
        raise InputError("export", "to", name, f"one of {', '.join(FORMS)}{did_you_mean(name, FORMS)}")
    return FORMS[name]


def export(
    machine: str | Path | Machine,
    to: str,
    out: str | Path | None = None,
    *,
    log: LogSource | None = None,
    points: Annotated[int | None, Option("N", 2, 100)] = None,
    speed_range: Annotated[tuple[float, float] | None, Option("SLOW FAST", 1e-9, 1e3, "--range")] = None,
    note: Note | None = None,
) -> ExportedAxis:
    """Write a machine's axis, the plant, for another simulator.

    Args:
        machine: file, name, or loaded.
        to: one of mujoco, urdf, bam, modelica, simscape, csv, matlab, twincat-table, sinamics-table, fmu2, fmu3.
        out: the file; its name without suffix is that of the model in it; None: write nothing.
        log: file, Log or DataFrame, along which the error of a simpler form is measured.
        points: of friction over speed, which csv then has instead of the numbers; None: as many as the drive has.
        speed_range: slowest and fastest point [m/s, rad/s]; None: v_s / 10 and max_velocity.
        note: called with each sentence on how the log was read.

    Returns:
        The file's content, the parts of the axis it holds, the lost ones, and that error.

    Raises:
        InputError: the machine file, the form, the file's name, or the log.
        BuildError: an FMU, or a log, where the C compiler refused.
    """
    axis, form = load(machine), find_form(to)
    tabled = points is not None or speed_range is not None
    if tabled and to not in TABLES:
        raise InputError("export", "points", to, f"friction over speed: one of {', '.join(TABLES)}")
    is_table = tabled or (to in TABLES and to != "csv")
    if axis.drive.kind != "force" and to != "bam" and not is_table:
        raise InputError(axis.source, "drive.kind", axis.drive.kind, "force: no other simulator's form holds a drive")
    path = None if out is None else Path(out)
    is_file = path is not None and (path.is_file() or not path.exists())  # no pipe, no /dev/stdout
    if path is not None and is_file and path.suffix.lower() not in form.suffixes:
        raise InputError(path, "output file", path.name, f"a name that ends in {' or '.join(form.suffixes)}")
    names_model = is_file and to in TEXT_FORMS and to not in TABLES
    title = check_title(path.stem) if path is not None and names_model else f"{axis.name}_axis"
    written = write_table(axis, title, to, points, speed_range) if tabled else form.write(axis, title)
    error = None if log is None else form_error(axis, written, recorded_log(log, axis, note=note))
    if path is not None:
        with atomic_write(path) as stream:
            stream.write(written.content)
    return ExportedAxis(axis, to, written.content, written.holds, written.lost, error, written.missing)
