"""Drawn logs through the command line, in this process, and what came of each."""

import json
import re
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, Literal

import numpy as np
from click.testing import CliRunner

from sgms_bench.logs.cases import Rng, draw_truth
from sgms_bench.logs.claims import false_sentences, is_judged
from sgms_bench.logs.faults import CLOCK, FAULTS, RESAMPLE, SIGNED, TRUTHS, Case, Recorder, can_have, draw_recorder
from sgms_bench.logs.formats import FORMATS
from sgms_mhe.api.inputs import read_log
from sgms_mhe.cli import cli
from sgms_mhe.machine import log_table, read_log_table, table_of_flags
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.tables import CsvTable

Came = Literal["right", "wrong", "false", "traceback"]
INERTIA_NEAR: Final = 0.05
COULOMB_NEAR: Final = 0.1
"""Relative errors up to which an identified number is right."""
WELL_PREDICTED: Final = 0.2
"""Residual of the true machine over the force's standard deviation, up to which a prediction is right."""


@dataclass(frozen=True)
class Outcome:
    """Outcome of one draw, and the reason where it is not right; empty where it is."""

    seed: int
    format: str
    fault: str
    came: Came
    reason: str = ""


class WrongError(Exception):
    """Something else came than what must; `came` says of which kind."""

    def __init__(self, came: Came, reason: str) -> None:
        self.came: Came = came
        super().__init__(reason)


def draw(seed: int) -> tuple[str, str, Recorder, Case, Rng]:
    """(format, fault, recorder, case, the rest of the chance) of a seed; formats and faults take turns."""
    rng = np.random.default_rng(seed)
    names = [name for name, chosen in FORMATS.items() if chosen.is_there]
    name = names[seed % len(names)]
    faults = [fault for fault in FAULTS if can_have(FORMATS[name], fault)]
    fault = faults[rng.integers(len(faults))]
    recorder = draw_recorder(rng, TRUTHS.get(fault, draw_truth)(rng), FORMATS[name])
    return name, fault, recorder, FAULTS[fault](recorder, rng), rng


def run_draw(seed: int) -> Outcome:
    """Write a drawn log, read it as its owner would, and judge what comes."""
    name, fault, recorder, case, _ = draw(seed)
    try:
        with TemporaryDirectory() as folder:
            Trial(Path(folder), recorder, case, name).run()
    except WrongError as error:
        return Outcome(seed, name, fault, error.came, str(error))
    return Outcome(seed, name, fault, "right")


WORDS: Final = ("problems", "notes", "limits", "warnings", "open")
"""Keys of a result that hold sentences."""


@dataclass(frozen=True)
class Answer:
    """Exit code and words of a command."""

    code: int
    stdout: str
    stderr: str

    @property
    def content(self) -> dict[str, Any]:
        """The JSON that was printed; empty where none was."""
        return dict(json.loads(self.stdout)) if self.stdout.startswith("{") else {}

    @property
    def sentences(self) -> list[str]:
        """Everything that it says in words."""
        said = [sentence for key in WORDS for sentence in self.content.get(key, [])]
        return [*said, *self.stderr.splitlines()]


