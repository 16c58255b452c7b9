"""Numbers of an extended machine that several records determine together, and the diagnosis that states them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sgms_mhe.diagnosis.beginning import refute_by_causes
from sgms_mhe.diagnosis.causes import find_vague
from sgms_mhe.diagnosis.extension import extend_machine
from sgms_mhe.diagnosis.fits import report_name
from sgms_mhe.diagnosis.joint_fit import JointFit, JointPoint
from sgms_mhe.diagnosis.numbers import friction_changes, state_number
from sgms_mhe.diagnosis.own_numbers import OwnDifference
from sgms_mhe.diagnosis.parametrisation import JacobianColumn, ParameterGroup
from sgms_mhe.diagnosis.parts import Cause
from sgms_mhe.diagnosis.record_fit import RecordFit
from sgms_mhe.diagnosis.result import Diagnosis
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import BASE_CAUSES, effect_definition
from sgms_mhe.recordings.output_error import Objective, refit_motion
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.arrays import Array, Mask

Numbers = Mapping[ParameterGroup, Mapping[str, float]]


def find_common(found: Diagnosis, fit: RecordFit, causes: Sequence[Cause]) -> Mask:
    """Return the numbers (n_p) that the records have in common: those that a diagnosis changed, but for other causes.

    Numbers of a record are not among them.
    """
    labels, named = {cause.label for cause in causes}, {cause.label for cause in found.causes}
    own = fit.free()
    return np.array(
        [
            not alone
            and not column.frozen
            and not column.group.is_candidate
            and (column.group.name not in named or column.group.name in labels)
            and _is_changed(found.machine, column)
            for column, alone in zip(fit.model.columns, own.tolist(), strict=True)
        ],
        dtype=np.bool_,
    )


def _is_changed(file: Machine, column: JacobianColumn) -> bool:
    """Return True if a number of an extended machine is not that of the file."""
    return not math.isclose(column.si(column.machine_theta), state_number(file, column), rel_tol=1e-12)


def find_contradicted(file: Machine, joint: JointFit, at: JointPoint) -> Mask:
    """Return the numbers (n_p) whose mean over the records is farther from one of them than that of the file, or none.

    Args:
        file: machine that was diagnosed.
        joint: fit of its extended machine to all records.
        at: minimum.
    """
    columns, thetas = joint.members[0].fit.model.columns, np.array([point.theta for point in at.points])
    stated = [column.theta(state_number(file, column)) for column in columns]
    none = np.where(np.isfinite(stated), stated, [column.theta(column.none) for column in columns])
    return np.asarray(np.any(np.abs(thetas - joint.numbers(at)) > np.abs(thetas - none), axis=0))


def theta_without(fit: RecordFit, cause: Cause) -> Array:
    """Return the numbers (n_p) of a machine without one of its causes: the file's, or of an effect sizes of none."""
    theta = fit.theta.copy()
    for i, column in enumerate(fit.model.columns):
        group = column.group
        if group.is_candidate or group.name != cause.label:
            continue
        if cause.nominal:
            theta[i] = column.theta(cause.nominal[report_name(group, column.name)])
        elif effect_definition(group.cause).parameter(column.name).is_size:
            theta[i] = column.theta(column.none)
    return theta


def drop_causes(fit: RecordFit, causes: Sequence[Cause], kept: Sequence[Cause]) -> RecordFit:
    """Return a machine along a record without those of its causes that are not kept."""
    labels = {cause.label for cause in kept}
    for cause in causes:
        if cause.label not in labels:
            fit = replace(fit, theta=theta_without(fit, cause))
    return fit


