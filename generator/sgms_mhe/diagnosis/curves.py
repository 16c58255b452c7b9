"""A curve over speed of any shape, where those that are known leave one.

Friction over speed of one form is nearly a sum of others, so that a curve that may have any would fit in the place of
each of them. It is looked for when the search has ended, and only where the residual is still a curve over speed; it
then has to gain beside none of the known curves more than they could together.
"""

import math
from dataclasses import replace
from functools import partial

from sgms_mhe.diagnosis.candidates import make_motion
from sgms_mhe.diagnosis.criteria import Criteria, is_ruled_out, make_effect
from sgms_mhe.diagnosis.fits import Fit, Subject, try_fit
from sgms_mhe.diagnosis.proposals import Residual, propose
from sgms_mhe.diagnosis.structure import leaves_curve
from sgms_mhe.model.effects import cause, effect_definition
from sgms_mhe.model.effects.motion import shift_to_sample
from sgms_mhe.model.effects.search import CurveColumns
from sgms_mhe.recordings.evidence import EQUAL_T, difference_statistic
from sgms_mhe.support.decisions import log_decision


def fit_curve(subject: Subject, fit: Fit, criteria: Criteria) -> Fit | None:
    """Return the fit with a curve of any shape in place of the known ones; None where that gains nothing."""
    known = {effect.name for effect in fit.effects} | {effect.name for effect in subject.machine.effects}
    names = [name for name in criteria.excited if effect_definition(name).any_curve and name not in known]
    here = subject.choose_rate(fit.effects).recording
    if not names or not leaves_curve(here, fit.residual, criteria.floor, criteria.material):
        return None
    others = tuple(effect for effect in fit.effects if not cause(effect.name).over_speed)
    without = try_fit(subject, others, warm=fit)
    if without is None:
        return None
    found = [trial for name in names if (trial := _fit_fewest(subject, without, name, criteria)) is not None]
    best = min(found, key=lambda trial: float(trial.cross.sum()), default=None)
    gain = -math.inf if best is None else best.gain_over(fit)
    t = 0.0 if best is None else difference_statistic(best.cross, fit.cross)
    added = gain > criteria.enough(fit) and t > EQUAL_T
    log_decision(
        "curve",
        "curve of any shape in place of the known ones: leaves clearly less on unseen rows",
        effects=[effect.name for effect in fit.effects],
        beside=[effect.name for effect in others],
        parameters=None if best is None else dict(best.effects[-1].parameters),
        gain_N=gain,
        t=t,
        least_gain_N=criteria.enough(fit),
        added=added,
    )
    return best if added else None


def _fit_fewest(subject: Subject, without: Fit, name: str, criteria: Criteria) -> Fit | None:
    """Return the fit with a curve of the fewest numbers than which no more gain on unseen rows; None: there is none."""
    definition = effect_definition(name)
    kind, recording = definition.search, subject.choose_rate(without.effects).recording
    if not isinstance(kind, CurveColumns):
        return None
    motion = make_motion(recording, without)
    step = subject.machine.sampling.step
    motion = replace(motion, velocity=shift_to_sample(motion.velocity, motion.acceleration, step))
    free = without.find_nuisance(recording.used)
    seen = Residual(recording, motion, free, free.project(without.residual[recording.used]))
    best: Fit | None = None
    for given in kind.grid(motion):
        Z = seen.columns(kind.columns(motion, given))
        proposal = propose(definition, seen, Z, kind.tests, partial(kind.parameters, given))
        trial = try_fit(subject, (*without.effects, make_effect(proposal)), warm=without)
        if trial is None or is_ruled_out(trial, name, subject):
            continue
        if best is None or trial.gain_over(best) > criteria.material:
            best = trial
    return best
