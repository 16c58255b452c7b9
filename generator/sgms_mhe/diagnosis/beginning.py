"""Beginning of a diagnosis: the machine file's numbers, or where the record refutes them those of the record."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from sgms_mhe.configuration import override_machine
from sgms_mhe.diagnosis.final_fit import FinalFit
from sgms_mhe.diagnosis.fits import Fit
from sgms_mhe.diagnosis.numbers import friction_changes
from sgms_mhe.diagnosis.parametrisation import drop_bounds
from sgms_mhe.diagnosis.parts import Cause, PlainFriction, RefutedNumber
from sgms_mhe.diagnosis.uncertainty import covariance
from sgms_mhe.identification.description import identified_effects
from sgms_mhe.identification.elements import NO_RISE, SLOW_STEP, least_distance
from sgms_mhe.identification.final_fit import CERTAIN, contradicts_mass
from sgms_mhe.identification.fits import NumberEstimate
from sgms_mhe.identification.identify import Explored, explore_recording
from sgms_mhe.identification.search import LEAST_SHARE, element_numbers
from sgms_mhe.machine import Machine, plant_content
from sgms_mhe.model.effects import base_number, effect_definition, mass_effect
from sgms_mhe.model.effects.base import DAMPING, LEVEL, MASS, reported_name
from sgms_mhe.recordings.evidence import noise_floor
from sgms_mhe.recordings.recording import Recording
from sgms_mhe.support.arrays import Array, Mask
from sgms_mhe.support.decisions import log_decision
from sgms_mhe.support.errors import InputError

ROUGH: Final = 2.0
"""Distance of a file's numbers from those of the record from which on the file is rough, see `distance` [1]: a factor
of e in two of them, or of e^2 in one. A single number that is wrong by less is a cause."""
STEP: Final = 1e-6
"""Step of a scaled number by which a derivative is taken [1]."""
BREAK_AWAY: Final = "break_away_m"
"""Name of the distance after a reversal until elements slide, their mean by share: comparable whatever their number."""


@dataclass(frozen=True, eq=False)
class RecordStart:
    """Numbers of the record to begin from.

    Attributes:
        machine: the file's, with the numbers the record has of friction and of effects that identification knows;
            where the file's mass is refuted, with the record's, and an effect that leaves it open.
        mass: of the motion; None: the file's stays.
    """

    machine: Machine
    mass: NumberEstimate | None


def plain_friction(recording: Recording) -> PlainFriction:
    """Return the residual of Coulomb and viscous friction: least squares with the mass and an offset.

    Fitted to the blocks the fit behind a reported gain sees.
    """
    velocity, held_out = recording.velocity, recording.rows_held_out()
    X = np.column_stack((recording.acceleration, np.ones(len(velocity)), velocity, np.sign(velocity)))
    seen = recording.used & ~held_out
    scale = np.sqrt(np.mean(X[seen] ** 2, axis=0)) + 1e-300
    b = np.linalg.lstsq(X[seen] / scale, recording.friction[seen], rcond=1e-9)[0]
    residual = recording.friction - (X / scale) @ b
    return PlainFriction(_rms(residual, seen), _rms(residual, held_out), _rms(recording.force, held_out))


def _rms(series: Array, rows: Mask) -> float:
    return float(np.sqrt(np.mean(series[rows] ** 2))) if rows.any() else math.nan


def begin_from_record(
    recording: Recording, nominal: Fit, report: Callable[[str], None], *, has_force: bool
) -> RecordStart | None:
    """Return the numbers of the record where they refute the file's; None where the file's are a beginning.

    They are identified only where the file's are far from those of a convex fit: of a file that is not, a diagnosis
    finds the errors.

    Args:
        recording: decimated samples of the log.
        nominal: the machine as its file has it.
        report: called with each step.
        has_force: whether the drive's force was logged; friction alone says nothing of a mass.
    """
    quick = element_numbers(recording, noise_floor(recording, nominal.residual))
    if not quick:
        return None
    found = recording.machine.friction.model_copy(update=friction_changes(recording.machine, quick))
    numbers = _compare_friction(recording.machine, found.coulomb, found.mean_break_away, found.viscous)
    apart = distance(numbers, mean_speed(recording))
    log_decision(
        "beginning",
        "a file far from the numbers of a convex fit is compared with the record's",
        distance=apart,
        rough_from=ROUGH,
        numbers=quick,
    )
    if not apart > ROUGH:
        return None
    return identify_start(recording, recording.machine, None, report, has_force=has_force)


def identify_start(
    recording: Recording, file: Machine, mass: NumberEstimate | None, report: Callable[[str], None], *, has_force: bool
) -> RecordStart | None:
    """Return the numbers that identification finds along a record where the file's are far from them, else None.

    Args:
        recording: decimated samples of the log.
        file: the machine file.
        mass: of the recording's machine, where it is that of the motion; None: it is the file's.
        report: called with each step.
        has_force: as of `begin_from_record`.
    """
    try:
        explored = explore_recording(recording, report)
    except InputError as error:
        log_decision("beginning", "file stays: identification refuses the record", reason=str(error))
        return None
    shown = explored.final.mass
    if has_force and shown is not None and (mass is not None or contradicts_mass(file.plant.moved, shown)):
        mass = shown
    apart = distance(_compare(file, explored, mass), mean_speed(recording))
    log_decision(
        "beginning",
        "numbers of the record where the file's are far from them",
        distance=apart,
        rough_from=ROUGH,
        numbers={name: (number.value, number.std) for name, number in explored.final.numbers.items()},
    )
    return _start(file, explored, mass) if apart > ROUGH else None


def _resolved_friction(explored: Explored, file: Machine) -> dict[str, Any]:
    """Friction that was identified, its elements no stiffer than the file's law tells apart between two samples.

    An exploration may have found elements that switch, and those may break away within any distance.
    """
    rise = explored.final.fit.shape.rise or NO_RISE
    return explored.friction_from(least_distance(file.friction.law, rise, file.sampling.rate))


def distance(numbers: Sequence[RefutedNumber], speed: float) -> float:
    """Sum of the differences between a file's numbers and those of a record, beyond two deviations of these [1].

    Logarithms of the ratios of level, break-away distance and mass; of damping, which may be 0, the change of the mean
    force over the level.

    Args:
        numbers: of both, the level among them; others than these four do not count.
        speed: mean speed of the record [m/s].
    """
    level = next(number.record for number in numbers if number.name == reported_name(LEVEL))
    total = 0.0
    for number in numbers:
        low, high = number.record - 2.0 * number.std, number.record + 2.0 * number.std
        if low <= number.file <= high:
            continue
        nearest = high if number.file > high else low
        if number.name in (reported_name(LEVEL), BREAK_AWAY, MASS):
            total += abs(math.log(number.file / max(nearest, LEAST_SHARE * number.record)))
        elif number.name == reported_name(DAMPING):
            total += abs(number.file - nearest) * speed / level
    return total


def mean_speed(recording: Recording) -> float:
    """Mean speed over used rows [m/s]."""
    return float(np.mean(np.abs(recording.velocity[recording.used])))


def _compare_friction(file: Machine, level: float, reach: float, damping: float) -> tuple[RefutedNumber, ...]:
    """Level, mean break-away distance and damping of a file beside a record's; how sure these are, is not known."""
    friction = file.friction
    return (
        RefutedNumber(reported_name(LEVEL), friction.coulomb, level, 0.0),
        RefutedNumber(BREAK_AWAY, friction.mean_break_away, reach, 0.0),
        RefutedNumber(reported_name(DAMPING), friction.viscous, damping, 0.0),
    )


