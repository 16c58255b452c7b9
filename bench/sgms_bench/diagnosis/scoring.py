"""From what diagnoses said to rates: how each log came out, the confusion matrix, errors, coverage, smallest sizes."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from sgms_bench.diagnosis.causes import LEAST_SIZE
from sgms_bench.diagnosis.draws import KINDS, Draw
from sgms_mhe.diagnosis import Diagnosis
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import CAUSE_NAMES, EFFECT_NAMES, base_number, effect_definition, reported_name

NOTHING, UNEXPLAINED, ERROR = "(nothing)", "(unexplained)", "(error)"
SIGMAS: Final = 1.96
MOST_LISTED: Final = 3
"""An `ambiguous` that lists more rivals per cause than this has told nothing apart."""
WITHIN: Final = 0.1


@dataclass(frozen=True)
class ScoredDiagnosis:
    """Scored part of a diagnosis.

    `causes`: (name, parameters, std); `rivals`: (name, instead of which cause); `law`: of friction, as told; `noise_N`:
    of the log, known from its making, over means of ten samples, NaN where it is not; `refused`: what was said of a log
    that was refused for its sign, scale or unit; `doubted`: causes that may stand for something else; `error`: why
    there was no diagnosis.
    """

    verdict: str
    causes: tuple[tuple[str, Mapping[str, float], Mapping[str, float]], ...] = ()
    rivals: tuple[tuple[str, str | None], ...] = ()
    law: str = ""
    has_experiment: bool = False
    held_out_before_N: float = math.nan
    held_out_after_N: float = math.nan
    noise_floor_N: float = math.nan
    noise_N: float = math.nan
    seconds: float = math.nan
    refused: str = ""
    doubted: tuple[str, ...] = ()
    error: str = ""

    @classmethod
    def of(cls, diagnosis: Diagnosis, noise_N: float, seconds: float) -> ScoredDiagnosis:
        """The part of a diagnosis that is scored."""
        return cls(
            verdict=diagnosis.verdict,
            causes=tuple((c.name, dict(c.parameters), dict(c.std)) for c in diagnosis.causes),
            rivals=tuple((a.name, a.instead_of) for a in diagnosis.alternatives if a.rival),
            law=diagnosis.law,
            has_experiment=bool(diagnosis.separating_experiment),
            held_out_before_N=diagnosis.rms.held_out_before,
            held_out_after_N=diagnosis.rms.held_out_after,
            noise_floor_N=diagnosis.noise_floor_N,
            noise_N=noise_N,
            seconds=seconds,
            doubted=tuple(c.name for c in diagnosis.causes if c.stands_for),
        )

    def to_json(self) -> dict[str, Any]:
        """Plain content."""
        content: dict[str, Any] = asdict(self)
        return content

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> ScoredDiagnosis:
        """Return the record of a `to_json`."""
        causes = tuple((name, values, std) for name, values, std in content["causes"])
        rivals = tuple((name, instead) for name, instead in content["rivals"])
        numbers = {key: math.nan for key, value in content.items() if value is None}
        lists = {"causes": causes, "rivals": rivals, "doubted": tuple(content["doubted"])}
        return cls(**{**content, **numbers, **lists})

    @property
    def names(self) -> tuple[str, ...]:
        """Of the causes that are certain, one per kind."""
        return tuple(dict.fromkeys(name for name, _, _ in self.causes if name not in self.doubted))


def outcome(draw: Draw, found: ScoredDiagnosis) -> str:
    """How a log came out.

    named: exactly the hidden causes. ambiguous: not more than that, and every hidden cause is among the causes or
    their rivals, with the experiment that tells them apart. extra: all hidden causes and something that is not there.
    partial: not all of several, nothing wrong. missed: nothing named, the record called adequate. unexplained: nothing
    named, but something seen. misnamed: a name that is not there in place of one that is. Clean logs: right, invented
    or unexplained. Unmodelled forces: unexplained (right), misnamed, missed; curves over speed also named. Faults:
    right (refused, or unexplained with no name), misnamed, missed. Logs that cannot tell: right (nothing, or ambiguous
    with the truth), overclaimed (a name that happens to be right), misnamed. refused: a log that is as it should be.
    """
    if found.error:
        return "error"
    if found.refused and draw.kind != "fault":
        return "refused"
    truth, names = set(draw.truth), set(found.names)
    if draw.kind == "clean":
        return "invented" if names else "unexplained" if found.verdict == "unexplained" else "right"
    if draw.kind in ("unmodelled", "fault"):
        if names:
            return "named" if names == truth else "misnamed"
        right = "right" if draw.kind == "fault" else "unexplained"
        return right if found.verdict == "unexplained" else "missed"
    listed = names | {name for name, _ in found.rivals}
    hedged = found.verdict == "ambiguous" and found.has_experiment and truth <= listed and bool(names)
    if draw.kind == "weak":  # all that its motion makes one of may be listed
        if not names or (hedged and truth):
            return "right"
        return "overclaimed" if names <= truth else "misnamed"
    hedged = hedged and len(listed) <= len(truth) + MOST_LISTED * max(1, len(names))
    if names == truth and found.verdict != "ambiguous":
        return "named"
    if hedged and len(found.names) <= len(truth):
        return "ambiguous"
    if not names:
        return "unexplained" if found.verdict == "unexplained" else "missed"
    if truth < names:
        return "extra"
    if names < truth:
        return "partial"
    return "misnamed"


def is_confidently_wrong(draw: Draw, found: ScoredDiagnosis) -> bool:
    """Return True if a cause that is not there explains all, or one that the log cannot decide.

    Or nothing to be wrong with a log that no axis has left.
    """
    if draw.kind == "fault":
        return found.verdict in ("explained", "adequate")
    if found.verdict != "explained":
        return False
    return draw.kind == "weak" or not set(found.names) <= set(draw.truth)


FOUND: Final = ("named", "ambiguous")


@dataclass(frozen=True)
class Share:
    """`hits` of `total`, and the 95 % interval of the share (Wilson)."""

    hits: int
    total: int

    @property
    def value(self) -> float:
        """Hits over total; NaN of nothing."""
        return self.hits / self.total if self.total else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval."""
        if not self.total:
            return math.nan, math.nan
        n, p, z = self.total, self.value, SIGMAS
        middle, half = p + z * z / (2 * n), z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
        return max(0.0, (middle - half) / (1 + z * z / n)), min(1.0, (middle + half) / (1 + z * z / n))


