"""What a report says: a diagnosis in an engineer's words and units."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from sgms_mhe import __version__
from sgms_mhe.diagnosis import Alternative, Cause, Diagnosis, Score, Structure, Traces, separating_move
from sgms_mhe.model.effects import BASE_CAUSES, base_number, cause, cause_names
from sgms_mhe.report.estimator import EstimatorGain
from sgms_mhe.report.series import View, numbers, pack, runs
from sgms_mhe.report.units import SPACE, force, percent, plain, probability, quantity, split_name

MEASURED, BEFORE, AFTER = "#374151", "#c2540a", "#0b6aa8"
NEWTON: Final = f"{SPACE}N"
SIGNIFICANT: Final = 0.01
IDLE: Final = 0.02  # of the best candidate's gain
_OWN: Final = "machine:"  # before the name of an effect that the machine file has already

_VERDICTS: Final = {
    "adequate": (
        "✓",
        "The simulation explains the record down to the noise of the measurement. Nothing is missing from it.",
    ),
    "explained": ("✓", "Each cause removes some of it there."),
    "ambiguous": (
        "?",
        "Where a cause is open, something else in its place fits this record equally well. The extended machine file "
        "holds the cause that is listed; along another motion the two differ, and the next step tells which one it is.",
    ),
    "unexplained": ("!", "The plots show where it lives; no name is invented."),
}
_ORDER: Final = {"named": 0, "rival": 1}
_SAYS: Final = {
    "position": "Residual over position",
    "velocity": "Residual over velocity",
    "acceleration": "Residual over acceleration",
    "time": "Residual over time",
    "after_reversal": "Residual after reversals",
    "frequency": "Spectrum of the residual",
}


def page(
    diagnosis: Diagnosis, views: Sequence[View], gain: EstimatorGain | None, figures: Sequence[str]
) -> dict[str, Any]:
    """Everything that the template asks for, but for data, style and script."""
    d, t = diagnosis, diagnosis.traces
    sign, meaning = _VERDICTS[d.verdict]
    shown: str = d.verdict
    if not d.excited:
        shown, sign, meaning = "not excited", "–", "Nothing is named and nothing is confirmed."
    rivals = _rivals(d)
    scores = ranked_scores(d.scores)
    most = max((_explained(s) for s in scores), default=0.0)
    idle = [s for s in scores if s.outcome not in _ORDER and _explained(s) < IDLE * most]
    return {
        "machine": d.machine.name,
        "description": d.machine.description,
        "source": d.source,
        "verdict": {"name": shown, "style": shown.replace(" ", "-"), "sign": sign, "meaning": meaning},
        "headline": _headline(d),
        "open": _open(d),
        "summary": _lead(d),
        "tiles": _tiles(d, gain),
        "next": _next(d),
        "warnings": [_sentence(w) for w in d.warnings],
        "causes": [_cause(c, rivals.get(c.label, [])) for c in d.causes],
        "alternatives": [
            {"title": _capital(title(a.name)), "name": _plain_name(a.name), "why_not": a.why_not}
            for a in d.alternatives
            if not a.rival
        ],
        "time_plots": [
            {"key": "friction", "size": "", "aria": "Measured and simulated friction over time"},
            {"key": "residual", "size": "low", "aria": "Residual before and after over time"},
            {"key": "motion", "size": "flat", "aria": "Position over time"},
        ],
        "left": _left(d),
        "views": [
            {
                "key": f"view_{v.key}",
                "title": _SAYS[v.key],
                "says": _says(v.key, d.structure_before, d.structure_after if d.extended is not None else ()),
                "empty": len(v.centres) == 0,
            }
            for v in views
        ],
        "candidates": _rows([s for s in scores if s not in idle]),
        "idle": _listed([_plain_name(s.name) for s in idle]) if idle else "",
        "rounds": _rounds(d.scores),
        "gain_rows": _gain_rows(d),
        "floor_at": _share(d.noise_floor_N, _largest_rms(d)),
        "gain_note": _gain_note(d),
        "estimator": None if gain is None else _estimator(gain),
        "extended": None
        if d.extended is None
        else {"file": d.extended_name, "name": d.extended.name, "toml": d.extended_toml or ""},
        "base": [
            {
                "words": _base_words(b.name),
                "nominal": str(quantity(b.name, b.nominal)),
                "value": str(quantity(b.name, b.refitted, b.std)) if math.isfinite(b.std) else "not excited",
                "change": _change(b.nominal, b.refitted) if math.isfinite(b.std) else "",
            }
            for b in d.base
        ],
        "about": _about(d, t),
        "figures": figures,
    }


def plots(diagnosis: Diagnosis, views: Sequence[View]) -> dict[str, Any]:
    """What the page's plots draw, by their names."""
    t = diagnosis.traces
    extended = diagnosis.extended is not None
    step = 1.0 / t.rate

    def masked(values: Any) -> Any:
        return np.where(t.used, values, np.nan)

    common = {
        "uniform": True,
        "start": float(t.time_s[0]) if len(t.time_s) else 0.0,
        "step": step,
        "group": "time",
        "xLabel": "time [s]",
        "xUnit": "s",
        "unit": "N",
        "shaded": [(float(t.time_s[a]), float(t.time_s[b - 1]) + step) for a, b in runs(t.held_out)],
    }
    simulated = [_line("simulated, machine file as it is", pack(masked(t.nominal_N)), BEFORE)]
    residuals = [_line("residual, machine file as it is", pack(masked(t.residual_before)), BEFORE, 1.0)]
    if extended:
        simulated.append(_line("simulated, extended", pack(masked(t.held_out_fit_N)), AFTER, dash=[7, 4], width=1.6))
        residuals.append(_line("residual, extended", pack(masked(t.residual_after)), AFTER, 1.0))
    content: dict[str, Any] = {
        "friction": common
        | {
            "yLabel": "friction [N]",
            "series": [_line("measured", pack(masked(t.friction_N)), MEASURED, 1.8), *simulated],
        },
        "residual": common | {"yLabel": "residual [N]", "zero": True, "series": residuals},
    }
    factor, unit = (1e3, "mm") if np.ptp(t.position_m) > 1e-3 else (1e6, "µm")
    content["motion"] = common | {
        "yLabel": f"position [{unit}]",
        "unit": unit,
        "series": [_line("position", pack(t.position_m * factor), MEASURED)],
    }
    for view in views:
        if len(view.centres):
            content[f"view_{view.key}"] = _view(view, extended)
    return content


