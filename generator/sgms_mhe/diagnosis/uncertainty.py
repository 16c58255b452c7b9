"""Covariance of the numbers of a fit, and the response of a model to the noise of the encoder.

Measured friction holds mass times the acceleration's noise. An effect that answers acceleration can take some of that
out again, a resonance of nearly all of the mass above the frequency from which the acceleration is mostly noise. It
then leaves less on any record, also on one that it was not fitted to: a cause explains a force, not noise.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Final

import numpy as np

from sgms_mhe.diagnosis.fits import Fit, Subject, prior_information
from sgms_mhe.diagnosis.parametrisation import TIMING, TIMING_MOST
from sgms_mhe.model.effects import effect_definition
from sgms_mhe.recordings.encoder import encoder_noise
from sgms_mhe.recordings.evidence import UNSEEN_ERROR, invert_information, robust_covariance
from sgms_mhe.recordings.recording import Recording, Runs
from sgms_mhe.support.arrays import TINY, Array, Mask
from sgms_mhe.support.parallel import run_parallel

NOISY_CACHED: Final = 2  # records with more noise: that of the rows' rate, and the full one
MOSTLY: Final = 0.5
"""Share of the power of a residual, a floor or an effect's gain, from which on it is said to be the encoder's noise: a
mass that is shaken by noise takes noise out of the force."""
HOLD_TIMING: Final = 0.5
"""Samples that a force may be old or young by, on average, where a drive holds it over a sample."""
FLOOR_SURE: Final = 1.03  # noise floors: what is left beyond is no noise
RUNAWAY: Final = 10.0  # slope over the logarithm of a number of the machine, over the largest friction


def explains_noise(subject: Subject, fit: Fit, gain: float) -> bool:
    """Return True if the effect added last explains noise: that is most of its gain (RMS) [N].

    For effects about as fast as a sample and effects on the acceleration; no other one follows noise.
    """
    if not fit.effects:
        return False
    added = effect_definition(fit.effects[-1].name)
    if not (added.full_rate or added.inertial):
        return False
    return find_explained_noise(subject, fit) ** 2 > MOSTLY * gain**2


def find_explained_noise(subject: Subject, fit: Fit) -> float:
    """RMS explained by the effect added last in a residual of the encoder's noise [N].

    A delay makes other noise of it, but not less.
    """
    recording = subject.choose_rate(fit.effects).recording
    numbers = (fit.theta_without(fit.candidate_groups[-1:]), fit.theta)
    without, left = (float(np.mean(noise_residual(recording, fit, n)[recording.used] ** 2)) for n in numbers)
    return math.sqrt(max(0.0, without - left))


def noise_residual(recording: Recording, fit: Fit, theta: Array) -> Array:
    """Return the encoder's noise in the residual of a fit's model at theta (n_p), (m) [N]."""
    noisy = add_noise(recording)
    answers = [fit.model.run(record, theta, derivatives=False)[0] for record in (noisy, recording)]
    return np.asarray(answers[1] - answers[0] - inertial_noise(recording))


def inertial_noise(recording: Recording) -> Array:
    """Force the encoder's noise makes of the acceleration (m) [N]: as large as in measured friction."""
    noise = add_noise(recording).signals.acceleration - recording.signals.acceleration
    return recording.reduce(recording.inertia * noise)


@lru_cache(maxsize=NOISY_CACHED)
def add_noise(recording: Recording) -> Recording:
    """The record with as much noise of its encoder once more, sent through the chain."""
    signals = recording.signals
    noise = encoder_noise(recording)
    noisy = replace(
        signals,
        position=signals.position + noise[:, 0],
        velocity=signals.velocity + noise[:, 1],
        acceleration=signals.acceleration + noise[:, 2],
    )
    return replace(recording, signals=noisy, runs=Runs())