def _compare(file: Machine, explored: Explored, mass: NumberEstimate | None) -> tuple[RefutedNumber, ...]:
    """Numbers of a file beside those that were identified; how sure these are, a diagnosis will say."""
    fit, numbers = explored.final.fit, explored.final.numbers
    damping = numbers[DAMPING].value if DAMPING in numbers else 0.0
    found = _compare_friction(file, fit.coulomb, float(fit.levels @ fit.shape.distances) / fit.coulomb, damping)
    return found if mass is None else (*found, RefutedNumber(MASS, file.plant.moved, mass.value, mass.std))


def _start(file: Machine, explored: Explored, mass: NumberEstimate | None) -> RecordStart:
    """Return the numbers of an exploration to begin from; `mass`: of the motion, None: the file's stays."""
    changes: dict[str, Any] = {"friction": _resolved_friction(explored, file)}
    if file.sampling.integrator.scheme == "flow":
        # Steps of fits leave room for stiffness that is wrong by far; what identification found needs none.
        changes["sampling"] = {"integrator": {"slow_displacement": SLOW_STEP}}
    if file.effects:
        units, known = file.plant.units, identified_effects(explored.final.fit)
        changes["effects"] = [
            {**e.entry(units), **units.keyed(effect_definition(e.name).lists(known.get(e.name, {})))}
            for e in file.effects
        ]
    if mass is not None:
        changes["plant"] = plant_content(file.plant.kind, mass.value)
        free, _ = mass_effect()
        if all(effect.name != free for effect in file.effects):  # the mass is open, as the other numbers are
            changes["effects"] = [*changes.get("effects", ()), {"name": free}]
    return RecordStart(override_machine(drop_bounds(file), changes), mass)