def title(name: str) -> str:
    """What a cause is, in words; a number of one of the machine file's own effects included."""
    name, own = _plain_name(name), name.startswith(_OWN)
    words = cause(name).summary if name in cause_names() else name.replace("_", " ")
    return f"{words}: another value than the machine file's" if own else words


def _line(
    name: str, packed: Mapping[str, Any], colour: str, width: float = 1.3, dash: Sequence[int] | None = None
) -> dict[str, Any]:
    return {"name": name, "packed": packed, "colour": colour, "width": width} | ({"dash": dash} if dash else {})


def _view(view: View, extended: bool) -> dict[str, Any]:
    series: list[dict[str, Any]] = []
    pairs = [("before", BEFORE, view.before, view.mean_before)]
    if extended:
        pairs.append(("after", AFTER, view.after, view.mean_after))
    for name, colour, cloud, _ in pairs:
        if len(cloud):
            series.append(
                {
                    "name": name,
                    "cloud": True,
                    "packedX": pack(view.x),
                    "packed": pack(cloud),
                    "colour": colour,
                    "alpha": 0.13,
                }
            )
    labels = {"before": "machine file as it is", "after": "extended"}
    for name, colour, _, means in pairs:
        series.append(
            {"name": name, "label": labels[name], "x": numbers(view.centres), "y": numbers(means), "colour": colour}
            | ({"width": 2.2, "cased": True} if view.key != "frequency" else {"width": 1.3})
        )
    spectrum = view.key == "frequency"
    return {
        "series": series,
        "xLog": view.logarithmic,
        "yLog": spectrum,
        "zero": not spectrum,
        "xLabel": f"{view.title} [{view.unit}]",
        "xUnit": view.unit,
        "yLabel": "amplitude [N]" if spectrum else "residual [N]",
        "unit": "N",
    }


def _plain_name(name: str) -> str:
    return name.removeprefix(_OWN)


def _cause_title(c: Cause) -> str:
    return title(c.name if c.name in BASE_CAUSES or not c.nominal else _OWN + c.name)