@dataclass(frozen=True)
class Threshold:
    """Size at which a cause is found half of the time, over the Coulomb level, with its 80 % interval."""

    name: str
    size: float
    low: float
    high: float
    draws: int


@dataclass(frozen=True)
class Rate:
    """One rate of the benchmark.

    Attributes:
        title, goal: on the page.
        outcomes: of a log that are hits; empty: `summarise` counts otherwise.
        kinds: of draws that count; empty: all.
        sized: only those from `LEAST_SIZE` on count.
    """

    title: str
    goal: str = ""
    outcomes: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()
    sized: bool = False


_ONE: Final = ("single", "base")
RATES: Final[Mapping[str, Rate]] = {
    "recovery": Rate("named right (a correct ambiguous counts)", ">= 97 %", FOUND, _ONE, True),
    "ambiguous": Rate("  of these ambiguous, the truth among them", "", ("ambiguous",), _ONE, True),
    "misnamed": Rate("  called something else", "", ("misnamed",), _ONE, True),
    "extra": Rate("  right, and something that is not there", "", ("extra",), _ONE, True),
    "missed": Rate("  not named", "", ("missed", "unexplained"), _ONE, True),
    "doubles": Rate("two effects, both found", ">= 85 %", FOUND, ("double",), True),
    "triples": Rate("three effects, all found", "", FOUND, ("triple",), True),
    "false_alarms": Rate("clean logs with any name", "<= 0.5 %", ("invented",), ("clean",)),
    "unmodelled_unexplained": Rate(
        "unmodelled forces called unexplained, or curves", ">= 97 %", ("unexplained", "named"), ("unmodelled",)
    ),
    "unmodelled_misnamed": Rate("  given a name", "", ("misnamed",), ("unmodelled",)),
    "weak": Rate("logs that cannot tell, and it says so", "", ("right",), ("weak",)),
    "faults": Rate("wrong signs, units and columns seen", "", ("right",), ("fault",)),
    "refused": Rate(
        "  said of logs that are right", "0", ("refused",), tuple(kind for kind in KINDS if kind != "fault")
    ),
    "confidently_wrong": Rate("CONFIDENTLY WRONG, of all logs", "<= 0.5 %"),
    "laws": Rate("law of friction told right"),
    "within": Rate("parameters within 10 %"),
    "covered": Rate("parameters inside their 95 % interval", "95 %"),
    "at_floor": Rate("held-out residual within 10 % of the noise floor"),
    "errors": Rate("no diagnosis (error)", "0", ("error",)),
}
"""Rates by name, in the order of the page; one that is indented is part of the one above."""


