"""Text of a report: a diagnosis in an engineer's words and units."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from sgms_mhe import __version__
from sgms_mhe.diagnosis import Cause, Diagnosis, ResidualStructure, Traces
from sgms_mhe.diagnosis.criteria import material_force
from sgms_mhe.model.effects import BASE_CAUSES
from sgms_mhe.report.estimator import EstimatorGain
from sgms_mhe.report.learned import learned_titles
from sgms_mhe.report.pieces import bar_width, force_bars, tile
from sgms_mhe.report.ranking import ranked_scores, score_rows
from sgms_mhe.report.rivals import InPlace, open_questions, rival_blocks
from sgms_mhe.report.series import View
from sgms_mhe.report.units import (
    axis_units,
    force,
    force_suffix,
    percent,
    plain,
    probability,
    quantity,
    split_name,
    stated,
)
from sgms_mhe.report.words import (
    SIGNS,
    base_words,
    between,
    capital,
    cause_text,
    cause_title,
    join_words,
    relative_change,
    sentence,
    title,
)
from sgms_mhe.support.numbers import SIGMAS
from sgms_mhe.support.statements import Rule

SIGNIFICANT: Final = 0.01
ENCODER_SHARE: Final = 0.25  # of a dependence, from which it is worth a word

_SAYS: Final = {
    "position": "Residual over position",
    "velocity": "Residual over velocity",
    "acceleration": "Residual over acceleration",
    "time": "Residual over time",
    "after_reversal": "Residual after reversals",
    "frequency": "Spectrum of the residual",
}


def page(
    diagnosis: Diagnosis, folder: Path, views: Sequence[View], in_place: Sequence[InPlace], gain: EstimatorGain | None
) -> dict[str, Any]:
    """Everything that the template asks for, but for data, style and script."""
    d, t = diagnosis, diagnosis.traces
    as_good = {str(s.numbers["rival"]) for s in d.statements if s.kind == "choice"} - {c.name for c in d.causes}
    return {
        "machine": d.machine.name,
        "description": d.machine.description,
        "source": d.source,
        "badge": _badge(d),
        "headline": _headline(d),
        "summary": d.summary,
        "limits": open_questions(d),
        "tiles": _tiles(d, gain),
        "next": _next(d),
        "warnings": [sentence(w) for w in d.warnings],
        "causes": [_cause(d, c) for c in d.causes],
        "rivals": rival_blocks(d, in_place),
        "alternatives": [
            {"title": capital(title(a.name)), "name": a.name, "why_not": a.why_not}
            for a in d.alternatives
            if not a.rival
        ],
        "time_plots": [
            {"key": "friction", "size": "", "aria": "Measured and simulated friction over time"},
            {"key": "residual", "size": "low", "aria": "Residual before and after over time"},
            {"key": "motion", "size": "flat", "aria": "Position over time"},
        ],
        "left": _left(d),
        "learned": [sentence(s.sentence) for s in d.statements if s.kind == "learned"],
        "learned_plots": () if d.learned is None else learned_titles(d.learned),
        "views": [
            {"key": f"view_{v.key}", "title": _SAYS[v.key], "says": _says(v.key, d), "empty": len(v.centres) == 0}
            for v in views
        ],
        "candidates_ranked": score_rows(ranked_scores(d.scores), as_good),
        "gain_rows": _gain_rows(d),
        "floor_at": bar_width(d.noise_floor_N, _largest_rms(d)),
        "gain_note": _gain_note(d),
        "estimator": None if gain is None else _estimator(gain),
        "extended": None
        if d.extended is None
        else {
            "file": d.extended_name,
            "name": d.extended.name,
            "toml": d.extended_file(folder) or "",
            "holds": "It has the causes that are listed, not what may stand in their place." if as_good else "",
        },
        "numbers": _number_rows(d),
        "records": _record_rows(d),
        "about": _about(d, t),
    }


def _number_rows(d: Diagnosis) -> list[dict[str, str]]:
    """Return a row per number of the machine file, refuted ones first."""
    return [
        {
            "words": split_name(s.about)[0] if s.rule is Rule.REFUTED else base_words(s.about),
            "nominal": str(stated(s, file)),
            "value": str(stated(s)),
            "change": relative_change(file, s.value),
            "note": s.text,
        }
        for s in d.statements
        if s.rule in (Rule.REFUTED, Rule.REFITTED, Rule.UNSEEN)
        for file in [float(s.numbers["file"])]
    ]


def _record_rows(d: Diagnosis) -> list[dict[str, str]]:
    """Return a row per record; no row where there is one alone."""
    return [
        {
            "name": record.name,
            "before": force(record.held_out_before),
            "after": force(record.held_out_after),
            "plain": force(record.plain),
            "floor": force(record.noise_floor_N),
            "origin": str(quantity("origin_m", record.origin_m)) if record.origin_m else "",
            "gains": "; ".join(f"{t.label} {between(*t.gain_interval_N)}" for t in record.causes),
        }
        for record in d.records
    ]


def _badge(d: Diagnosis) -> dict[str, str]:
    """The verdict as a badge: green only where the record leaves nothing open."""
    names = {"nothing": "not excited", "limited": f"{d.verdict}, with limits"}
    return {"name": names.get(d.standing, d.verdict), "style": d.standing, "sign": SIGNS[d.standing]}


def _headline(d: Diagnosis) -> str:
    """Causes by how sure they are, choices as questions; without any the verdict's own sentence."""
    words = {cause.label: cause_text(cause) for cause in d.causes}
    causes = [s for s in d.statements if s.kind == "cause" and s.rule is not Rule.HAS_RIVAL]
    parts = [
        f"{said}: {join_words(shorten(found))}."
        for said, is_sure in (("Found", True), ("Not certain", False))
        if (found := [words[s.about] for s in causes if (s.sure == "yes") is is_sure])
    ]
    parts += ["Something is left that no known effect accounts for." for s in d.statements if s.rule is Rule.LEFT]
    parts += [
        f"{capital(title(str(s.numbers['named'])))} or {title(str(s.numbers['rival']))}?"
        for s in d.statements
        if s.kind == "choice"
    ]
    return " ".join(parts) or d.summary


