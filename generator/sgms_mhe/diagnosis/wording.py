"""Candidates that were not named, and the reasons."""

from sgms_mhe.diagnosis.fits import report_values
from sgms_mhe.diagnosis.parts import Alternative
from sgms_mhe.diagnosis.rivals import Selection
from sgms_mhe.machine import Units


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
    """Why a candidate put in a cause's place, or was a cause for a while, is none."""
    lost = selection.rejected[name]
    if name in {group.cause for group in selection.unnamed}:
        return "refitted with the causes, no cause of its own"
    if name in selection.inconstant:
        return "its size is not the same all over the record"
    if name == lost.instead_of:
        return "its size, or its gain on data not used in the fit, may be zero"
    return f"in place of {lost.instead_of} leaves {lost.excess_N:.3g} {units.force} more"