@dataclass(frozen=True, eq=False)
class NumberErrors:
    """Errors of the free numbers of a fit (free).

    Attributes:
        information: joint one of the used rows and priors (free, free).
        noise: covariance by noise, and by the model's error here or there (free, free).
        shifts: changes the same error makes in every record (k, free): by the law, by the encoder's noise, by its
            steps.
        timing: deviation of numbers that are a time between force and position (free).
    """

    information: Array
    noise: Array
    shifts: Array
    timing: Array

    @property
    def covariance(self) -> Array:
        """Return the covariance of all of them (free, free)."""
        return np.asarray(self.noise + self.shifts.T @ self.shifts + np.diag(self.timing**2))


def find_errors(subject: Subject, fit: Fit, other: Subject | None = None) -> NumberErrors:
    """Return the errors of the free numbers of a fit; see `covariance`."""
    recording = subject.recording
    X, H = _inform(subject, fit)
    inverse = invert_information(H)
    wrong = math.sqrt(max(0.0, fit.cross_rms**2 - (FLOOR_SURE * subject.noise) ** 2))
    inner = robust_covariance(recording, X, fit.residual, H, inverse, max(wrong, UNSEEN_ERROR * subject.noise))
    shifts = (
        _law(subject, fit, other, inverse, wrong),
        _noise(subject, fit, inverse),
        _shift_by_steps(subject, X, inverse),
    )
    return NumberErrors(H, inner, np.array(shifts), _timing(subject, fit)[fit.free])


def covariance(subject: Subject, fit: Fit, other: Subject | None = None) -> Array:
    """Covariance of theta (n_p, n_p), 0 where not free.

    Noise and the model's error anywhere (`robust_covariance`): its RMS beyond the noise floor, or UNSEEN_ERROR
    of that, which it may hide; the law's error, alike at every reversal (`_law`); the effect of the encoder's
    noise (`_noise`) and its steps (`_shift_by_steps`) on the numbers; and of a delay or lag, the timing of force
    against position no log is sure of.

    Args:
        subject: machine and record of the fit.
        fit: (n_p).
        other: the same axis with the other transition from sticking to slipping; None: it has none.
    """
    result = np.zeros((len(fit.theta), len(fit.theta)))
    result[np.ix_(fit.free, fit.free)] = find_errors(subject, fit, other).covariance
    return result


def _inform(subject: Subject, fit: Fit) -> tuple[Array, Array]:
    """Return the derivatives of a fit in its free numbers (m, free), and the joint information (free, free)."""
    X = np.where(_is_smooth(subject, fit, fit.jacobian)[:, None], fit.jacobian[:, fit.free], 0.0)
    # Of a number far beyond the file's, the file's is no scale: what the record does not show, nothing does.
    own = np.array([not c.group.is_candidate for c in fit.model.columns])
    sizes = np.where(own, np.maximum(1.0, np.abs(fit.theta)), 1.0)[fit.free]
    prior = np.diag(prior_information(subject, fit.model, fit.free) / sizes**2)
    return X, X[subject.recording.used].T @ X[subject.recording.used] + prior


def correlate(subject: Subject, fit: Fit, covariance: Array) -> Array:
    """Return a covariance (n_p, n_p) of the same deviations, its correlations those of the joint information.

    That of `covariance` has other ones: it states single numbers, each no surer than several errors allow.
    """
    _, H = _inform(subject, fit)
    inverse = invert_information(H)
    unit = np.sqrt(np.maximum(np.diag(inverse), TINY))
    deviations = np.sqrt(np.diag(covariance))[fit.free]
    result = np.zeros_like(covariance)
    result[np.ix_(fit.free, fit.free)] = inverse / np.outer(unit, unit) * np.outer(deviations, deviations)
    return result


def _timing(subject: Subject, fit: Fit) -> Array:
    """Deviation of each number that is a time between force and position (n_p), 0 of others.

    Anywhere within their possible shift for other reasons: a uniform distribution. Of a delay of the axis it is
    the delay by a drive that holds its force; a smaller one is that itself, and known as well as it is seen.
    """
    step = subject.whole.machine.sampling.step
    deviations = []
    for column, theta in zip(fit.model.columns, fit.theta.tolist(), strict=True):
        of_axis = abs(column.si(theta)) > TIMING_MOST * step
        apart = (HOLD_TIMING if of_axis else TIMING) * step / math.sqrt(3.0)
        deviations.append(apart / abs(column.scale) if column.timing else 0.0)
    return np.array(deviations)