def shorten(parts: Sequence[str]) -> list[str]:
    """As many as a headline has room for."""
    most = 3
    return list(parts) if len(parts) <= most else [*parts[: most - 1], f"{len(parts) - most + 1} more"]


def _next(d: Diagnosis) -> dict[str, str] | None:
    """Return the next steps: to confirm, or to find out more; open questions have their moves beside them."""
    text, command = "", ""
    if any(s.kind == "choice" for s in d.statements):
        text = "Record one of the moves above, then diagnose the new log."
    elif d.separating_experiment:
        text = sentence(d.separating_experiment)
    elif d.extended is not None:
        text = "Confirm it on another record. This prints what the extended simulation leaves there:"
        command = f"sgms-mhe predict {d.extended_name} ANOTHER_LOG --out friction.csv"
    else:
        return None
    return {"text": text, "command": command}


def _tiles(d: Diagnosis, gain: EstimatorGain | None) -> list[dict[str, str]]:
    before, after = d.rms.held_out_before, d.rms.held_out_after
    if d.extended is not None:
        push = f"{capital(axis_units().push)} newly explained there"
        tiles = [
            _change("Residual, data kept from the fit", before, after, "RMS, "),
            tile(push, between(*d.gain_interval_N), "RMS, 95 % interval"),
        ]
    else:
        kind = "before" if d.verdict == "unexplained" else ""
        tiles = [tile("Residual of the simulation", force(before), "RMS on data kept from the fit", kind)]
    ratio = after / d.noise_floor_N if d.noise_floor_N > 0.0 else math.nan
    note = f"RMS; what is left is {plain(ratio, 3)} times that" if math.isfinite(ratio) else "RMS"
    tiles.append(tile("Noise of the measurement", force(d.noise_floor_N), note))
    if gain is not None:
        errors = (gain.base.predicted_rms_N, gain.extended.predicted_rms_N)
        tiles.append(_change("Estimator on a log it has not seen", *errors, "error of predicted friction, RMS, "))
    return tiles


def _change(label: str, before: float, after: float, note: str) -> dict[str, str]:
    """A tile of a force that was another one before."""
    note += relative_change(before, after)
    return tile(label, force(after), note, "after", force(before).removesuffix(force_suffix()))


def _cause(d: Diagnosis, c: Cause) -> dict[str, Any]:
    wrong, state = c.name in BASE_CAUSES or bool(c.nominal), d.state_cause(c)
    return {
        "title": capital(cause_title(c)),
        "label": c.label,
        "wrong_number": wrong,
        "open": state.sure != "yes",
        "says": sentence(state.sentence),
        "parameters": [
            {
                "words": split_name(name)[0],
                "nominal": str(quantity(name, c.nominal[name])) if name in c.nominal else "",
                "value": str(stated(s)),
                "note": s.text,
            }
            for name, s in zip(c.parameters, d.state_numbers(c), strict=True)
        ],
        "held_out_before": force(c.rms.held_out_before),
        "held_out_after": force(c.rms.held_out_after),
        "gain_interval": between(*c.gain_interval_N),
        "chance": probability(c.p_value),
    }


def _depends(s: ResidualStructure, d: Diagnosis) -> bool:
    """Return True if the residual depends on a coordinate: not by chance, and by an amount that matters."""
    return s.p_value < SIGNIFICANT and s.rms_N >= material_force(d.machine, d.noise_floor_N)


