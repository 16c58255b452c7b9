"""Words of a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence

from sgms_mhe.diagnosis.fits import report_values
from sgms_mhe.diagnosis.result import Alternative, Cause, Verdict
from sgms_mhe.diagnosis.rivals import Selection
from sgms_mhe.machine import Units
from sgms_mhe.model.effects import cause as cause_definition
from sgms_mhe.model.effects import separating_moves

TWICE = "the same motion twice, and once at half the speed: what stays in place, in time or in velocity shows"
FINER = "the same log with a lower [sampling] velocity_cutoff, or a finer encoder: what is below its noise shows"
PLATEAUS = "constant speeds from the slowest to the fastest, in both directions: friction over speed shows as it is"


def list_alternatives(selection: Selection, units: Units) -> tuple[Alternative, ...]:
    """Return the candidates that were not named, with the reasons; the rivals first."""
    found = [
        Alternative(
            rival.group.cause,
            f"fits as well as {rival.instead_of} on this record",
            True,
            rival.instead_of,
            report_values(rival.fit, rival.group),
            max(0.0, rival.excess_N),
        )
        for rival in selection.rivals
    ]
    # The named causes that have rivals are listed with them.
    for cause in dict.fromkeys(rival.instead_of for rival in selection.rivals):
        others = ", ".join(r.group.cause for r in selection.rivals if r.instead_of == cause)
        found.append(Alternative(cause, f"named; fits as well as {others} on this record", True, None, {}, 0.0))
    taken = {a.name for a in found} | {group.cause for group in selection.causes}
    for name, lost in sorted(selection.rejected.items(), key=lambda entry: entry[1].excess_N):
        if name not in taken:
            taken.add(name)
            instead_of = None if name == lost.instead_of else lost.instead_of
            found.append(Alternative(name, _why_not(selection, name, units), False, instead_of, {}, lost.excess_N))
    for score in selection.scores:
        if score.name not in taken and score.outcome in ("redundant", "too small"):
            taken.add(score.name)
            why = (
                "superfluous beside what is named"
                if score.outcome == "redundant"
                else f"would explain {score.gain_N:.2g} {units.force}, less than matters"
            )
            found.append(Alternative(score.name, why, False, None, dict(score.parameters)))
    return tuple(found)


def _why_not(selection: Selection, name: str, units: Units) -> str:
    """Why a candidate that was put in a cause's place, or was a cause for a while, is none."""
    lost = selection.rejected[name]
    if name in {group.cause for group in selection.unnamed}:
        return "refitted with the causes, no cause of its own"
    if name in selection.inconstant:
        return "its size is not the same all over the record"
    if name == lost.instead_of:
        return "its size, or its gain on data not used in the fit, may be zero"
    return f"in place of {lost.instead_of} leaves {lost.excess_N:.3g} {units.force} more"


def choose_experiment(
    verdict: Verdict, causes: Sequence[Cause], rivals: Sequence[Alternative], noise: float = 0.0
) -> str | None:
    """Return the next motion: the moves that separate causes and rivals; None: nothing. `noise`: as of `summarise`."""
    curved = any(cause.stands_for == "curve over speed" for cause in causes)
    left = FINER if noise > 0.0 else PLATEAUS if curved else TWICE
    moves = [left] if verdict == "unexplained" else []
    for rival in rivals:
        if rival.instead_of is None:
            continue
        told = separating_moves(rival.instead_of, rival.name)[:1]
        wanted = dict.fromkeys(cause_definition(name).excitation.text for name in (rival.instead_of, rival.name))
        moves.append(f"{rival.instead_of} or {rival.name}: {told[0] if told else '; and '.join(wanted)}")
    return ". ".join(moves) if moves else None


def summarise(
    verdict: Verdict,
    causes: Sequence[Cause],
    rivals: Sequence[Alternative],
    before: float,
    after: float,
    units: Units,
    noise: float = 0.0,
    *,
    is_rough: bool = False,
) -> str:
    """One sentence.

    Args:
        verdict: of the diagnosis.
        causes: named.
        rivals: candidates that fit as well as one of them.
        before, after: RMS of the residual on held-out data [N, N m].
        units: of the axis.
        noise: of the encoder, where most is that [N, N m].
        is_rough: whether the record's numbers have taken the place of the file's.
    """
    unit = units.force
    if is_rough:
        own = f"With the record's numbers for those of the file {after:.3g} {unit} of {before:.3g} {unit} RMS are left."
        if not causes and not noise > 0.0:
            rest = "no known effect accounts for that" if verdict == "unexplained" else "nothing else is missing"
            return f"{own[:-1]}; {rest}."
        return f"{own} {summarise(verdict, causes, rivals, before, after, units, noise)}"
    names = [cause.name for cause in causes]
    curved, unnamed, certain = (
        ", ".join(cause.name for cause in causes if cause.stands_for == part)
        for part in ("curve over speed", "what has no name", "")
    )
    also = f" ({curved} for a curve over speed)" if curved else ""
    also += f" ({unnamed} in place of something without a name)" if unnamed else ""
    gain = f"the residual on data not used in the fit goes from {before:.3g} {unit} to {after:.3g} {unit} RMS"
    if verdict == "adequate":
        return f"The simulation explains the record; {before:.3g} {unit} RMS are left, nothing is named."
    if verdict == "unexplained" and noise > 0.0:
        named = f"{certain or 'Nothing is named'}{also}"
        found = f"{named}: {gain}; " if causes else f"{before:.3g} {unit} RMS are left, "
        return f"{found}about {noise:.2g} {unit} of that are noise of the encoder."
    if verdict == "unexplained" and not causes:
        return f"{before:.3g} {unit} RMS are left that no known effect accounts for; nothing is named."
    if verdict == "unexplained":
        if not certain and not unnamed:
            return f"{curved} in place of a curve over speed that no known effect has: {gain}."
        if not certain:
            return f"No known effect accounts for what is left{also}, nothing is named: {gain}."
        return f"{certain}, and more that no known effect accounts for{also}: {gain}."
    if verdict == "ambiguous":
        others = [name for name in dict.fromkeys(rival.name for rival in rivals) if name not in names]
        return f"{certain}{also}, but {', '.join(others)} would fit as well: {gain}."
    return f"{certain}{also}: {gain}."