def standard_deviations(covariance: Array, fit: Fit) -> list[float]:
    """Return the standard deviation of each number of a fit, SI; NaN where it was not fitted."""
    return [
        math.sqrt(float(covariance[i, i])) * abs(column.scale) if fit.free[i] else math.nan
        for i, column in enumerate(fit.model.columns)
    ]


def _is_smooth(subject: Subject, fit: Fit, jacobian: Array) -> Mask:
    """Rows (m) whose slopes (m, n_p) give the effect of a change of a fit's numbers.

    Where elements let go or a gap opens again and again along a short way, a derivative grows with every time, far
    beyond any real change: no friction changes by many times itself where a number of the machine changes by
    as much as it is. By as much as the file's would be no scale: of a stiffness that is gone each slope is large.
    """
    own = [c.group.kind == "base" for c in fit.model.columns]
    most = RUNAWAY * float(np.max(np.abs(subject.recording.friction[subject.recording.used])))
    return np.asarray((np.abs(jacobian[:, own] * fit.theta[own]) <= most).all(axis=1))


def _noise(subject: Subject, fit: Fit, inverse: Array) -> Array:
    """Return the covariance of the free parameters by noise in their signals (free).

    Noise of an acceleration is in the measured force and in a mass's slope alike, so that they go together where
    nothing moved (errors in variables): it makes a mass 0.4 % of all that moves too small where it has 0.4 % of the
    acceleration's power. No average over blocks sees that either. As much noise once more says how much.
    """
    recording = subject.choose_rate(fit.effects).recording
    (_, jacobian), (_, own) = (fit.model.run(record, fit.theta) for record in (add_noise(recording), recording))
    if jacobian is None or own is None or not np.all(np.isfinite(jacobian)):
        return np.zeros(len(inverse))
    told = recording.used & _is_smooth(subject, fit, fit.jacobian) & _is_smooth(subject, fit, jacobian)
    apart = (jacobian - own)[told][:, fit.free]
    return np.asarray(inverse @ (apart.T @ noise_residual(recording, fit, fit.theta)[told]))


def _shift_by_steps(subject: Subject, X: Array, inverse: Array) -> Array:
    """Return the change of the free parameters by the force the encoder's steps leave, of X (m, free).

    Where elements stick a step is a force, and the elements' trajectory between the steps comes out too smooth, at
    every reversal the same way: no average over blocks sees that. Other lines do as much once more.
    """
    if subject.encoder is None:
        return np.zeros(len(inverse))
    used = subject.recording.used
    return np.asarray(inverse @ (X[used].T @ subject.encoder[used]))


def _law(subject: Subject, fit: Fit, other: Subject | None, inverse: Array, wrong: float) -> Array:
    """Return the bias of the free parameters because the axis does not slip by the law (free).

    An axis switches, a law is smooth, and the difference comes back at every reversal: no average over blocks sees it.
    It acts on each number as a change of the law does: the other transition's friction minus this one's is
    split into the part explained by the free parameters, which moves them, and the rest. As much of the latter as
    the residual has beyond noise (`wrong` [N]), so much of the former is in the numbers.
    """
    nothing = np.zeros(len(inverse))
    if other is None:
        return nothing
    used = subject.recording.used
    theirs, own = run_parallel([partial(law.whole.friction, fit) for law in (other, subject)])
    change = theirs[used] - own[used]
    if not np.all(np.isfinite(change)):
        return nothing
    X = fit.jacobian[used][:, fit.free]
    moved = inverse @ (X.T @ change)
    left = float(np.sqrt(np.mean((change - X @ moved) ** 2)))
    return np.asarray(moved * min(1.0, wrong / left)) if left > 0.0 else nothing
