"""Rivals as a report shows them: each in its cause's place, fitted as the causes are that it stands beside."""

from __future__ import annotations

from sgms_mhe.diagnosis.descent import FitError
from sgms_mhe.diagnosis.groups import without_extra, without_group
from sgms_mhe.diagnosis.result import RivalFit
from sgms_mhe.diagnosis.selection import Selection
from sgms_mhe.diagnosis.settling import Settled, split_rms


def rival_fits(settled: Settled, selection: Selection) -> tuple[RivalFit, ...]:
    """What is left with each rival in its cause's place, all else of the selection beside it.

    The fits do not see the held-out blocks, as those behind the causes' gains do not. A rival without a finite model at
    the full rate has none.
    """
    found = []
    for rival in selection.rivals:
        place = next((group for group in selection.causes if group.cause == rival.instead_of), None)
        if place is None:
            continue
        extras = without_extra(selection.fit.extras, place)
        refitted = without_group(selection.refitted, place)
        if rival.group.is_extra:
            extras += (rival.fit.extras[rival.group.index],)
        else:
            refitted = (*without_group(refitted, rival.group), rival.group)
        try:
            fit = settled.fit(extras, refitted=refitted, warm=rival.fit, rows=settled.seen)
        except FitError:
            continue
        left = settled.left(fit)
        seen, held_out = split_rms(left, settled.record)
        found.append(RivalFit(rival.group.cause, rival.instead_of, seen, held_out, left.residual))
    return tuple(found)
