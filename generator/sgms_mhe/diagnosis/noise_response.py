"""What an effect makes of an encoder's noise: a cause explains a force, not noise.

Measured friction holds mass times the acceleration's noise. An effect that answers acceleration can take some of that
out again, a resonance of nearly all of the mass above the frequency from which the acceleration is mostly noise. It
then leaves less on any record, also on one that it was not fitted to.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.diagnosis.subject import Fit, Subject
from sgms_mhe.model.effects import effect_definition
from sgms_mhe.recordings.recording import Recording, chained
from sgms_mhe.recordings.runs import Runs
from sgms_mhe.signals.noise import noise_course, position_noise

Array = NDArray[np.float64]

KEPT: Final = 2  # records with more noise: that of the rows' rate, and the full one
SEED: Final = 20241125
"""Of the noise: the same log gives the same verdict."""
NOISE_SHARE: Final = 0.5
"""Answer to the encoder's noise from which on an effect explains that noise and is none [gain of the effect]: a mass
that is shaken by noise takes noise out of the force."""


def explains_noise(subject: Subject, fit: Fit, gain: float) -> bool:
    """Whether the effect that was added last explains noise: what it takes out of that is most of its gain (RMS) [N].

    Asked of what is about as fast as a sample and of what acts on the acceleration; nothing else follows noise.
    """
    if not fit.extras:
        return False
    added = effect_definition(fit.extras[-1].name)
    if not (added.full_rate or added.inertial):
        return False
    return noise_explained(subject, fit) > NOISE_SHARE * gain


def noise_explained(subject: Subject, fit: Fit) -> float:
    """RMS of what the effect added last takes out of a residual that is the encoder's noise [N].

    A delay makes other noise of it, but not less.
    """
    recording = subject.suited(fit.extras).recording
    numbers = (fit.theta_without(fit.extra_groups[-1:]), fit.theta)
    without, left = (float(np.mean(noise_left(recording, fit, n)[recording.used] ** 2)) for n in numbers)
    return math.sqrt(max(0.0, without - left))


def noise_left(recording: Recording, fit: Fit, theta: Array) -> Array:
    """What the encoder's noise adds to the residual of a fit's model at theta (n_p), (m) [N]."""
    noisy = with_more_noise(recording)
    answers = [fit.model.run(record, theta, derivatives=False)[0] for record in (noisy, recording)]
    return np.asarray(answers[1] - answers[0] - inertial_noise(recording))


def inertial_noise(recording: Recording) -> Array:
    """Force that the encoder's noise makes of the acceleration (m) [N]: as large as what is in measured friction."""
    noise = with_more_noise(recording).signals.acceleration - recording.signals.acceleration
    return recording.reduce(recording.machine.plant.moved * noise)


@lru_cache(maxsize=KEPT)
def with_more_noise(recording: Recording) -> Recording:
    """The record with as much noise of its encoder once more, sent through the chain.

    How much there is, the acceleration tells: of a position behind the chain's filters no difference shows it, and a
    log may bring an acceleration of its own. Where an encoder's steps show and make more, theirs: none at rest, and a
    slow saw where few of them pass.
    """
    signals = recording.signals
    noise = _white_noise(recording)
    counting = recording.noise
    if counting is not None and float(np.mean(counting[:, 2] ** 2)) > float(np.mean(noise[:, 2] ** 2)):
        noise = counting
    noisy = replace(
        signals,
        position=signals.position + noise[:, 0],
        velocity=signals.velocity + noise[:, 1],
        acceleration=signals.acceleration + noise[:, 2],
    )
    return replace(recording, signals=noisy, runs=Runs())


def _white_noise(recording: Recording) -> Array:
    """Noise of position, velocity and acceleration (n, 3), of a position's white one."""
    acceleration = recording.signals.acceleration
    noise = chained(recording.machine, np.random.default_rng(SEED).standard_normal(len(acceleration)))
    unit = position_noise(noise[:, 2])
    size = noise_course(acceleration) / unit if unit > 0.0 else np.zeros(len(acceleration))
    return np.asarray(size[:, None] * noise)
