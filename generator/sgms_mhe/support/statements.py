"""Judgements: each in one object with its numbers and the rule behind it; every output renders its sentence."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Final, Literal, Self

from sgms_mhe.support.numbers import SIGMAS, interval

Sure = Literal["yes", "no", "open"]


_FROM_TO: Final = "the residual on data not used in the fit goes from {before_N:.3g} to {value:.3g} {unit} RMS."
_PLAIN: Final = "{value:.3g} {unit}, Coulomb and viscous friction alone {plain_N:.3g} {unit}"
_SHARES: Final = "{before:.3g} % of the {push}'s RMS before, {value:.3g} % after"


class Rule(Enum):
    """Rules by which statements are made: kind of the statement, how sure it is, and its sentence.

    Braces take a field of the statement or one of its numbers. The sentence of a number follows its value.
    """

    # a diagnosis as a whole; value: residual on held-out data
    STILL = "verdict", "no", "There is no excitation in this record: the axis hardly moves, which tells no friction."
    ADEQUATE = "verdict", "yes", "The simulation explains the record: {value:.3g} {unit} RMS left, nothing is named."
    ROUGH = "verdict", "yes", "With the record's numbers the simulation explains it; {value:.3g} {unit} RMS are left."
    EXPLAINED = "verdict", "yes", "{names}: " + _FROM_TO
    AMBIGUOUS = "verdict", "open", "{names}, but {others} would fit as well: " + _FROM_TO
    UNEXPLAINED = "verdict", "no", "{names}, and more that no known effect accounts for: " + _FROM_TO
    UNNAMED = "verdict", "no", "{value:.3g} {unit} RMS are left that no known effect accounts for; nothing is named."
    HIDDEN = "verdict", "no", "{value:.3g} {unit} RMS are left, most of it noise of the encoder; named: {names}."
    REFUSED = "verdict", "no", "{reason}"
    # causes; value and interval: of the force that they explain on held-out data
    FOUND = "cause", "yes", "{about}: explains {value:.3g} {unit} rms on held-out data"
    TRANSFERS = "cause", "yes", "{about}: explains {value:.3g} {unit} rms on held-out data; transfers"
    NO_GAIN = "cause", "open", "{about}: the force that it explains on held-out data may be none"
    CHANCE = "cause", "open", "{about}: noise looks like it with a chance of {p_value:.2f}"
    HAS_RIVAL = "cause", "open", "{about}: another cause fits as well"
    COMBINED = "cause", "open", "{about}: known together with another cause alone"
    PART_OF_CURVE = "cause", "open", "{about}: may be a part of a curve over speed of another form"
    PLAY = "cause", "open", "{about}: play of about {value:.2g} {unit} lowers a free run's cost by {percent:.2g} %"
    NO_PLAY = "cause", "no", "{about}: refused, {value:.2g} {unit} of play raise a free run's cost by {percent:.2g} %"
    PLAY_UNTOLD = (
        "cause",
        "open",
        "{about}: not determined, up to {value:.2g} {unit} of play change a free run's cost by {percent:.2g} %, less "
        "than its spread over runs, {spread:.2g} %",
    )
    NAMELESS = "cause", "open", "{about}: uncertain or not the same all over the record, no cause, but it predicts"
    UNEQUAL = "cause", "no", "{about}: its size differs between the records"
    FIRST_ALONE = "cause", "no", "{about}: of the first record alone, on another one it gains nothing significant"
    NOT_EVERYWHERE = "cause", "no", "{about}: not of every record, on one it makes the residual larger"
    RIVAL = "choice", "open", "{about}: both fit this record as well"
    COMBINATION = "combination", "open", "{about}: the record tells {first} {weight:+.4g} {second} = {shown} alone"
    # the rest of a diagnosis
    LEFT = "residual", "no", "{value:.3g} {unit} are left, {ratio:.2g} times the noise: by no cause in the catalogue"
    ENCODER = "residual", "no", "{value:.3g} {unit} are left, about {encoder_N:.2g} of that noise of the encoder"
    ONE_CLOCK = "residual", "open", "the motion repeats itself every {value:.3g} s: force in time, or with the motion?"
    ONE_SPEED = "residual", "open", "the motion has one speed: does a force come again in time or in place?"
    SMOOTHED = "residual", "open", "{about}: only {percent:.3g} % pass velocity_cutoff: its {size} is about {value:.3g}"
    NOT_RECOMMENDED = "file", "no", "the extended machine is not recommended: on {about} it leaves " + _PLAIN
    LEARNED = "learned", "yes", "learned, no name: over {about}, {percent:.0f} % of the residual on held-out data"
    LEARNED_OUT = "learned", "no", "learned, left out of the file: over {about}, {percent:.0f} % of the residual"
    LEARNED_THERE = "learned", "yes", "what was learned: on {about} {before_N:.3g} {unit} go to " + _PLAIN
    LEARNED_WORSE = "learned", "no", "what was learned is left out: on {about} {before_N:.3g} {unit} go to " + _PLAIN
    SEEN = "error", "yes", "{about}, unseen data: " + _SHARES + "; Coulomb and viscous friction {plain:.3g} %"
    WRITTEN = "error", "yes", "{about}, as the files have it: " + _SHARES
    FREE_RUN = "error", "yes", "{about}, free run of the files: {before:.3g} {unit} rms before, {value:.3g} after"
    PREDICTION = "error", "yes", "estimator on {about}: {before_N:.3g} to {value:.3g} {unit} rms, {percent:.0f} % less"
    FITTED = "error", "yes", "held-out residual {value:.3g} {unit} rms of {friction_N:.3g}, noise floor {floor_N:.3g}"
    RAN = "error", "yes", "{about} leave {value:.3g} {unit} on average over {count:.0f} runs, at most {most:.3g}"
    # numbers
    DETERMINED = "number", "yes", ""
    REFITTED = "number", "yes", "refitted"
    REFUTED = "number", "yes", "refuted: the file has {file:.4g}"
    OF_DOUBTFUL = "number", "open", "of a cause that is open"
    DIFFERING = "number", "no", "differs between the records: {values}; no one number holds"
    VAGUE = "number", "no", "the record does not determine it"
    UNSEEN = "number", "no", "the record does not show it"
    STAND_IN = "number", "no", "not determined: assumed"
    DEFAULT = "number", "no", "not determined: the default"
    AT_LIMIT = "number", "no", "not determined: at its limit"
    ALIKE = "number", "open", "ambiguous: or {others}"
    IN_DOUBT = "number", "open", "measurements contradict the model at the end"
    MASS_SEEN = "number", "yes", "of the motion, as the {push}'s scale has it"
    MASS_HOLDS = "number", "yes", "as given; the motion shows {motion}"
    MASS_MOVED = "number", "yes", "of the motion; {given:g} was given"
    MASS_UNSEEN = "number", "no", "as given; the motion does not show it"
    MASS_GIVEN = "number", "no", "as given; friction alone was recorded"
    MASS_FREE = "number", "no", "friction alone was recorded: assumed, no other number depends on it"
    NO_FORCE = "number", "yes", "none that the motion shows"
    # the rest of an identification
    SIGN = "sign", "yes", "the sign of the {about} is right: {seen}"
    SIGN_OPEN = "sign", "open", "the sign of the {about} does not show"
    NOISE = (
        "noise",
        "yes",
        "noise of the {about}: {value:.2g} {unit} at {rate:g} Hz; position: steps of {step:.2g} {length}",
    )
    SCALE = "choice", "open", "{about}: {given:g} {unit} was given, {motion} seen; or {push} is {ratio:.4g} times real"
    LAW = "law", "open", "{about}: switching or smooth is open ({other:.3g}, {value:.3g} {unit} left); sgms is taken"
    LAW_TOLD = "law", "yes", "{about}: {law}"
    UNEXCITED = "cause", "no", "{about}: not determined"
    COVERED = "cause", "no", "{about}: not determined, though the motion has {motion}: noise, or other forces, hide it"
    TOO_SLOW = "cause", "no", "{about}: not determined: no motion is faster than {value:.2g} {unit}, within its rise"
    ONE_WAY = "cause", "no", "{about}: not determined: forth the axis moves at {value:.2g}, back at {back:.2g} {unit}"
    LIKE_MASS = "cause", "no", "{about}: not determined, this motion does not distinguish it from the {inert}, as given"
    UNTOLD = "cause", "open", "{about}: ambiguous, this motion does not distinguish it from {other}"
    TIMING = "timing", "open", "the {push} comes {value:.2g} ms {side} the motion that it makes: {force_N:.2g} {unit}"
    UNRESOLVED = "element", "no", "{about}: breaks away within {value:.2g} {unit}, earlier than the log resolves"
    NOT_REACHED = "element", "no", "{about}: its level is open, {travel:.2g} {unit} of travel are too few"
    NOT_ALONE = "element", "no", "{about}: not determined by itself"
    MISFIT = "residual", "open", "residual: {value:.2g} {unit} rms is left that nothing here explains, beyond the noise"
    REFITTED_MOTION = "file", "yes", "refitted to the motion: {value:.3g} {unit} rms in free runs, before {before:.3g}"
    BENT = "file", "open", "least squares leaves {value:.3g} {unit}, this file {own:.3g}, but {timed:.3g} beside timing"
    NO_MASS = "file", "open", "least squares leaves {value:.3g} {unit}, less than this file, without {inert}"
    PLAIN = "file", "yes", "the file is that of least squares, {value:.3g} {unit} left; a search leaves {searched:.3g}"
    PLAIN_ALONE = "file", "yes", "the file is that of least squares: beside what is left no elements show"
    # weights of an estimator, rows of a fleet, a run that was watched
    LIKELIER = "weight", "yes", "{about}: {value:g} by the log, {file:g} in the file"
    EQUAL = "weight", "open", "{about}: {value:g} stays, the log does not distinguish others from it"
    LIKELIEST = "weight", "yes", "{about}: {value:g}, as it is"
    PREDICTED = "error", "yes", "{about}: {before:.3g} {unit} rms before, {value:.3g} after"
    RATIO = "error", "yes", "{about}: {before:.3g} before, {value:.3g} after; loss {start:.4f} and {end:.4f}"
    CROWDED = "residual", "open", "{about} is beyond twice velocity_cutoff: such measurements share their noise"
    FAILED = "row", "no", "failed: {about}: {reason}"
    DONE = "row", "yes", "{about}: {verdict}"
    DOUBTFUL = "row", "open", "{about}: {verdict}"
    OUTSIDE = "band", "no", "left its band: {about}: {shown} {unit}, band {low:.4g} to {high:.4g} of {count:.0f} {of}"
    MOVES = "trend", "yes", "moves steadily: {about}: {shown} {unit} over {days:.0f} days"
    CHANGED = "change", "yes", "changed: {about}: {shown} {unit} from {when} on ({log})"
    FAULTLESS = "verdict", "yes", "faults seen: none"
    FAULTY = "verdict", "no", "faults seen: {value:.0f}"
    FAULT = "fault", "no", "  {about}: {start_s:.2f} to {end_s:.2f} s, {updates} updates"
    REMARK = "log", "open", "mind: {about}"

    def __init__(self, kind: str, sure: Sure, text: str) -> None:
        self.kind, self.sure, self.text = kind, sure, text


REASON_ELSEWHERE: Final = frozenset(
    {Rule.HAS_RIVAL, Rule.COMBINED, Rule.UNEQUAL, Rule.OF_DOUBTFUL, Rule.STAND_IN, Rule.DEFAULT, Rule.ALIKE}
)
"""Rules of what is open for a reason that another statement gives."""


@dataclass(frozen=True)
class Statement:
    """A judgement.

    Attributes:
        rule: by which it was made.
        about: name of its subject, as files of this kind of axis have it.
        value: SI; NaN where it has none.
        interval: two standard deviations to either side, or 95 % by blocks; None where it is not known.
        unit: of both.
        numbers: that the rule decides on, and names its sentence needs.
        next: motion, or other move, that would decide it; None where nothing is to be done.
    """

    rule: Rule
    about: str
    value: float = math.nan
    interval: tuple[float, float] | None = None
    unit: str = ""
    numbers: Mapping[str, float | str] = field(default_factory=dict)
    next: str | None = None

    @classmethod
    def of_number(
        cls, rule: Rule, about: str, value: float, std: float, unit: str = "", **numbers: float | str
    ) -> Self:
        """Return the statement on a number with its standard deviation; NaN or 0: it has none."""
        reach = SIGMAS * std
        return cls(
            rule, about, value, (value - reach, value + reach) if 0.0 < reach < math.inf else None, unit, numbers
        )

    @property
    def kind(self) -> str:
        """Return the kind of the judgement."""
        return self.rule.kind

    @property
    def sure(self) -> Sure:
        """Return how far it holds."""
        return self.rule.sure

    @property
    def std(self) -> float:
        """Return one standard deviation by the interval; NaN where there is none."""
        return math.nan if self.interval is None else (self.interval[1] - self.interval[0]) / (2.0 * SIGMAS)

    @property
    def shown(self) -> str:
        """Return the value with two standard deviations, for people."""
        return interval(self.value, self.std)

    @property
    def text(self) -> str:
        """Return the rule's words with the numbers in them."""
        fields = {"about": self.about, "value": self.value, "shown": self.shown, "unit": self.unit}
        return self.rule.text.format(**fields, **self.numbers)

    @property
    def sentence(self) -> str:
        """Return the one sentence on it."""
        if self.kind != "number":
            return self.text
        number = f"{self.about} = {self.shown} {self.unit}".rstrip()
        if not math.isfinite(self.value):
            return f"{self.about}: {self.text}"
        return f"{number}; {self.text}" if self.text else number

    @property
    def advice(self) -> str:
        """Return the sentence, and the move that would decide it."""
        return f"{self.sentence}. Needed: {self.next}" if self.next else self.sentence

    @property
    def line(self) -> str:
        """Return the sentence as lists of a terminal and comments of a file have it."""
        return self.sentence if self.sure == "yes" else f"open: {self.sentence}"

    def to_json(self) -> dict[str, Any]:
        """Return its entry in a file, keys of a linear axis."""
        return {
            "kind": self.kind,
            "about": self.about,
            "value": self.value,
            "interval": self.interval and list(self.interval),
            "unit": self.unit,
            "sure": self.sure,
            "why": {"rule": self.rule.name.lower().replace("_", " "), "numbers": dict(self.numbers)},
            "next": self.next,
        }


def list_open(statements: Iterable[Statement]) -> tuple[Statement, ...]:
    """Return the open ones but for the verdict, each reason once; and those on a file as a whole."""
    return tuple(
        s
        for s in statements
        if s.kind == "file" or (s.sure != "yes" and s.kind != "verdict" and s.rule not in REASON_ELSEWHERE)
    )
