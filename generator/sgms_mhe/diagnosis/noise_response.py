"""What an effect makes of an encoder's noise: a cause explains a force, not noise.

Measured friction holds mass times the acceleration's noise. An effect that answers acceleration can take some of that
out again, a resonance of nearly all of the mass above the frequency from which the acceleration is mostly noise. It
then leaves less on any record, also on one that it was not fitted to.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from sgms_mhe.diagnosis.subject import Fit, Subject
from sgms_mhe.model.effects import effect_definition
from sgms_mhe.recordings.recording import Recording
from sgms_mhe.recordings.runs import Runs
from sgms_mhe.signals.chain import signals_from_log
from sgms_mhe.signals.logs import Log
from sgms_mhe.signals.noise import position_noise

SEED: Final = 20241125
"""Of the noise: the same log gives the same verdict."""


def explains_noise(subject: Subject, fit: Fit, gain: float) -> bool:
    """Whether the effect that was added last explains noise: its answer to that is most of its gain (RMS) [N].

    Asked of what is about as fast as a sample; what is slower cannot follow noise.
    """
    if not fit.extras or not effect_definition(fit.extras[-1].name).full_rate:
        return False
    return noise_response(subject, fit) > subject.thresholds.noise_answered * gain


def noise_response(subject: Subject, fit: Fit) -> float:
    """RMS of the force that the effect added last makes of the encoder's noise [N]."""
    suited = subject.suited(fit.extras)
    recording = suited.recording
    noisy = with_more_noise(recording)
    without = fit.theta_without(fit.extra_groups[-1:])
    answers = [
        fit.model.run(noisy, numbers, derivatives=False)[0] - fit.model.run(recording, numbers, derivatives=False)[0]
        for numbers in (fit.theta, without)
    ]
    return float(np.std((answers[0] - answers[1])[recording.used]))


def with_more_noise(recording: Recording) -> Recording:
    """The record with as much noise of its encoder once more, sent through the chain.

    How much there is, the acceleration tells: of a position behind the chain's filters no difference shows it, and a
    log may bring an acceleration of its own.
    """
    signals, plant = recording.signals, recording.machine.plant
    n, rate = len(signals), recording.machine.sampling.rate
    white = np.random.default_rng(SEED).standard_normal(n)
    noise = signals_from_log(Log(np.arange(n) / rate, white, np.zeros(n), rate, kind=plant.kind), recording.machine)
    unit = position_noise(noise.acceleration)
    size = position_noise(signals.acceleration) / unit if unit > 0.0 else 0.0
    noisy = replace(
        signals,
        position=signals.position + size * noise.position,
        velocity=signals.velocity + size * noise.velocity,
        acceleration=signals.acceleration + size * noise.acceleration,
    )
    return replace(recording, signals=noisy, runs=Runs())