def _rivals(d: Diagnosis) -> dict[str, list[Alternative]]:
    """What fits as well as a named cause, by that cause's label."""
    labels = [c.label for c in d.causes]
    found: dict[str, list[Alternative]] = {}
    for a in d.alternatives:
        if a.rival and a.instead_of is not None and _plain_name(a.name) not in labels:
            found.setdefault(_plain_name(a.instead_of), []).append(a)
    return {label: rivals for label, rivals in found.items() if label in labels}


def _headline(d: Diagnosis) -> str:
    """The verdict in one plain sentence."""
    if not d.excited:
        return "The axis hardly moves in this record: it says nothing about the simulation."
    rest = "Something is left that no known effect accounts for"
    if not d.causes:
        known = "The simulation explains this record down to the noise of the measurement."
        return f"{rest}." if d.verdict == "unexplained" else known
    rivals = _rivals(d)
    settled = [_with_size(c) for c in d.causes if c.label not in rivals] or [_with_size(c) for c in d.causes]
    found = f"Found: {_listed(_shortened(settled))}."
    return f"{found} {rest}, too." if d.verdict == "unexplained" else found


def _open(d: Diagnosis) -> list[str]:
    """The choices that the record leaves, each as a question."""
    rivals = _rivals(d)
    return [
        f"{_capital(_listed([title(c.name), *(title(r.name) for r in rivals[c.label])], 'or'))}?"
        for c in d.causes
        if c.label in rivals
    ]


def _shortened(parts: Sequence[str]) -> list[str]:
    """As many as a headline has room for."""
    most = 3
    return list(parts) if len(parts) <= most else [*parts[: most - 1], f"{len(parts) - most + 1} more"]


def _lead(d: Diagnosis) -> str:
    """What the verdict rests on, in numbers and in words."""
    if not d.excited or (d.verdict == "unexplained" and not d.causes):
        return _sentence(d.summary)
    if d.extended is None:
        return f"{force(d.rms.held_out_before)} RMS are left."
    before, after = force(d.rms.held_out_before), force(d.rms.held_out_after)
    return f"On data that the fit has not seen, measured minus simulated friction falls from {before} to {after} RMS."


def _next(d: Diagnosis) -> dict[str, Any] | None:
    """What to do next: the moves that tell open causes apart, or how to confirm."""
    moves = [
        {
            "choice": f"{_capital(title(c.name))}, or {title(rival.name)}?",
            "move": _sentence(separating_move(c.name, _plain_name(rival.name)) or rival.why_not),
            "command": f"sgms-mhe plan {d.machine.name} --separate {c.name} {_plain_name(rival.name)} --out plan.csv",
        }
        for c in d.causes
        for rival in _rivals(d).get(c.label, [])
        if c.name != _plain_name(rival.name)
    ]
    text, command = "", ""
    if not moves and d.separating_experiment:
        text = _sentence(d.separating_experiment)
    elif moves:
        text = "Record one of these, then diagnose the new log."
    elif d.extended is not None:
        text = "Confirm it on another record. This prints what the extended simulation leaves there:"
        command = f"sgms-mhe predict {d.extended_name} ANOTHER_LOG --out friction.csv"
    else:
        return None
    return {"text": text, "command": command, "moves": moves}


def _with_size(c: Cause) -> str:
    """A cause in words, with its leading number where it is an effect."""
    key = next(iter(c.parameters), None)
    if key is None or c.nominal or c.name in BASE_CAUSES:
        return _cause_title(c)
    return f"{title(c.name)} ({quantity(key, c.parameters[key])})"


def _tiles(d: Diagnosis, gain: EstimatorGain | None) -> list[dict[str, str]]:
    rms = d.rms
    tiles = []
    if d.extended is not None:
        low, high = d.gain_interval_N
        tiles.append(
            {
                "label": "Residual, data kept from the fit",
                "before": force(rms.held_out_before).removesuffix(NEWTON),
                "value": force(rms.held_out_after),
                "kind": "after",
                "note": f"RMS, {_change(rms.held_out_before, rms.held_out_after)}",
            }
        )
        tiles.append(
            {
                "label": "Force newly explained there",
                "before": "",
                "value": _between(low, high),
                "kind": "",
                "note": "RMS, 95 % interval",
            }
        )
    else:
        tiles.append(
            {
                "label": "Residual of the simulation",
                "before": "",
                "value": force(rms.held_out_before),
                "kind": "before" if d.verdict == "unexplained" else "",
                "note": "RMS on data kept from the fit",
            }
        )
    ratio = rms.held_out_after / d.noise_floor_N if d.noise_floor_N > 0.0 else math.nan
    tiles.append(
        {
            "label": "Noise of the measurement",
            "before": "",
            "value": force(d.noise_floor_N),
            "kind": "",
            "note": f"RMS; what is left is {plain(ratio, 3)} times that" if math.isfinite(ratio) else "RMS",
        }
    )
    if gain is not None:
        tiles.append(
            {
                "label": "Estimator on a log it has not seen",
                "before": force(gain.base.predicted_rms_N).removesuffix(NEWTON),
                "value": force(gain.extended.predicted_rms_N),
                "kind": "after",
                "note": "error of predicted friction, RMS, "
                + _change(gain.base.predicted_rms_N, gain.extended.predicted_rms_N),
            }
        )
    return tiles