@dataclass(frozen=True)
class Summary:
    """All numbers of the benchmark.

    Attributes:
        draws: logs.
        rates: by the names of `RATES`.
        floor_ratio: held-out residual after extension over the noise floor (median, 90 %).
        own_floor_ratio: median of the diagnosis's noise floor over the noise known from the log's making.
        seconds: time of a log (median, 90 %).
        thresholds: of causes.
        confusion: count by (truth, named).
        outcomes: count by (kind, outcome).
        worst_parameters: (cause.parameter, median of the relative error, count), the worst first.
    """

    draws: int
    rates: Mapping[str, Share]
    floor_ratio: tuple[float, float]
    own_floor_ratio: float
    seconds: tuple[float, float]
    thresholds: tuple[Threshold, ...]
    confusion: Mapping[tuple[str, str], int]
    outcomes: Mapping[tuple[str, str], int]
    worst_parameters: tuple[tuple[str, float, int], ...]


def summarise(machine: Machine, results: Iterable[tuple[Draw, ScoredDiagnosis]]) -> Summary:
    """Score all results."""
    rows = [(draw, found, outcome(draw, found)) for draw, found in results]
    told = [
        (draw, found)
        for draw, found, how in rows
        if how in (*FOUND, "right") and found.verdict != "unexplained" and draw.kind != "weak" and found.law
    ]
    right = [(draw, found) for draw, found, how in rows if how in FOUND]
    errors = [e for draw, found in right for e in parameter_errors(machine, draw, found)]
    ratios = [found.held_out_after_N / found.noise_floor_N for _, found in right if found.noise_floor_N > 0.0]
    own = [f.noise_floor_N / f.noise_N for _, f, _ in rows if f.noise_N > 0.0 and math.isfinite(f.noise_floor_N)]
    by_name: dict[str, list[float]] = {}
    for e in errors:
        by_name.setdefault(e.name, []).append(abs(e.relative))
    hits = {
        "confidently_wrong": [is_confidently_wrong(draw, found) for draw, found, _ in rows],
        "laws": [(found.law == "switching") == draw.axis.switches for draw, found in told],
        "within": [abs(e.relative) <= WITHIN for e in errors],
        "covered": [abs(e.error) <= SIGMAS * e.std for e in errors if math.isfinite(e.std)],
        "at_floor": [ratio <= 1.1 for ratio in ratios],
    }
    for name, rate in RATES.items():
        if rate.outcomes:
            chosen = [row for row in rows if not rate.kinds or row[0].kind in rate.kinds]
            hits[name] = [how in rate.outcomes for draw, _, how in chosen if not rate.sized or draw.size >= LEAST_SIZE]
    medians = [(name, float(np.median(relative)), len(relative)) for name, relative in by_name.items()]
    return Summary(
        draws=len(rows),
        rates={name: Share(sum(hits[name]), len(hits[name])) for name in RATES},
        floor_ratio=_quantiles(ratios),
        own_floor_ratio=_quantiles(own)[0],
        seconds=_quantiles([f.seconds for _, f, _ in rows if math.isfinite(f.seconds)]),
        thresholds=tuple(_thresholds(rows)),
        confusion=Counter(pair for draw, found, _ in rows for pair in _pairs(draw, found)),
        outcomes=Counter((draw.kind, how) for draw, _, how in rows),
        worst_parameters=tuple(sorted(medians, key=lambda row: -row[1])),
    )


# --- parameters -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ParameterError:
    """`name`: cause.parameter; `error`: found minus true; `relative`: over the true value; `std` as stated."""

    name: str
    error: float
    relative: float
    std: float


