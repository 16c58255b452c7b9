"""Where the elements' numbers start, whatever the machine file says."""

from __future__ import annotations

from dataclasses import replace

from sgms_mhe.diagnosis.subject import Fit, Subject
from sgms_mhe.identification.starting import element_numbers


def convex_start(subject: Subject, fit: Fit) -> dict[str, float]:
    """Numbers of the machine to start from, by column [SI]: of the friction that a fit's effects do not explain.

    Neither the machine file's numbers nor where the fit stopped matter. Nothing where there is no friction.
    """
    recording = subject.recording
    if fit.extras:
        alone = subject.model(())
        theta = subject.start(alone, (), fit)
        effects = subject.friction(fit) - alone.run(recording, theta, derivatives=False)[0]
        recording = replace(recording, friction=recording.friction - effects)
    columns = {column.name for column in subject.model(()).columns}
    found = element_numbers(recording, subject.noise)
    return {name: value for name, value in found.items() if name in columns}
