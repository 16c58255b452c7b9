"""Backwards: effects and numbers that a selection can do without."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from sgms_mhe.diagnosis.criteria import Criteria
from sgms_mhe.diagnosis.evidence import gain_force
from sgms_mhe.diagnosis.fitting import fit_model
from sgms_mhe.diagnosis.groups import Group, machine_groups, without_extra, without_group
from sgms_mhe.diagnosis.subject import Fit, Subject
from sgms_mhe.support.parallel import in_parallel

Groups = tuple[Group, ...]


def pruned(
    subject: Subject, fit: Fit, criteria: Criteria, *, refitted: Sequence[Group] | None = None, least: int = 0
) -> Fit:
    """The fit without effects that the others have made superfluous; `least` effects stay.

    `refitted`: groups of the machine's own numbers that are free; None: all.
    """
    while len(fit.extras) > least:
        trials = in_parallel(
            [
                partial(fit_model, subject, without_extra(fit.extras, group), refitted=refitted, warm=fit)
                for group in fit.extra_groups
            ]
        )
        gains = [gain_force(trial.cross, fit.cross, fit.rows) for trial in trials]
        smallest = min(range(len(gains)), key=lambda i: gains[i])
        if gains[smallest] > criteria.material:
            return fit
        fit = trials[smallest]
    return fit


def wrong_numbers(subject: Subject, fit: Fit, criteria: Criteria) -> tuple[Groups, Fit]:
    """Which of the machine's numbers must differ from the file: the fewest groups that leave no material gain.

    Returns them, and the fit with only them free.
    """
    extras, material = fit.extras, criteria.material
    everything = fit_model(subject, extras, warm=fit)
    named: Groups = ()
    current = fit_model(subject, extras, refitted=(), warm=everything)
    while True:
        missing = gain_force(current.cross, everything.cross, fit.rows)
        rest = [group for group in machine_groups(subject.machine) if group not in named]
        if missing < material or not rest:
            break
        fits = in_parallel([partial(fit_model, subject, extras, refitted=(*named, g), warm=everything) for g in rest])
        trials = dict(zip(rest, fits, strict=True))
        best = min(trials, key=lambda group: float(trials[group].cross.sum()))
        if gain_force(current.cross, trials[best].cross, fit.rows) < material:
            break
        named, current = (*named, best), trials[best]
    for group in named:  # an early one may have stood in for later ones
        if len(named) < 2:
            break
        without = without_group(named, group)
        trial = fit_model(subject, extras, refitted=without, warm=current, again=True)
        if gain_force(trial.cross, current.cross, fit.rows) < material:
            named, current = without, trial
    return named, current


def necessary(subject: Subject, fit: Fit, criteria: Criteria) -> tuple[Groups, Fit]:
    """The wrong numbers, and the fit without effects that are superfluous now that those are what they are."""
    refitted, fit = wrong_numbers(subject, fit, criteria)
    return refitted, pruned(subject, fit, criteria, refitted=refitted)