def parameter_errors(machine: Machine, draw: Draw, found: ScoredDiagnosis) -> list[ParameterError]:
    """Errors of sizes, periods and time constants; places (phases, instants) have no scale to be relative to."""
    errors = []
    for hidden in draw.hidden:
        match = next((c for c in found.causes if c[0] == hidden.name), None)
        if match is None:
            continue
        _, values, std = match
        for key, true in _true_values(machine, hidden.name, hidden.parameters, hidden.factors).items():
            if values.get(key) is None or true == 0.0:
                continue
            value = values[key]
            if _has_sign_of_phase(hidden.name, key):
                value, true = abs(value), abs(true)
            # A size counts from where the effect is none: a gain's by what it differs from one.
            none = effect_definition(hidden.name).parameter(key).none if hidden.name in EFFECT_NAMES else 0.0
            scale = true - none
            error = value - true
            errors.append(ParameterError(f"{hidden.name}.{key}", error, error / scale, _number(std.get(key, math.nan))))
    return errors


def _true_values(
    machine: Machine, name: str, parameters: Mapping[str, float], factors: Mapping[str, float]
) -> dict[str, float]:
    if name in EFFECT_NAMES:
        definition = effect_definition(name)
        return {k: v for k, v in parameters.items() if definition.parameter(k).role != "place" and k in definition.main}
    friction, values = machine.friction, {}
    for key, factor in factors.items():
        number = base_number(key)
        if number is not None:
            nominal = getattr(friction, number.name)
            values[reported_name(key)] = factor * float(nominal[number.element(key)] if number.array else nominal)
    return values


def _has_sign_of_phase(name: str, key: str) -> bool:
    """An amplitude whose sign half a turn of the phase makes up for."""
    sine = effect_definition(name).sine if name in EFFECT_NAMES else None
    return sine is not None and key == sine.size


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


# --- confusion --------------------------------------------------------------------------------------------------


def _pairs(draw: Draw, found: ScoredDiagnosis) -> list[tuple[str, str]]:
    """(truth, what it was called): what is right goes with itself, the rest with what is left."""
    rows = list(draw.truth) or [": ".join((draw.kind, *(hidden.name for hidden in draw.hidden)))]
    if found.error:
        return [(row, ERROR) for row in rows]
    names = list(found.names)
    for hidden in draw.truth:  # a rival that is the truth counts as itself
        if hidden not in names and found.verdict == "ambiguous" and hidden in {n for n, _ in found.rivals}:
            instead = next((i for n, i in found.rivals if n == hidden), None)
            gone = next((n for n in names if n == instead), names[0] if names else None)
            if gone is not None and gone not in draw.truth:
                names[names.index(gone)] = hidden
    pairs = [(row, row) for row in rows if row in names]
    wrong = [n for n in names if n not in rows]
    left = [row for row in rows if row not in names]
    empty = UNEXPLAINED if found.verdict == "unexplained" else NOTHING
    if not left:
        return pairs + [("(nothing more)", n) for n in wrong]
    return pairs + [(row, n) for row in left for n in (wrong or [empty])]


def confusion_table(confusion: Mapping[tuple[str, str], int]) -> tuple[list[str], list[str], list[list[int]]]:
    """(rows, columns, counts) of everything that occurs, in the order of the catalogue."""
    order = {name: k for k, name in enumerate((*CAUSE_NAMES, "clean", "weak"))}

    def sort(names: set[str]) -> list[str]:
        return sorted(names, key=lambda n: (order.get(n, len(order)), n))

    rows, columns = sort({a for a, _ in confusion}), sort({b for _, b in confusion})
    return rows, columns, [[confusion.get((row, column), 0) for column in columns] for row in rows]


# --- smallest sizes ---------------------------------------------------------------------------------------------


def _thresholds(rows: Sequence[tuple[Draw, ScoredDiagnosis, str]]) -> list[Threshold]:
    found: dict[str, list[tuple[float, bool]]] = {}
    for draw, said, how in rows:
        if draw.kind in ("single", "base") and how != "error":
            found.setdefault(draw.hidden[0].name, []).append((draw.size, how in FOUND))
        elif draw.kind in ("double", "triple") and how != "error":
            for hidden in draw.hidden:
                listed = {*said.names, *(n for n, _ in said.rivals)}
                found.setdefault(hidden.name, []).append((hidden.size, hidden.name in listed))
    return [
        half_found(name, [s for s, _ in found[name]], [f for _, f in found[name]])
        for name in CAUSE_NAMES
        if name in found
    ]