def _made(s: ResidualStructure) -> str:
    """Return the words on a dependence the encoder's steps make, as far as one draw of its lines says."""
    return f", the encoder's steps make about {force(s.encoder_N)}" if s.encoder_N > ENCODER_SHARE * s.rms_N else ""


def _left(d: Diagnosis) -> str:
    """Describe the residual, strongest first, in one sentence."""
    left = sorted((s for s in d.structure_after if _depends(s, d)), key=lambda s: -s.rms_N)
    parts = [
        f"{_coordinate(s.coordinate)} ({force(s.rms_N)} RMS{_made(s)})" for s in left if s.coordinate != "frequency"
    ]
    lines = [
        f"Its largest line is {force(s.rms_N)} at {plain(s.peak)} Hz." for s in left if s.coordinate == "frequency"
    ]
    return " ".join(([f"What is left depends most on {join_words(parts[:3])}."] if parts else []) + lines)


def _says(key: str, d: Diagnosis) -> str:
    """How much of the residual depends on a coordinate, before and after."""

    def amount(structures: Sequence[ResidualStructure]) -> str:
        found = next((s for s in structures if s.coordinate == key), None)
        return "" if found is None or not _depends(found, d) else force(found.rms_N) + _made(found)

    if not any(s.coordinate == key for s in d.structure_before):
        return ""
    before = amount(d.structure_before)
    after = amount(d.structure_after) if d.extended is not None else before
    what = "Largest line" if key == "frequency" else f"Depends on {_coordinate(key)}"
    if not before and not after:
        return "No line that matters." if key == "frequency" else "No dependence that matters."
    if d.extended is None:
        return f"{what}: {before}."
    return f"{what}: {before or 'less than matters'} before, {after or 'less than matters'} after."


def _coordinate(key: str) -> str:
    return {"after_reversal": "the way since a reversal"}.get(key, key)


def _gain_rows(d: Diagnosis) -> list[dict[str, str | float]]:
    rows = [("machine file as it is", "b", d.rms.held_out_before), ("extended", "a", d.rms.held_out_after)]
    return force_bars(rows[: 1 if d.extended is None else 2], _largest_rms(d))


def _gain_note(d: Diagnosis) -> str:
    floor = f"Dashed: noise of the measurement, {force(d.noise_floor_N)} RMS; no model gets below it."
    return " ".join((floor, *(sentence(s.sentence) for s in d.statements if s.kind == "error")))


def _estimator(gain: EstimatorGain) -> dict[str, Any]:
    most = max(gain.base.predicted_rms_N, gain.base.filtered_rms_N, gain.extended.predicted_rms_N)
    rows = (
        ("predicted, machine file as it is", "b", gain.base.predicted_rms_N),
        ("predicted, extended", "a", gain.extended.predicted_rms_N),
        ("after each measurement, as it is", "b", gain.base.filtered_rms_N),
        ("after each measurement, extended", "a", gain.extended.filtered_rms_N),
    )
    low, high = gain.reduction_interval
    after = {p.name: p for p in gain.extended.parameters}
    return {
        "rows": force_bars(rows, most),
        "note": f"{sentence(gain.state(axis_units().force).sentence)} That is before the force measured there is used: "
        f"what compensation feeds forward. Its error falls by {percent(gain.reduction)} (95 %: {percent(low)} to "
        f"{percent(high)}).",
        "parameters": [
            {
                "name": axis_units().named(p.name),
                "before": f"± {percent(SIGMAS * p.wander)}",
                "after": f"± {percent(SIGMAS * after[p.name].wander)}",
            }
            for p in gain.base.parameters
            if p.name in after
        ],
    }


def _about(d: Diagnosis, t: Traces) -> list[tuple[str, str]]:
    used = float(t.used.mean()) if len(t.used) else 0.0
    kept = float(t.held_out.sum() / max(1, t.used.sum()))
    law = f"{d.law}, " + ("as" if d.law == d.machine.friction.law else "not as") + " the machine file says"
    return [
        ("Record", f"{d.source}; {plain(len(t.time_s) / t.rate, 3)} s, fitted at {plain(t.rate, 4)} Hz"),
        (
            "Rows that count",
            f"{percent(used)}; {percent(kept)} of them kept from the fit that the gains are computed with",
        ),
        (
            "Uncertainty",
            "95 % intervals, computed from blocks of the record: residuals that are not white do not narrow them",
        ),
        ("Law of friction", law),
        ("Machine file", f"{d.machine.name}, sha256 {d.machine.digest[:16]}"),
        ("Computed by", f"sgms-mhe {__version__} in {plain(d.seconds, 2)} s"),
    ]


def _largest_rms(d: Diagnosis) -> float:
    values = (d.rms.held_out_before, d.rms.held_out_after, d.noise_floor_N)
    return max((v for v in values if math.isfinite(v)), default=0.0)