@dataclass(frozen=True)
class Trial:
    """One case in a folder."""

    folder: Path
    recorder: Recorder
    case: Case
    format: str

    def run(self) -> None:
        """Raise WrongError for the first thing that is not right."""
        chosen, case = self.recorder.format, self.case
        chosen.write(self.log, case.channels)
        if case.beside is not None:
            case.beside(self.folder)
        (self.folder / RESAMPLE).write_text("[log]\nresample = true\n")
        axis, truth = self.recorder.truth.axis, self.recorder.truth
        self.machine.write_text(axis.machine_file(truth.log.rate, truth.fastest))
        self._inspect()
        options = case.options
        if case.refusal:
            if case.remedy is None:
                return
            options = (*options, *self._locate(case.remedy))
            self._read(options)
        for command in case.commands:
            self._command(command, options)

    @property
    def log(self) -> Path:
        """The file."""
        return self.folder / f"log{self.recorder.format.suffix}"

    @property
    def machine(self) -> Path:
        """The true machine's file."""
        return self.folder / "drawn.toml"

    def _locate(self, options: Sequence[str]) -> tuple[str, ...]:
        return tuple(str(self.folder / o) if o in (RESAMPLE, CLOCK, SIGNED) else o for o in options)

    def _invoke(self, *arguments: str | Path) -> Answer:
        result = CliRunner().invoke(cli, [str(argument) for argument in arguments])
        if result.exit_code not in (0, 1, 2) or not isinstance(result.exception, SystemExit | None):
            error = result.exception
            raise WrongError("traceback", "".join(traceback.format_exception(error)) if error else result.output)
        answer = Answer(result.exit_code, result.stdout, result.stderr)
        for sentence in answer.sentences:
            for false in false_sentences(sentence, self.case):
                raise WrongError("false", f"{arguments[0]}: {false}")
        return answer

    def _inspect(self) -> None:
        """Inspect the log as it came, and read it where it must be read."""
        case = self.case
        machine = ("--machine", self.machine) if case.on_machine else ()
        options = self._locate(case.options)
        answer = self._invoke("inspect", self.log, *options, *machine, "--json")
        if answer.code == 2:
            raise WrongError("wrong", f"no log: {answer.stderr}")
        content = answer.content
        problems = " ".join(content["problems"])
        for sentence in (*content["problems"], *content["notes"]):
            if not is_judged(sentence) and not self._is_of_the_format(sentence):
                raise WrongError("wrong", f"a sentence that nobody judges: {sentence}")
        if case.refusal:
            if not problems:
                raise WrongError("wrong", f"not refused; {case.refusal} is the reason")
            self._check(case.refusal, problems)
            return
        if problems:
            raise WrongError("wrong", f"refused: {problems}")
        (self._read if case.on_machine else self._compare)(case.options)

    def _is_of_the_format(self, sentence: str) -> bool:
        """Return True for a note on the layout of the file, which has it."""
        layout = {
            "summary": "last sample",
            "scope": "the first: EOF",
            "long format": "a line holds one variable",
            "names in rows": "time is counted in the step",
        }
        return any(key in self.format and words in sentence for key, words in layout.items())

    def _check(self, pattern: str, text: str) -> None:
        if re.search(pattern, text) is None:
            raise WrongError("false", f"{pattern} is the reason, not {text}")

    def _read(self, options: Sequence[str]) -> None:
        """Inspect the log with options, which must read it."""
        answer = self._invoke("inspect", self.log, *self._locate(options), "--json")
        if answer.code:
            raise WrongError("wrong", f"with {' '.join(options)}: {answer.stdout[-600:]}{answer.stderr}")
        self._compare(options)

    def _compare(self, options: Sequence[str]) -> None:
        """Compare what is read with what was recorded."""
        found = read_log(self.log, table=self._table(self._locate(options)), note=lambda _: None)
        for problem in differences(found, self.case.expected, self.case.tolerance):
            raise WrongError("wrong", problem)

    def _table(self, options: Sequence[str]) -> dict[str, Any]:
        """The table [log] that options make, as the command line does."""
        pairs = list(zip(options[::2], options[1::2], strict=True))
        own = [read_log_table(Path(value)) for option, value in pairs if option == "--log"]
        said = dict(pairs)
        units = dict(value.split("=") for option, value in pairs if option == "--unit")
        numbers = [float(said[key]) if key in said else None for key in ("--rate", "--wrap", "--force-scale")]
        return log_table(own[0] if own else {}, table_of_flags(numbers[0], numbers[1], units, numbers[2]))

    def _command(self, name: str, options: Sequence[str]) -> None:
        """Run another command along the log; `!name` must refuse it, `?name` may."""
        verb, options = name.lstrip("!?"), self._locate(options)
        out = self.folder / ("found.toml" if verb == "identify" else "out.csv")
        machine = () if verb == "identify" else (self.machine,)
        if name == "!identify":
            options = self._locate(self.case.options)
        answer = self._invoke(verb, *machine, self.log, *options, "--out", out, "--json")
        if answer.code == 2 and name[0] in "!?":
            if not is_judged(answer.stderr):
                raise WrongError("wrong", f"a sentence that nobody judges: {answer.stderr}")
            return
        if answer.code or name[0] == "!":
            raise WrongError("wrong", f"{verb}: exit code {answer.code}: {answer.stderr[-600:]}")
        content = answer.content
        if verb == "identify" and name[0] != "?":
            self._judge_identify(content)
        if verb == "predict":
            self._judge_predict(content)

    def _judge_identify(self, content: dict[str, Any]) -> None:
        axis, numbers = self.recorder.truth.axis, {n["name"]: n for n in content["numbers"]}
        wanted = {"coulomb": (axis.coulomb, COULOMB_NEAR)}
        if "no force" not in self.case.facts:
            wanted["mass"] = (axis.mass, INERTIA_NEAR)
        for name, (true, near) in wanted.items():
            found = next((n["value"] for key, n in numbers.items() if key.split("_")[0] in (name, "inertia")), None)
            found = numbers[name]["value"] if name in numbers else found
            if found is None or abs(found / true - 1.0) > near:
                raise WrongError("wrong", f"identify: {name} = {found}, true is {true:.5g}")

    def _judge_predict(self, content: dict[str, Any]) -> None:
        truth = self.recorder.truth
        rms = next(value for key, value in content.items() if key.startswith("residual_rms"))
        whole = float(np.std(truth.log.force_N))
        if rms > WELL_PREDICTED * whole:
            raise WrongError("wrong", f"predict: {rms:.3g} of {whole:.3g} is left of the true machine")