def half_found(name: str, sizes: Sequence[float], found: Sequence[bool]) -> Threshold:
    """Size at which a logistic curve over log(size) reaches one half.

    A posterior over the curve's middle and slope on a grid, flat in the logarithm of both: unlike a maximum of the
    likelihood it exists where all, or none, were found. Its middle is then just below, or above, what was tried.
    """
    middles = np.linspace(math.log(3e-3), math.log(1.0), 240)
    slopes = np.geomspace(1.5, 12.0, 12)
    x, hit = np.log(np.asarray(sizes))[:, None, None], np.asarray(found)[:, None, None]
    z = slopes[None, None, :] * (x - middles[None, :, None])
    # 3 % of anything goes wrong at any size.
    p = 0.03 * 0.5 + 0.97 / (1.0 + np.exp(-np.clip(z, -60.0, 60.0)))
    logarithm = np.where(hit, np.log(p), np.log1p(-p)).sum(axis=0)
    weight = np.exp(logarithm - logarithm.max()).sum(axis=1)
    below = np.cumsum(weight) / weight.sum()
    low, middle, high = (float(math.exp(middles[int(np.searchsorted(below, q))])) for q in (0.1, 0.5, 0.9))
    return Threshold(name, middle, low, high, len(sizes))


# --- in words ---------------------------------------------------------------------------------------------------


def summary_text(summary: Summary) -> str:
    """The benchmark as a page of text."""
    s = summary
    lines = [
        f"{s.draws} logs; sizes are peak forces over the Coulomb level, rates count those from {LEAST_SIZE:.0%} on",
        "",
    ]
    for name, share in s.rates.items():
        low, high = share.interval
        value = "-" if not share.total else f"{100 * share.value:5.1f} %  ({100 * low:.0f} to {100 * high:.0f})"
        lines.append(
            f"{RATES[name].title:<50} {share.hits:>4} of {share.total:<4} {value:<26} {RATES[name].goal}".rstrip()
        )
    lines += [
        "",
        f"held-out residual over noise floor: median {s.floor_ratio[0]:.3f}, 90 % below {s.floor_ratio[1]:.3f}; "
        f"floor over known noise: {s.own_floor_ratio:.3f}",
        f"time per log: median {s.seconds[0]:.1f} s, 90 % below {s.seconds[1]:.1f} s",
        "",
        "found half of the time from (80 % interval), of the Coulomb level",
    ]
    lines += [
        f"  {t.name:<30} {100 * t.size:6.1f} %  ({100 * t.low:.1f} to {100 * t.high:.1f})   {t.draws} logs"
        for t in s.thresholds
    ]
    lines += ["", "confusion: hidden -> called"]
    rows, columns, counts = confusion_table(s.confusion)
    for row, line in zip(rows, counts, strict=True):
        own = f"{line[columns.index(row)] if row in columns else 0} of {sum(line)}"
        others = ", ".join(f"{c} {n}" for c, n in zip(columns, line, strict=True) if n and c != row)
        lines.append(f"  {row:<30} {own:>9}" + (f"   {others}" if others else ""))
    if s.worst_parameters:
        lines += ["", "median error of parameters, the largest ten"]
        lines += [f"  {name:<50} {100 * error:6.1f} %   {count}" for name, error, count in s.worst_parameters[:10]]
    return "\n".join(lines)


def summary_json(summary: Summary) -> dict[str, Any]:
    """Return plain content: the rates under their own names."""
    content = vars(summary) | {
        name: {"hits": share.hits, "total": share.total, "share": share.value, "interval": share.interval}
        for name, share in summary.rates.items()
    }
    del content["rates"]
    for key in ("confusion", "outcomes"):
        content[key] = [[a, b, n] for (a, b), n in sorted(content[key].items())]
    return content | {"thresholds": [asdict(threshold) for threshold in summary.thresholds]}


def _quantiles(values: Sequence[float]) -> tuple[float, float]:
    if not values:
        return math.nan, math.nan
    median, high = np.quantile(values, (0.5, 0.9))
    return float(median), float(high)