def _cause(c: Cause, rivals: Sequence[Alternative]) -> dict[str, Any]:
    wrong = c.name in BASE_CAUSES or bool(c.nominal)
    return {
        "title": _capital(_cause_title(c)),
        "label": c.label,
        "wrong_number": wrong,
        "parameters": [
            {
                "words": split_name(name)[0],
                "nominal": str(quantity(name, c.nominal[name])) if name in c.nominal else "",
                "value": str(quantity(name, value, c.std.get(name, math.nan))),
            }
            for name, value in c.parameters.items()
        ],
        "held_out_before": force(c.rms.held_out_before),
        "held_out_after": force(c.rms.held_out_after),
        "gain": force(c.gain_N),
        "gain_interval": _between(*c.gain_interval_N),
        "chance": probability(c.p_value),
        "rivals": [
            {
                "words": title(a.name),
                "name": _plain_name(a.name),
                "parameters": ", ".join(f"{split_name(k)[0]} {quantity(k, v)}" for k, v in a.parameters.items()),
            }
            for a in rivals
        ],
    }


def _left(d: Diagnosis) -> str:
    """What is left, strongest first, in one sentence."""
    left = sorted((s for s in d.structure_after if s.p_value < SIGNIFICANT), key=lambda s: -s.rms_N)
    if not left:
        return ""
    parts = [f"{_coordinate(s.coordinate)} ({force(s.rms_N)} RMS)" for s in left[:3]]
    return f"What is left depends most on {_listed(parts)}."


def _says(key: str, before: Sequence[Structure], after: Sequence[Structure]) -> str:
    def find(structures: Sequence[Structure]) -> Structure | None:
        return next((s for s in structures if s.coordinate == key), None)

    first, last = find(before), find(after)
    if first is None:
        return ""
    kind = "largest line" if key == "frequency" else f"depends on {_coordinate(key)}"
    text = f"{_capital(kind)}: {force(first.rms_N)}"
    if last is not None and last is not first:
        text += f" before, {force(last.rms_N)} after"
    if (last or first).p_value < SIGNIFICANT:
        return f"{text}; significant."
    return f"{text}; no more than noise{' is left' if last is not None else ''}."


def _coordinate(key: str) -> str:
    return {"after_reversal": "the way since a reversal"}.get(key, key)


def ranked_scores(scores: Sequence[Score]) -> list[Score]:
    """Every candidate once: where it was named, otherwise in the first round it took part in; the best first."""
    best: dict[str, Score] = {}
    for score in sorted(scores, key=lambda s: s.round):
        if score.name not in best or (score.outcome == "named" and best[score.name].outcome != "named"):
            best[score.name] = score
    return _ranked(list(best.values()))


def _ranked(scores: Sequence[Score]) -> list[Score]:
    return sorted(scores, key=lambda s: (_ORDER.get(s.outcome, 2), -_explained(s)))


def _explained(score: Score) -> float:
    return _finite(score.refit_gain_N, score.gain_N)


def _rounds(scores: Sequence[Score]) -> list[dict[str, Any]]:
    rounds = []
    for number in sorted({s.round for s in scores}):
        names = [_plain_name(s.name) for s in scores if s.round < number and s.outcome == "named"]
        done = f", after {_listed(names)} had been added" if names else ", the base model refitted"
        rounds.append(
            {"title": f"Round {number}{done}", "rows": _rows(_ranked([s for s in scores if s.round == number]))}
        )
    return rounds if len(rounds) > 1 else []


