"""Fit of a machine to several records: numbers of the axis are common, numbers of a record free in each."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Final

import numpy as np

from sgms_mhe.diagnosis.alignment import find_encoder_force
from sgms_mhe.diagnosis.fits import FINAL_STEP, ITERATIONS, MACHINE_PRIOR, Fit, Subject, find_at_bounds
from sgms_mhe.diagnosis.models import FitError, LeastSquares, ModelPoint, Prior
from sgms_mhe.diagnosis.parametrisation import bounds, step_limit
from sgms_mhe.diagnosis.record_fit import RecordFit, shift_position
from sgms_mhe.diagnosis.uncertainty import find_errors
from sgms_mhe.recordings.evidence import invert_information
from sgms_mhe.recordings.least_squares import Box, Quadratic, minimise
from sgms_mhe.support.arrays import Array, Index, Mask
from sgms_mhe.support.parallel import run_parallel

ORIGIN_STEPS: Final = 16
"""Steps of its derivative that an origin may move by, either way [1]: an eighth of the shortest period."""


@dataclass(frozen=True, eq=False)
class Member:
    """A record of a joint fit.

    Attributes:
        fit: the machine along it, in line with the model; its `theta` (n_p) is where the fit starts.
        origin_step: step the derivative in the origin of its position is taken by [m]; 0: the origin is known.
    """

    fit: RecordFit
    origin_step: float = 0.0


@dataclass(frozen=True, eq=False)
class JointPoint:
    """A machine along the records (K) at some numbers.

    Attributes:
        points: model and numbers of each.
        origins: shifts of the position's origin (K) [m].
        slopes: derivative of its friction in that (m) [N/m]; None: the origin is known.
        cost: sum of squares and prior.
    """

    points: tuple[ModelPoint, ...]
    origins: Array
    slopes: tuple[Array | None, ...]
    cost: float


@dataclass(frozen=True, eq=False)
class JointFit:
    """Sum of squared residuals over several records.

    Attributes:
        members: records along the same machine.
        common: numbers (n_p) that are fitted and the same in all.
        own: numbers (n_p) fitted in each.
    """

    members: tuple[Member, ...]
    common: Mask
    own: Mask

    @cached_property
    def free(self) -> Mask:
        """Numbers (n_p) that are fitted."""
        return np.asarray(self.common | self.own)

    @cached_property
    def places(self) -> tuple[Index, ...]:
        """Places of each record's free numbers, and of its origin where that is free, in a joint step."""
        shared, count = self.common[self.free], int(self.common.sum())
        found = []
        for member in self.members:
            place = np.empty(len(shared), dtype=np.int64)
            place[shared] = np.arange(int(self.common.sum()))
            place[~shared] = np.arange(count, count + int(np.sum(~shared)))
            count += int(np.sum(~shared))
            if member.origin_step > 0.0:
                place = np.append(place, count)
                count += 1
            found.append(place)
        return tuple(found)

    @property
    def size(self) -> int:
        """Number of the free numbers of all records."""
        return 1 + max((int(place.max()) for place in self.places if len(place)), default=-1)

    @property
    def count(self) -> int:
        """Residual rows."""
        return sum(int(member.fit.subject.recording.used.sum()) for member in self.members)

    @cached_property
    def _information(self) -> Array:
        """Information of the prior of the common numbers, as in the fit of one record."""
        noise = max(member.fit.subject.noise for member in self.members)
        return np.full(int(self.common.sum()), (noise / MACHINE_PRIOR) ** 2)

    def descend(self) -> JointPoint:
        """Minimise from the members' numbers.

        Raises:
            FitError: a model is not finite there.
        """
        here = self._at([member.fit.theta for member in self.members], np.zeros(len(self.members)))
        if not math.isfinite(here.cost):
            raise FitError("the model is not finite where the fit of several records starts")
        if self.size == 0:
            return here
        return minimise(self, here, partial(self._box, here), ITERATIONS, FINAL_STEP)

    def quadratic(self, here: JointPoint) -> Quadratic:
        """Return the quadratic model of the cost about a point."""
        size, information = self.size, self._information
        H, g, binding = np.zeros((size, size)), np.zeros(size), np.zeros(size)
        binding[: len(information)] = information
        for member, place, point, slope in zip(self.members, self.places, here.points, here.slopes, strict=True):
            used = member.fit.subject.recording.used
            X = point.jacobian[used][:, self.free]
            if slope is not None:
                X = np.column_stack((X, slope[used]))
            H[np.ix_(place, place)] += X.T @ X
            g[place] += X.T @ point.residual[used]
        if len(information):
            first, start = here.points[0].theta, self.members[0].fit.theta
            g[: len(information)] -= information * (first - start)[self.common]
        return Quadratic(H, g, binding, np.diag(H) + binding)

    def after(self, here: JointPoint, step: Array) -> JointPoint:
        """Return the point a step leads to."""
        thetas, origins = [], here.origins.copy()
        for k, (member, place, point) in enumerate(zip(self.members, self.places, here.points, strict=True)):
            own = int(self.free.sum())
            thetas.append(self._problem(member, 0.0).move(point.theta, step[place[:own]]))
            if len(place) > own:
                origins[k] += step[place[-1]]
        return self._at(thetas, origins)

    def _at(self, thetas: Sequence[Array], origins: Array) -> JointPoint:
        tasks = [
            partial(self._along, member, theta, origin)
            for member, theta, origin in zip(self.members, thetas, origins.tolist(), strict=True)
        ]
        found = run_parallel(tasks)
        moved = (thetas[0] - self.members[0].fit.theta)[self.common]
        cost = sum(point.cost for point, _ in found) + float(self._information @ moved**2)
        return JointPoint(tuple(p for p, _ in found), origins, tuple(slope for _, slope in found), cost)

    def _along(self, member: Member, theta: Array, origin: float) -> tuple[ModelPoint, Array | None]:
        """Return the model along a record at its numbers (n_p) and origin [m], and its derivative in that."""
        point, h = self._problem(member, origin).at(theta), member.origin_step
        if h == 0.0 or not math.isfinite(point.cost):
            return point, None
        recording = member.fit.subject.recording
        beside = [
            member.fit.model.run(shift_position(recording, -at), theta, derivatives=False)[0]
            for at in (origin + h, origin - h)
        ]
        return point, (beside[0] - beside[1]) / (2.0 * h)

    def _problem(self, member: Member, origin: float) -> LeastSquares:
        recording = shift_position(member.fit.subject.recording, -origin)
        none = np.zeros(int(self.free.sum()))
        return LeastSquares(member.fit.model, recording, recording.used, self.free, Prior(none, none, none))

    def _box(self, start: JointPoint, here: JointPoint) -> Box:
        """Return the box of a step, within the limits of every record."""
        lower, upper = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        free = np.flatnonzero(self.free)
        for k, (member, place) in enumerate(zip(self.members, self.places, strict=True)):
            columns, recording = member.fit.model.columns, member.fit.subject.recording
            least, most = (edge[free] - here.points[k].theta[free] for edge in bounds(columns, recording))
            limit = np.array([step_limit(columns[i], float(start.points[k].theta[i]), recording) for i in free])
            moved = here.origins[k : k + len(place) - len(free)]
            reach = np.full(len(moved), ORIGIN_STEPS * member.origin_step)
            lower[place] = np.maximum(lower[place], np.append(np.maximum(least, -limit), -reach - moved))
            upper[place] = np.minimum(upper[place], np.append(np.minimum(most, limit), reach - moved))
        return np.minimum(lower, 0.0), np.maximum(upper, 0.0)

    def fits(self, at: JointPoint) -> tuple[Fit, ...]:
        """Return the fit of each record, the common ones among its free numbers.

        The effect of a free origin is projected out of its Jacobian: the others' information is that beside it.
        """
        found = []
        for member, point, slope in zip(self.members, at.points, at.slopes, strict=True):
            jacobian = point.jacobian
            if slope is not None:
                used = member.fit.subject.recording.used
                share = slope[used] @ jacobian[used] / max(float(slope[used] @ slope[used]), 1e-300)
                jacobian = jacobian - np.outer(slope, share)
            found.append(member.fit.make_fit(replace(point, jacobian=jacobian), self.free))
        return tuple(found)

    def errors(self, at: JointPoint, others: Sequence[Subject | None]) -> Array:
        """Return the covariance of the numbers (n_p, n_p), 0 where they are not fitted.

        Of a common number: noise, which is another one in each record; the errors that are the same in all; and the
        spread between the records, by the change of the numbers each of them asks for. Of one that each record
        has of its own: the mean over records of the covariance in one.

        Args:
            at: minimum.
            others: of each record, the same axis with the other transition from sticking to slipping.
        """
        shared, own, records = self.common[self.free], ~self.common[self.free], len(self.members)
        fits = self.fits(at)
        subjects = [
            replace(member.fit.subject, encoder=find_encoder_force(member.fit.subject, fit))
            for member, fit in zip(self.members, fits, strict=True)
        ]
        errors = [find_errors(*one) for one in zip(subjects, fits, others, strict=True)]
        information = []
        for one in errors:
            H = one.information
            beside = invert_information(H[np.ix_(own, own)])
            information.append(H[np.ix_(shared, shared)] - H[np.ix_(shared, own)] @ beside @ H[np.ix_(own, shared)])
        inverse = invert_information(np.sum(information, axis=0))
        weights = [inverse @ one for one in information]
        joint = np.zeros((len(inverse), len(inverse)))
        shifts = np.zeros((len(errors[0].shifts), len(inverse)))
        for member, fit, one, weight in zip(self.members, fits, errors, weights, strict=True):
            joint += weight @ one.noise[np.ix_(shared, shared)] @ weight.T
            shifts += one.shifts[:, shared] @ weight.T
            used = member.fit.subject.recording.used
            asked = inverse @ (fit.jacobian[used][:, self.common].T @ fit.residual[used])
            if records > 1:
                joint += records / (records - 1) * np.outer(asked, asked)
        joint += shifts.T @ shifts + np.diag(np.max([one.timing[shared] for one in errors], axis=0) ** 2)
        result = np.zeros((len(self.common), len(self.common)))
        result[np.ix_(self.common, self.common)] = joint
        result[np.ix_(self.own, self.own)] = np.mean([one.covariance[np.ix_(own, own)] for one in errors], axis=0)
        return result

    def find_differing(self, at: JointPoint, covariance: Array, matters: float) -> Mask:
        """Return the numbers (n_p) that differ between the records beyond two deviations, by a force that matters.

        Args:
            at: minimum.
            covariance: of the numbers in one record (n_p, n_p).
            matters: RMS of a force that does [N].
        """
        width = np.ptp([point.theta for point in at.points], axis=0)
        used = [member.fit.subject.recording.used for member in self.members]
        forces = [np.sqrt(np.mean(p.jacobian[u] ** 2, axis=0)) for p, u in zip(at.points, used, strict=True)]
        sure = width > 2.0 * np.sqrt(2.0 * np.diag(covariance))
        return np.asarray(self.own & sure & (width * np.mean(forces, axis=0) > matters))

    def find_stopped(self, at: JointPoint) -> Mask:
        """Return the common numbers (n_p) that a bound stops: the records together say that they are beyond."""
        used = [member.fit.subject.recording.used for member in self.members]
        descent = np.sum([p.jacobian[u].T @ p.residual[u] for p, u in zip(at.points, used, strict=True)], axis=0)
        stopped = [
            find_at_bounds(member.fit.model.columns, point.theta, descent, member.fit.subject.recording)
            for member, point in zip(self.members, at.points, strict=True)
        ]
        return np.asarray(self.common & np.any(stopped, axis=0))

    def numbers(self, at: JointPoint) -> Array:
        """Return the numbers (n_p) of the machine: the common ones, and the mean of the records' own."""
        return np.asarray(np.mean([point.theta for point in at.points], axis=0))