def adopt_numbers(
    found: Diagnosis,
    extended: Machine,
    joint: JointFit,
    at: JointPoint,
    covariance: Array,
    differing: Mask,
    causes: Sequence[Cause],
) -> Diagnosis:
    """Return a diagnosis with the numbers of several records in its causes and in its extended machine.

    A number that differs between the records stays that of the first one, and the extended machine estimates it. Any
    other that each record has of its own is the mean of all.

    Args:
        found: of the first record.
        extended: its extended machine.
        joint: fit of that to all records.
        at: minimum.
        covariance: of the numbers in one record (n_p, n_p).
        differing: numbers (n_p) that differ between the records.
        causes: that the records have in common.
    """
    fit, stopped = joint.members[0].fit, joint.find_stopped(at)
    thetas = np.array([point.theta for point in at.points])
    theta = np.where(differing, thetas[0], joint.numbers(at))
    covariance = covariance + np.diag(np.where(joint.own & ~differing, np.var(thetas, axis=0, ddof=1), 0.0))
    kept = {cause.label for cause in found.causes} - {cause.label for cause in causes}
    values: dict[ParameterGroup, dict[str, float]] = {}
    deviations: dict[ParameterGroup, dict[str, float]] = {}
    for i, column in enumerate(fit.model.columns):
        if column.group.is_candidate or column.group.name in kept:
            continue
        if joint.free[i] and _is_changed(found.machine, column):
            values.setdefault(column.group, {})[column.name] = column.si(float(theta[i]))
            std = math.sqrt(max(float(covariance[i, i]), 0.0)) * abs(column.scale)
            std = math.nan if stopped[i] else std
            deviations.setdefault(column.group, {})[column.name] = std
    differences = tuple(
        OwnDifference(column.group, column.name, tuple(column.si(float(at_record[i])) for at_record in thetas))
        for i, column in enumerate(fit.model.columns)
        if differing[i]
    )
    found = write_numbers(replace(found, differences=differences), extended, values, deviations)
    labels = {one.group.name for one in differences}
    causes = [replace(c, transfers=False if c.label in labels else c.transfers) for c in found.causes]
    result = replace(found, causes=tuple(causes))
    return result if result.is_rough else replace(result, refuted=refute_by_causes(result.causes))


def refit_to_motion(found: Diagnosis, logs: Sequence[Log], objective: Objective) -> Diagnosis:
    """Return a diagnosis whose extended machine has the numbers its motion, or both norms, say.

    They are fitted to the records as the file is run on them. Mass stays: it is the file's, or the force's.
    """
    base = found.extended
    if base is None:
        return found
    refit = refit_motion(base, logs, objective, {"mass"})
    groups = {effect.label: ParameterGroup("own", effect.name, effect.label) for effect in base.effects}
    groups |= {number.name: ParameterGroup("base", name) for name, c in BASE_CAUSES.items() for number in c.numbers}
    values: dict[ParameterGroup, dict[str, float]] = {}
    deviations: dict[ParameterGroup, dict[str, float]] = {}
    for key, value in refit.values.items():
        label, _, name = key.rpartition(".")
        values.setdefault(groups[label or name], {})[name] = value
        deviations.setdefault(groups[label or name], {})[name] = refit.std[key]
    return replace(write_numbers(found, base, values, deviations), refit=refit)


def write_numbers(found: Diagnosis, extended: Machine, values: Numbers, deviations: Numbers) -> Diagnosis:
    """Return a diagnosis with other numbers in its causes and in its extended machine, that one with them."""
    friction = dict((found.changes or {}).get("friction", {}))
    friction |= friction_changes(
        extended, {key: v for group, own in values.items() if group.kind == "base" for key, v in own.items()}
    )
    effects: list[dict[str, Any]] = []
    for effect in extended.effects:
        definition = effect_definition(effect.name)
        own = values.get(ParameterGroup("own", effect.name, effect.label), {})
        known = {**definition.entries(effect.parameters), **own}
        effects.append({"name": effect.name, **(definition.tidy(known) if own else effect.parameters)})
    has_effects = "effects" in (found.changes or {}) or bool(effects)
    machine, changes = extend_machine(
        found.machine,
        [cause.label for cause in found.causes],
        friction,
        effects if has_effects else None,
        extended.plant.moved,
        {name: prior for one in found.differences for name, prior in one.estimated.items()},
    )
    causes = tuple(_state(cause, values, deviations) for cause in found.causes)
    return replace(found, causes=causes, extended=machine, changes=changes)


def _state(cause: Cause, values: Numbers, deviations: Numbers) -> Cause:
    """Return a cause with the numbers of its group, where that has any."""
    group = next((group for group in values if group.name == cause.label), None)
    if group is None:
        return cause
    numbers = {report_name(group, name): value for name, value in values[group].items()}
    stds = {report_name(group, name): value for name, value in deviations[group].items()}
    parameters = {**cause.parameters, **numbers}
    if not cause.nominal:
        parameters = effect_definition(cause.name).tidy(parameters)
    changed = replace(cause, parameters=parameters, std={**cause.std, **stds})
    return replace(changed, vague=find_vague(changed))