def _rows(scores: Sequence[Score]) -> list[dict[str, Any]]:
    most = max((_explained(s) for s in scores), default=0.0)
    return [
        {
            "title": _capital(title(s.name)),
            "name": _plain_name(s.name),
            "gain": force(s.gain_N),
            "refit": force(s.refit_gain_N),
            "chance": probability(s.p_value),
            "outcome": s.outcome,
            "kind": s.outcome if s.outcome in _ORDER else "other",
            "width": _share(_explained(s), most),
        }
        for s in scores
    ]


def _gain_rows(d: Diagnosis) -> list[dict[str, Any]]:
    rows = [("kept from the fit, machine file as it is", "b", d.rms.held_out_before)]
    if d.extended is not None:
        rows.append(("kept from the fit, extended", "a", d.rms.held_out_after))
    rows.append(("all other data, machine file as it is", "b", d.rms.before))
    if d.extended is not None:
        rows.append(("all other data, extended", "a", d.rms.after))
    most = _largest_rms(d)
    return [
        {"words": _capital(words), "kind": kind, "value": force(value), "width": _share(value, most)}
        for words, kind, value in rows
    ]


def _gain_note(d: Diagnosis) -> str:
    floor = f"Dashed: noise of the measurement, {force(d.noise_floor_N)} RMS; no model gets below it."
    if d.extended is None:
        return floor
    return f"Force explained on data kept from the fit, 95 %: {_between(*d.gain_interval_N)} RMS. {floor}"


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
        "rows": [
            {"words": _capital(words), "kind": kind, "value": force(value), "width": _share(value, most)}
            for words, kind, value in rows
        ],
        "note": f"Generated, compiled and run on {gain.source or 'a log'} ({plain(gain.duration_s)} s) that no fit has "
        "seen. Predicted: what the estimator puts out at every sample before the force measured there is used; it is "
        f"what friction compensation feeds forward. Its error falls by {percent(gain.reduction)} "
        f"(95 %: {percent(low)} to {percent(high)}).",
        "parameters": [
            {"name": p.name, "before": f"± {percent(p.wander)}", "after": f"± {percent(after[p.name].wander)}"}
            for p in gain.base.parameters
            if p.name in after
        ],
    }


def _about(d: Diagnosis, t: Traces) -> list[tuple[str, str]]:
    used = float(t.used.mean()) if len(t.used) else 0.0
    kept = float(t.held_out.sum() / max(1, t.used.sum()))
    transition = "as the machine file says" if d.smoothing == "machine" else "sharper than the machine file says"
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
        ("Sticking to slipping", transition),
        ("Machine file", f"{d.machine.name}, sha256 {d.machine.digest[:16]}"),
        ("Computed by", f"sgms-mhe {__version__} in {plain(d.seconds, 2)} s"),
    ]


def _base_words(name: str) -> str:
    number = base_number(name)
    if number is None:
        return name.replace("_", " ")
    return f"{number.words} of element {number.element(name) + 1}" if number.array else number.words


def _change(before: float, after: float) -> str:
    if not (math.isfinite(before) and math.isfinite(after)) or before == 0.0:
        return "–"
    change = after / before - 1.0
    return ("+" if change >= 0.0 else "−") + percent(abs(change))


def _between(low: float, high: float) -> str:
    if not (math.isfinite(low) and math.isfinite(high)):
        return "not known"
    return f"{force(low).removesuffix(NEWTON)} to {force(high)}"


def _largest_rms(d: Diagnosis) -> float:
    values = (d.rms.before, d.rms.after, d.rms.held_out_before, d.rms.held_out_after, d.noise_floor_N)
    return max((v for v in values if math.isfinite(v)), default=0.0)


def _share(value: float, most: float) -> float:
    return round(100.0 * max(0.0, min(1.0, value / most)), 2) if most > 0.0 and math.isfinite(value) else 0.0


def _finite(*values: float) -> float:
    return next((v for v in values if math.isfinite(v)), 0.0)


def _listed(parts: Sequence[str], last: str = "and") -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} {last} {parts[-1]}"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _sentence(text: str) -> str:
    text = text.strip()
    first = text.partition(" ")[0].rstrip(",:;")
    if first not in cause_names() and "_" not in first:  # names stay as they are written
        text = _capital(text)
    return text if text.endswith((".", "!", "?", ":")) else text + "."
