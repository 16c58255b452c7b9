"""From logs, and a mass or none, to a machine file."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from sgms_mhe.configuration import make_machine, override_machine
from sgms_mhe.identification.commanded import identify_drive
from sgms_mhe.identification.description import (
    MISFIT,
    FrictionError,
    check_slides,
    frictionless_error,
    law_numbers,
    list_limits,
    list_misfit,
    list_unexcited,
    mass_number,
    unknown_mass,
)
from sgms_mhe.identification.estimator_noise import measure_colour, measure_noise
from sgms_mhe.identification.final_fit import FinalIdentification, Known, is_apart, make_final_fit, state_numbers
from sgms_mhe.identification.fits import AxisFit, encoder_forces, fit_axis
from sgms_mhe.identification.plain import fit_plain, measure_unseen
from sgms_mhe.identification.record_numbers import find_followed, list_record_numbers
from sgms_mhe.identification.records import Records, filter_motion, make_records, sort_logs
from sgms_mhe.identification.result import Identification, Number
from sgms_mhe.identification.sampling import common_rate, name_all, replace_filter, rough_mass, unknown_axis
from sgms_mhe.identification.search import LEAST_SHARE, MATERIAL, MOST_ELEMENTS, ChosenModel, Progress, Views, search
from sgms_mhe.identification.spectrum import PER_DECADE
from sgms_mhe.identification.start import Begun, begin, start_level_terms
from sgms_mhe.identification.terms import OF_RECORD, SAMPLING, companion_names, companion_terms, curve_terms
from sgms_mhe.identification.writing import check_toml, machine_content, machine_toml
from sgms_mhe.logfiles.plausibility import check_has_force, check_plausible
from sgms_mhe.machine import Kind, Machine
from sgms_mhe.model.effects import MOVES, Measure, effect_definition
from sgms_mhe.model.effects.causes import CauseDefinition
from sgms_mhe.recordings.evidence import largest_force, noise_floor
from sgms_mhe.recordings.excitation import measure_excitation
from sgms_mhe.recordings.output_error import Objective, refit_motion
from sgms_mhe.recordings.recording import Recording
from sgms_mhe.signals.chain import readings
from sgms_mhe.signals.logs import Log
from sgms_mhe.signals.noise import encoder_step
from sgms_mhe.support.decisions import log_decision
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.parallel import one_library_thread
from sgms_mhe.support.statements import Rule, Statement, list_open

LEAST_TRAVEL: Final = 20.0
"""Travel over the resolution of the position below which nothing moved."""

DRIVEN: Final = 0.2
"""Mean power of friction over its mean size below minus which a sign is wrong: friction takes power."""
NO_MASS: Final = 1.0
"""Mass [kg], or inertia [kg m^2], that stands in the file where friction alone was recorded: nothing depends on it."""
AS_MUCH: Final = 0.9
"""Share of what least squares leaves from which on as much is left beside errors of timing."""


@dataclass(frozen=True)
class Wanted:
    """Request of a user.

    Attributes:
        name: of the machine.
        mass: moved mass [kg], or inertia [kg m^2]; None: that of the motion.
        elements: their number; None: as the records show.
        like: a machine whose sampling, estimator, code and `[log]` are taken over; None: none.
        objective: norm of the last fit of mass, level, damping and sizes of effects.
        per_decade: distances of the convex start's grid; the result does not depend on it.
    """

    name: str
    mass: float | None = None
    elements: int | None = None
    like: Machine | None = None
    objective: Objective = "force"
    per_decade: float = PER_DECADE


def _silent(_: str) -> None:
    return None


@dataclass(frozen=True, eq=False)
class Explored:
    """Everything that an identification knows before it is written down.

    Attributes:
        records: the logs behind the chain.
        views: their rows.
        found: law and elements.
        final: the numbers.
        measured: excitation of the motion, by measure.
        plain_rms: residual of a file of least squares on data unseen by any fit [N]; NaN: not computed.
        is_plain: whether this is that of least squares.
        said: statements on the two.
        unseen: numbers of the law the records do not show, whatever their deviation.
    """

    records: Records
    views: Views
    found: ChosenModel
    final: FinalIdentification
    measured: Mapping[Measure, float]
    plain_rms: float = math.nan
    is_plain: bool = False
    said: tuple[Statement, ...] = ()
    unseen: tuple[str, ...] = ()

    @property
    def friction(self) -> dict[str, Any]:
        """Numbers of a table [friction], but for the law."""
        return self.friction_from(0.0)

    def friction_from(self, least: float) -> dict[str, Any]:
        """The same, no element breaking away within less than a distance [m]."""
        fit = self.final.fit
        levels, rise = np.maximum(fit.levels, LEAST_SHARE * fit.coulomb), fit.shape.rise
        shares = (levels / levels.sum()).tolist()
        table: dict[str, Any] = {
            "stiffness": (levels / np.maximum(fit.shape.distances, least)).tolist(),
            "fraction": [*shares[:-1], 1.0 - math.fsum(shares[:-1])],
            "micro_viscous": [0.0] * len(levels),
            "coulomb": float(levels.sum()),
            "viscous": self.final.numbers["viscous"].value if "viscous" in self.final.numbers else 0.0,
            "stribeck_ratio": 0.0 if rise is None else rise.ratio,
        }
        return table if rise is None else table | {"stribeck_velocity": rise.velocity}


@one_library_thread()
def identify(logs: Sequence[Log], wanted: Wanted, report: Progress = _silent) -> Identification:
    """Identify an axis from measurements alone. The order of the logs does not matter.

    Raises:
        InputError: logs that cannot tell: without motion, below break-away, of different rates, ...
    """
    driven = [log for log in logs if not log.is_commanded]
    if len(driven) < len(logs):
        if driven:
            check_has_force(next(log for log in logs if log.is_commanded))
        for option in ("mass", "elements", "objective"):
            if (value := getattr(wanted, option)) not in (None, "force", "motion"):
                raise InputError("identify", option, value, "none: no log has a force to fit it to")
        return identify_drive(logs, wanted.name, wanted.like, report)
    return describe(explore(logs, wanted, report), sort_logs(logs), wanted, report)


def explore(logs: Sequence[Log], wanted: Wanted, report: Progress = _silent) -> Explored:
    """Find law, elements and numbers of an axis, or those of least squares where they leave less; raises likewise."""
    if wanted.elements is not None and not 1 <= wanted.elements <= MOST_ELEMENTS:
        raise InputError("identify", "elements", wanted.elements, f"1 to {MOST_ELEMENTS}, or auto")
    known = Known(wanted.mass is not None or logs[0].is_friction_alone, wanted.elements is not None)
    records = prepare_records(sort_logs(logs), wanted)
    try:
        begun = begin(records, wanted.per_decade, report)
        try:
            explored = _explore_records(begun, wanted.elements, known, report)
        except FrictionError as refusal:
            return _explain(refusal, begun, known)
        return _choose(begun, explored, known)
    except InputError as error:
        raise error.add_notes(records.warnings) from None


def _choose(begun: Begun, explored: Explored, known: Known) -> Explored:
    """Return the result of the search, or that of least squares where its residual is smaller.

    Errors of timing within a sample are of the log, not of the axis: numbers beside them are truer, whatever a file
    without them leaves. Where beside them no less is left than least squares leaves without, they are none.
    """
    final, view = explored.final, begun.views.fine
    kept = {"viscous", "mass", *(term.name for term in final.fit.terms if term.name in OF_RECORD)}
    timed, plain = (
        fit_plain(view, [term for term in begun.base if term.name in kept | names]) for names in (set(SAMPLING), set())
    )
    beside, left = measure_unseen(view, timed[0])[0], measure_unseen(view, plain[0])[1]
    apart = is_apart(final.fit, final.cov, final.view)
    is_less, units = left < (1.0 - MATERIAL) * final.stated_rms, begun.records.machine.plant.units
    numbers = {"own": final.stated_rms, "timed": final.held_out_rms}
    bent = Statement(Rule.BENT, "file", left, None, units.force, numbers)
    explored = replace(explored, plain_rms=left, said=(bent,) if is_less and not apart else ())
    none = not apart and is_less and final.held_out_rms > AS_MUCH * left
    if not plain[0].coulomb > 0.0 or not (none or beside < (1.0 - MATERIAL) * final.held_out_rms):
        return explored
    found = state_plain(begun, *(timed if apart else plain), known)
    own = found.final.stated_rms
    if own >= final.stated_rms:
        return explored
    if final.mass is not None and found.final.mass is None and not known.mass:
        less = Statement(Rule.NO_MASS, "file", own, None, units.force, {"inert": units.inert})
        return replace(explored, said=(less,))
    plain_file = Statement(Rule.PLAIN, "file", own, None, units.force, {"searched": final.stated_rms})
    return replace(found, plain_rms=own, said=(plain_file,))


def _explain(refusal: FrictionError, begun: Begun, known: Known) -> Explored:
    """Return the result of least squares where the residual is too large for the refusal; else raise it.

    Raises:
        InputError: nearly nothing is left, or least squares has no friction either.
    """
    view, units = begun.views.fine, begun.records.machine.plant.units
    fit, rivals = fit_plain(view, [term for term in begun.base if term.name not in SAMPLING])
    bare = fit_axis(view, fit.terms, replace(fit.shape, distances=np.zeros(0)), iterations=0)
    if min(refusal.left, bare.rms) <= MISFIT * noise_floor(view.rows, fit.residual):
        raise refusal
    if not fit.coulomb > 0.0:
        left = f"{fit.rms:.2g} {units.force} rms that nothing here explains"
        raise InputError(begun.records.names[0], "residual", left, "a log with less of it: it hides dry friction")
    found = state_plain(begun, fit, rivals, known)
    own = found.final.stated_rms
    said = Statement(Rule.PLAIN_ALONE, "file", own, unit=units.force)
    return replace(found, plain_rms=own, said=(said,), unseen=refusal.unseen)


def state_plain(begun: Begun, fit: AxisFit, rivals: Mapping[str, tuple[str, ...]], known: Known) -> Explored:
    """Return the result of least squares."""
    final = state_numbers(begun.views.fine, fit, rivals, known, is_plain=True)
    found = ChosenModel(final.fit, final.fit, decided=False, counts={len(fit.levels): fit.cross_rms})
    return Explored(begun.records, begun.views, found, final, measure_motion(begun.records, found), is_plain=True)


def explore_recording(recording: Recording, report: Progress = _silent) -> Explored:
    """Find law, elements, mass and numbers of an axis along decimated samples, at their rate.

    Of the recording's machine the signal chain counts, of its friction nothing does. Numbers are those of
    the samples' rate: to begin from, not to report.

    Raises:
        InputError: as `identify` does.
    """
    content = recording.machine.content
    sampling = {key: value for key, value in content.get("sampling", {}).items() if key != "integrator"}
    bare = {"name": content["name"], "sampling": sampling} | {key: content[key] for key in ("plant", "friction")}
    recording = replace(recording, machine=make_machine(bare, recording.machine.source))
    motion = (filter_motion(recording),)
    records = Records(recording.machine, (recording.machine.name,), recording, motion, motion, 0.0, ())
    return _explore_records(begin(records, PER_DECADE, report), None, Known(mass=False, count=False), report)


def _explore_records(begun: Begun, elements: int | None, known: Known, report: Progress) -> Explored:
    """Find law, elements and numbers of an axis along its records; `known`: numbers kept unless contradicted."""
    records, views, spectrum, base = begun.records, begun.views, begun.spectrum, begun.base
    if not len(spectrum.distances):
        raise frictionless_error(name_all(records.names))
    rows, noise = records.rows, views.fine.noise
    companions, curves = companion_terms(rows), curve_terms(rows)
    level = start_level_terms(rows, base, spectrum)
    found = search(views, (*base, *companions, *level), spectrum, elements, report)
    if not found.fit.coulomb > 0.0:
        raise frictionless_error(name_all(records.names))
    measured = measure_motion(records, found)
    names = dict.fromkeys((*companion_names(rows), *(term.name for term in curves)))
    excited = [name for name in names if is_excited(effect_definition(name), measured)]
    final = make_final_fit(views, found, base, companions, curves, excited, known, report)
    check_slides(views.fine, final, excited, name_all(records.names))
    log_decision(
        "numbers",
        "final fit",
        residual_held_out_N=final.held_out_rms,
        noise_floor_N=noise,
        numbers={name: (number.value, number.std) for name, number in final.numbers.items()},
        motion=dict(measured),
        shown=excited,
    )
    return Explored(records, views, found, final, measured)


def prepare_records(logs: Sequence[Log], wanted: Wanted, *, needs_mass: bool = True) -> Records:
    """The logs behind the chain, those refused that hold no motion."""
    common_rate(logs)
    for log in logs:
        _check_kind(log, logs[0].kind if wanted.like is None else wanted.like.plant.kind)
        _check_force(log, logs[0])
        _check_moves(log)
    machine = unknown_axis(logs, wanted.name, wanted.mass or NO_MASS, wanted.like)
    for log in logs:
        check_plausible(log, machine, has_mass=wanted.mass is not None)
    is_shown = wanted.mass is None and not logs[0].is_friction_alone
    mass = rough_mass(machine, logs, is_needed=needs_mass) if is_shown else wanted.mass or NO_MASS
    machine = unknown_axis(logs, wanted.name, mass, wanted.like)
    warnings: tuple[str, ...] = ()
    if is_shown:
        machine, warnings = replace_filter(machine, logs)
    if wanted.like is None:  # no filter was asked for
        warnings = ()
    records = make_records(machine, logs)
    _check_dissipates(records)
    return replace(records, warnings=(*warnings, *records.warnings))


def _check_kind(log: Log, kind: Kind) -> None:
    if log.kind != kind:
        raise InputError(
            log.source or "log", "columns", f"of a {log.kind} axis", f"those of a {kind} axis, as the others"
        )


def _check_force(log: Log, first: Log) -> None:
    """Refuse a log of friction alone beside one of a force, or the other way round."""
    if log.is_friction_alone != first.is_friction_alone:
        names = {True: log.units.named("friction_N"), False: log.units.named("force_N")}
        allowed = (
            f"{names[first.is_friction_alone]}, as {first.source or 'the first log'} has; logs of one call share it"
        )
        raise InputError(log.source or "log", "columns", names[log.is_friction_alone], allowed)


def _check_moves(log: Log) -> None:
    """Refuse a log without motion, or without a force that makes it."""
    if not np.ptp(log.force_N[np.isfinite(log.force_N)]) > 0.0:
        allowed = f"a {log.units.push} that changes: what moves an axis does"
        column = f"column {log.units.named('force_N')}, every row"
        raise InputError(log.source or "log", column, float(log.force_N[0]), allowed)
    position = log.position_m[np.isfinite(log.position_m)]
    steps = np.abs(np.diff(position))
    step = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0
    travel = float(np.ptp(position)) if len(position) else 0.0
    unit = log.units.position
    if travel <= LEAST_TRAVEL * step and travel <= LEAST_TRAVEL * float(np.std(np.diff(position))):
        raise InputError(
            log.source or "log",
            f"column {log.units.named('position_m')}",
            f"a range of {travel:.3g} {unit}, {step:.3g} {unit} from sample to sample",
            f"a log in which the axis moves ({MOVES['speeds']}; {MOVES['loops']})",
        )


def _check_dissipates(records: Records) -> None:
    """Refuse logs in which friction drives the axis: nothing passive does. The one in which it does most is named."""
    rows, units = records.rows, records.machine.plant.units
    power = np.where(rows.used, rows.friction * rows.velocity, 0.0)
    shares = [part.sum() for part in np.split(power, np.cumsum([motion.rows for motion in records.coarse])[:-1])]
    if power.sum() < -DRIVEN * np.abs(power).sum():
        raise InputError(
            records.names[int(np.argmin(shares))],
            f"columns {units.named('position_m')} and {units.named('force_N')}",
            f"{power.sum() / np.count_nonzero(rows.used):.3g} W of friction, which drives the axis",
            f"a {units.push} that alone moves the axis, braked by friction; or {units.inert} that goes with it, not "
            f"{rows.machine.plant.moved:.4g} {units.mass}",
        )


def measure_motion(records: Records, found: ChosenModel) -> Mapping[Measure, float]:
    """Return the excitation of the motion, on the scale of the friction found."""
    fit = found.fit
    content = {
        "law": "switching",
        "stiffness": (np.maximum(fit.levels, 1e-9 * fit.coulomb) / fit.shape.distances).tolist(),
        "fraction": _fractions(fit.levels),
        "coulomb": fit.coulomb,
    }
    machine = make_machine({**records.machine.content, "friction": content}, records.machine.source)
    return measure_excitation(records.rows.signals, machine)


def is_excited(definition: CauseDefinition, measured: Mapping[Measure, float]) -> bool:
    """Return True if a motion can show an effect, as far as that does not depend on its size."""
    return not any(need.times is None for need in definition.excitation.unmet(measured, {}))


def _fractions(levels: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> list[float]:
    shares = np.maximum(levels, 1e-9 * levels.sum())
    return [float(share) for share in shares / shares.sum()]


def state_findings(
    explored: Explored, logs: Sequence[Log], wanted: Wanted
) -> tuple[tuple[Number, ...], list[Statement], float]:
    """Return the numbers of a file, the other statements on the records, and the noise of a row [N].

    A mass that nobody gave and no motion shows is NaN.
    """
    records, views, found, final = explored.records, explored.views, explored.found, explored.final
    fit, given, units = final.fit, wanted.mass, records.machine.plant.units
    seen = final.mass
    choice: tuple[Statement, ...] = ()
    if logs[0].is_friction_alone:
        mass = unknown_mass(given, NO_MASS, units)
    elif given is None and seen is None:
        mass = Number("mass", math.nan, math.nan, Rule.UNSEEN, next=f"{MOVES['jerks']}, or --{units.inert}")
    else:
        # A payload beside the mass that was given does not contradict it.
        stays = seen is None or "mass" not in final.numbers or views.fine.rows.has_payload
        adopted = given if given is not None and stays else seen
        mass_kg = adopted if isinstance(adopted, float) else adopted.value if adopted is not None else math.nan
        mass, choice = mass_number(final, given, mass_kg, units)
    unexcited = list_unexcited(explored.measured)
    numbers: tuple[Number, ...] = (mass, *law_numbers(final, (*unexcited, *explored.unseen)))
    whole = views.fine.rows if records.whole is None else records.whole
    shape = replace(fit.shape, distances=np.maximum(fit.shape.distances, views.fine.limits[0]))  # as in the file
    steps = encoder_forces(views.fine, replace(fit, shape=shape))
    floor = noise_floor(whole, fit.residual, largest_force(whole, steps))
    others = [
        *explored.said,
        *choice,
        *list_limits(numbers, found, final, views.fine, units, unexcited),
        *list_misfit(final.held_out_rms, floor, units),
    ]
    return numbers, others, floor


def describe(
    explored: Explored, logs: Sequence[Log], wanted: Wanted, report: Progress, verb: str = "identify"
) -> Identification:
    """Return the numbers, the file and the statements on both.

    Raises:
        InputError: a mass that nobody gave, and that the motion does not show.
    """
    records, views, found, final = explored.records, explored.views, explored.found, explored.final
    fit, units = final.fit, records.machine.plant.units
    numbers, others, floor = state_findings(explored, logs, wanted)
    if not math.isfinite(numbers[0].value):
        raise InputError(
            name_all(records.names),
            units.inert,
            None,
            f"--{units.inert}: the motion does not show it; or a log with {MOVES['jerks']}, which do",
        )
    law = fit.shape.law
    path = Path(f"{wanted.name}.toml")
    report("weights")
    given_step = records.machine.sampling.position_step
    step = given_step or max(float(f"{encoder_step(readings(log).position_m):.6g}") for log in logs)
    base = override_machine(records.machine, {"sampling": {"position_step": step}})
    refit = None
    if wanted.objective != "force":
        report("motion")
        fixed = {number.name for number in numbers if not math.isfinite(number.std)}
        draft = make_machine(machine_content(base, law, numbers, {}), path)
        refit = refit_motion(draft, logs, wanted.objective, fixed)
        numbers = tuple(
            replace(n, value=refit.values[n.name], std=refit.std[n.name]) if n.name in refit.values else n
            for n in numbers
        )
        others.append(refit.state(units.position))
    friction = float(np.std(views.fine.rows.friction[views.fine.rows.used]))
    left = {"friction_N": friction, "floor_N": floor}
    others += [Statement(Rule.LAW_TOLD, "law", numbers={"law": law})] if found.decided else []
    others.append(Statement(Rule.FITTED, "file", final.held_out_rms, None, units.force, left))
    followed = find_followed(views.fine, fit)
    write = partial(machine_content, base, law, numbers, followed=followed)
    noise = {"measurement": measure_noise(make_machine(write({}), path), logs, followed)}
    noise["colour"] = measure_colour(make_machine(write(noise), path), logs)
    content = write(noise)
    # It says of the axis what no log does; while numbers were fitted, it would have been one of them.
    if wanted.like is not None and "disturbance" in wanted.like.content.get("estimator", {}):
        content["estimator"]["disturbance"] = wanted.like.content["estimator"]["disturbance"]
    to_force = "" if refit is None else f" to the {units.push}"
    head = [
        f"Written by sgms-mhe {verb} over {', '.join(Path(name).name for name in sorted(records.names))}.",
        "Intervals are two standard deviations.",
        f"On blocks that the fit{to_force} had not seen: {others[-1].sentence}.",
        *([f"Of each record its own: {', '.join(units.named(name) for name in followed)}."] if followed else []),
        *(s.advice for s in list_open([*(number.state(units) for number in numbers), *others])),
    ]
    toml = machine_toml(units, content, numbers, head)
    return Identification(
        machine=check_toml(toml, content, path),
        toml=toml,
        law=law,
        law_decided=found.decided,
        numbers=numbers,
        others=tuple(others),
        warnings=(*records.warnings, *list_record_numbers(records.names, views.fine, fit, units)),
        rms_N=fit.rms,
        held_out_rms_N=final.held_out_rms,
        stated_rms_N=final.stated_rms,
        plain_rms_N=explored.plain_rms,
        is_plain=explored.is_plain,
        noise_floor_N=floor,
        friction_rms_N=friction,
        by_count=found.counts,
        sources=records.names,
    )