def differences(found: Log, expected: Log, tolerance: float) -> Iterator[str]:
    """Differences of two logs: rate, length, time, columns, by more than a share of the range."""
    if abs(found.rate / expected.rate - 1.0) > 1e-3:
        yield f"rate {found.rate:.6g}, {expected.rate:.6g} Hz"
    elif abs(len(found) - len(expected)) > (2 if tolerance > FEW else 0) or found.kind != expected.kind:
        yield f"{len(found)} samples of a {found.kind} axis, {len(expected)} of a {expected.kind} one"
    else:
        n = min(len(found), len(expected))
        for name in ("position_m", "force_N"):
            a, b = found.columns[name][:n], expected.columns[name][:n]
            both = np.isfinite(a) & np.isfinite(b)
            if np.mean(np.isfinite(a) != np.isfinite(b)) > (0.01 if tolerance > FEW else 0.0):
                yield f"{name}: other samples are missing"
            error = float(np.max(np.abs(a - b)[both], initial=0.0)) / max(float(np.ptp(b[both])), 1e-300)
            if name == "position_m" and tolerance > FEW:
                error = float(np.sqrt(np.mean((a - b)[both] ** 2))) / float(np.ptp(b[both]))
            if error > tolerance and not (name == "force_N" and tolerance > FEW):
                yield f"{name}: off by {error:.2g} of its range"


FEW: Final = 1e-5
"""Tolerance beyond which times were interpolated."""


def run_draws(seeds: Sequence[int], progress: Callable[[Outcome], None]) -> list[Outcome]:
    """Run draws one after the other."""
    outcomes = []
    for seed in seeds:
        outcomes.append(run_draw(seed))
        progress(outcomes[-1])
    return outcomes


def tables(outcomes: Sequence[Outcome]) -> tuple[CsvTable, CsvTable]:
    """Return the outcomes by format, and by fault."""
    return _table("format", outcomes), _table("fault", outcomes)


def _table(key: Literal["format", "fault"], outcomes: Sequence[Outcome]) -> CsvTable:
    kinds = list(dict.fromkeys([*FORMATS] if key == "format" else [*FAULTS]))
    rows: list[dict[str, str | int | float]] = []
    for kind in (*kinds, "all"):
        came = Counter(o.came for o in outcomes if kind in ("all", getattr(o, key)))
        if came:
            rows.append({key: kind, "draws": came.total(), **{name: came[name] for name in CAME}})
    return CsvTable(f"logs by {key}", {key: "", "draws": "", **dict.fromkeys(CAME, "")}, rows)


CAME: Final[tuple[Came, ...]] = ("right", "wrong", "false", "traceback")
"""Read right or refused rightly; something else; a sentence that is not true; an end in a traceback."""
