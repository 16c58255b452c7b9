"""Noise an encoder, and readings off their stamps, leave in a motion behind the signal chain."""

from typing import Final

import numpy as np

from sgms_mhe.recordings.recording import Recording, filter_position
from sgms_mhe.signals.noise import noise_course, position_noise
from sgms_mhe.support.arrays import Array

SEED: Final = 20241125
"""Of the noise: the same log gives the same verdict."""


def encoder_noise(recording: Recording) -> Array:
    """Noise of position, velocity and acceleration (n, 3), as much as the record's own.

    How much there is, the acceleration tells where it comes from the position: a velocity or an acceleration a log
    brings has noise of its own, which moves no element. Where an encoder's steps show and make more, theirs: none at
    rest, and a slow saw where few of them pass.
    """
    noise, counting = _white_noise(recording), recording.noise
    if counting is not None and float(np.mean(counting[:, 2] ** 2)) > float(np.mean(noise[:, 2] ** 2)):
        return counting
    return noise


def _white_noise(recording: Recording) -> Array:
    """Noise of position, velocity and acceleration (n, 3), of a position's white one."""
    signals = recording.signals
    white = np.random.default_rng(SEED).standard_normal(len(signals))
    if signals.delay == 0.0:  # a log that brings its speeds and friction goes past the chain
        return np.column_stack((noise_course(signals.position) * white, np.zeros((len(white), 2))))
    noise = filter_position(recording.machine, white)
    told, of_noise = signals.acceleration, noise[:, 2]
    if recording.has_own_speeds:  # the same behind the chain, to rounding
        told, of_noise = (np.diff(x, n=2, prepend=(x[0], x[0])) for x in (signals.position, noise[:, 0]))
    unit = position_noise(of_noise)
    size = noise_course(told) / unit if unit > 0.0 else np.zeros(len(white))
    return np.asarray(size[:, None] * noise)
