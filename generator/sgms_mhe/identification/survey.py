"""The first look at the logs of an axis: linear least squares of the convex start's elements, and no search."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from sgms_mhe.identification.description import ELASTIC, KNOWN, check_slides, frictionless_error
from sgms_mhe.identification.final_fit import Known, drop_empty, drop_traces, join_alike, state_numbers
from sgms_mhe.identification.fits import covariance, fit_axis
from sgms_mhe.identification.identify import (
    Explored,
    Wanted,
    describe,
    is_excited,
    measure_motion,
    prepare_records,
    state_findings,
)
from sgms_mhe.identification.plain import fit_plain
from sgms_mhe.identification.records import sort_logs
from sgms_mhe.identification.result import Identification, Number
from sgms_mhe.identification.sampling import name_all
from sgms_mhe.identification.search import ChosenModel, Progress
from sgms_mhe.identification.start import Begun, begin
from sgms_mhe.identification.terms import companion_terms
from sgms_mhe.logfiles.plausibility import check_has_force
from sgms_mhe.machine import Units
from sgms_mhe.model.effects import MOVES, effect_definition
from sgms_mhe.signals.chain import readings
from sgms_mhe.signals.logs import Log
from sgms_mhe.signals.noise import encoder_step
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.numbers import SIGMAS
from sgms_mhe.support.parallel import one_library_thread
from sgms_mhe.support.statements import Rule, Statement

FOREIGN: Final = 0.5
"""Share of the force's RMS that is left from which on a log is of no axis that these numbers describe."""
MAIN: Final = {"mass": "mass", "inertia": "inertia", "coulomb": "friction", "viscous": "damping"}
"""Numbers that decide, in words."""


@dataclass(frozen=True, eq=False)
class Survey:
    """The first look at the logs of an axis.

    Attributes:
        explored: the fit, as an identification goes on from.
        wanted: request it answers.
        logs: in the order of their content.
        numbers: of the axis, with intervals, but those of elements, which depend on a law that nothing here decides;
            a mass the motion does not show is NaN.
        others: statements on sign, noise, residual and open questions.
    """

    explored: Explored
    wanted: Wanted
    logs: tuple[Log, ...]
    numbers: tuple[Number, ...]
    others: tuple[Statement, ...]

    @property
    def units(self) -> Units:
        """Return the units of the axis."""
        return self.explored.records.machine.plant.units

    @property
    def statements(self) -> tuple[Statement, ...]:
        """Return every judgement, the numbers first."""
        return (*(number.state(self.units) for number in self.numbers), *self.others)

    def describe(self, report: Progress) -> Identification:
        """Return the numbers with the machine file they make.

        Raises:
            InputError: a mass that nobody gave, and that the motion does not show.
        """
        return describe(self.explored, self.logs, self.wanted, report, "start")


@one_library_thread()
def survey(logs: Sequence[Log], wanted: Wanted, report: Progress) -> Survey:
    """Fit the convex start's elements by least squares, and state the numbers of the axis.

    Raises:
        InputError: logs that cannot tell: of the other sign, without motion, below break-away, of no such axis, ...
    """
    ordered = tuple(sort_logs(logs))
    for log in ordered:
        check_has_force(log)
    records = prepare_records(ordered, wanted, needs_mass=False)
    try:
        known = Known(wanted.mass is not None or ordered[0].is_friction_alone, count=False)
        explored = _fit_start(begin(records, wanted.per_decade, report), known)
    except InputError as error:
        raise error.add_notes(records.warnings) from None
    numbers, others, floor = state_findings(explored, ordered, wanted)
    shown = tuple(n for n in numbers if n.name.rstrip("_0123456789") not in ELASTIC)
    return Survey(explored, wanted, ordered, shown, (*_state_log(explored, ordered, floor), *others))


def _fit_start(begun: Begun, known: Known) -> Explored:
    """Return the fit of the convex start's elements without those that its records do not tell apart."""
    records, view, names = begun.records, begun.views.fine, name_all(begun.records.names)
    shows_friction = len(begun.spectrum.distances) > 0
    fit, rivals = fit_plain(view, begun.base, begun.spectrum.distances if shows_friction else None)
    units, push = records.machine.plant.units, float(np.std(view.rows.force[view.rows.used]))
    if fit.cross_rms > FOREIGN * push:
        left = f"{fit.cross_rms:.2g} of {push:.2g} {units.force} rms without an explanation"
        allowed = f"a log in which {units.inert}, friction and forces over the place are most of the {units.push}"
        raise InputError(names, units.push, left, f"{allowed}; what are its columns, their units, the axis?")
    if not shows_friction:
        raise frictionless_error(names)
    fit = join_alike(view, drop_traces(begun.views, drop_empty(view, fit)))
    final = state_numbers(view, fit, rivals, known, law_decided=False)
    found = ChosenModel(final.fit, final.fit, decided=False, counts={len(final.fit.levels): final.fit.cross_rms})
    measured = measure_motion(records, found)
    beside = [term.name for term in companion_terms(view.rows)]
    check_slides(view, final, [name for name in beside if is_excited(effect_definition(name), measured)], names)
    return Explored(records, begun.views, found, final, measured)


def _state_log(explored: Explored, logs: Sequence[Log], floor: float) -> Iterator[Statement]:
    """Yield the statements on sign and noise of logs, and on a constant force where their fit has none.

    `floor`: noise of a row [N].
    """
    final, rows, units = explored.final, explored.views.fine.rows, explored.records.machine.plant.units
    if final.mass is not None and not logs[0].is_friction_alone:
        yield Statement(Rule.SIGN, units.push, numbers={"seen": "it accelerates the axis the way that it goes"})
    elif final.numbers["coulomb"].relative <= KNOWN:
        yield Statement(Rule.SIGN, units.push, numbers={"seen": "friction brakes"})
    else:
        yield Statement(Rule.SIGN_OPEN, units.push, next=MOVES["jerks"])
    step = max(encoder_step(readings(log).position_m) for log in logs)
    counts: dict[str, float | str] = {"rate": rows.rate, "step": step, "length": units.position}
    yield Statement(Rule.NOISE, units.push, floor, unit=units.force, numbers=counts)
    own = {term.name: term for term in companion_terms(rows)}
    constant = next((term for term in own.values() if not np.ptp(term.columns, axis=0).any()), None)
    if constant is not None and not any(term.name in own for term in final.fit.terms):
        with_offset = fit_axis(final.view, (*final.fit.terms, constant), final.fit.shape, iterations=0)
        place = with_offset.place(constant.name).start
        std = float(np.sqrt(covariance(final.view, with_offset)[place, place]))
        about = units.named(f"{constant.name}.{effect_definition(constant.name).parameters[0].name}")
        value = float(with_offset.coefficient(constant.name)[0])
        if SIGMAS * std < final.fit.coulomb:
            yield Statement.of_number(Rule.NO_FORCE, about, value, std, units.force)
        else:
            yield Statement(Rule.UNSEEN, about, unit=units.force, next=MOVES["speeds"])