def compare_numbers(file: Machine, start: RecordStart, final: FinalFit, fit: Fit) -> tuple[RefutedNumber, ...]:
    """Return the numbers of a file beside those of a fit of all of them."""
    cov, values = covariance(final.subject, fit, final.other), fit.theta
    columns = fit.model.columns
    deviations = np.sqrt(np.maximum(np.diag(cov), 0.0)) * np.array([abs(c.scale) for c in columns])
    effects = {effect.label: effect_definition(effect.name).entries(effect.parameters) for effect in file.effects}
    found = []
    for column, theta, std in zip(columns, values.tolist(), deviations.tolist(), strict=True):
        number = base_number(column.name) if column.group.kind == "base" else None
        if column.group.is_candidate or (number is not None and number.array):
            continue
        value, name = column.si(theta), column.name
        if column.group.kind == "own" and column.group.label not in effects:
            stated, name, value = file.plant.moved, MASS, start.machine.plant.moved + value
        elif column.group.kind == "own":
            if column.frozen:
                continue
            stated, name = effects[column.group.label][name], f"{column.group.label}.{name}"
        else:
            stated, name = float(getattr(file.friction, name)), reported_name(name)
        found.append(RefutedNumber(name, stated, value, std))
    found.append(_break_away_of_fit(final, fit, cov, file.friction.mean_break_away))
    return tuple(found)


def list_refuted(numbers: Sequence[RefutedNumber]) -> tuple[RefutedNumber, ...]:
    """Return the numbers that differ significantly from the record's."""
    return tuple(n for n in numbers if n.std > 0.0 and abs(n.record - n.file) > CERTAIN * n.std)


def _break_away_of_fit(final: FinalFit, fit: Fit, cov: Array, stated: float) -> RefutedNumber:
    """Return the mean break-away distance of a fit beside the file's, by the covariance of its numbers."""
    columns, machine = fit.model.columns, final.subject.machine
    places = {c.name: i for i, c in enumerate(columns) if c.group.kind == "base"}

    def distance_at(theta: Array) -> float:
        values = {name: columns[i].si(float(theta[i])) for name, i in places.items()}
        changed = friction_changes(machine, values)
        return machine.friction.model_copy(update=changed).mean_break_away

    gradient, here = np.zeros(len(columns)), distance_at(fit.theta)
    for i in places.values():
        moved = fit.theta.copy()
        moved[i] += STEP * max(1.0, abs(moved[i]))
        gradient[i] = (distance_at(moved) - here) / (moved[i] - fit.theta[i])
    return RefutedNumber(BREAK_AWAY, stated, here, math.sqrt(max(float(gradient @ cov @ gradient), 0.0)))


def refute_by_causes(causes: Sequence[Cause]) -> tuple[RefutedNumber, ...]:
    """Return the numbers of a file that named causes replace."""
    numbers = [
        RefutedNumber(key, cause.nominal[key], value, cause.std[key])
        for cause in causes
        if cause.nominal
        for key, value in cause.parameters.items()
    ]
    return list_refuted(numbers)
