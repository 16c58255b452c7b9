"""Faults in emitted C that the package's self-test has to notice: by hand all, at random most (make verify: more)."""

import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from sgms_bench.verification import mutation
from sgms_bench.verification.faults import FAULTS, Fault
from sgms_bench.verification.mutation import Campaign, Verdict, check_self_test
from sgms_bench.verification.specimens import specimen
from sgms_mhe.configuration import load_machine
from sgms_mhe.emission.package import Package, emit_package

Tool = Callable[[str], str]


@pytest.fixture(scope="module")
def package() -> Package:
    """The package that the faults are written for."""
    return emit_package(load_machine("etel_xy"))


OPTIMISED = mutation.FLAGS
SECONDS = 4
"""Of the processor, of one run that does not come back: others take a tenth of one."""


@pytest.fixture(scope="module")
def campaign(package: Package, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Campaign]:
    """Programs of its self-test; numbers are the same at any level, and -O0 takes the compiler a third of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mutation, "SECONDS", SECONDS)
        patch.setattr(mutation, "FLAGS", tuple("-O0" if flag == "-O1" else flag for flag in OPTIMISED))
        yield Campaign(package, tmp_path_factory.mktemp("campaign"))


def test_fault_without_effect_counts_for_nothing(package: Package, campaign: Campaign, require_tool: Tool) -> None:
    """The same bytes, a function that nothing calls; and one that neither self-test nor replay can see: a text."""
    require_tool("gcc")
    source = package.files["etel_xy.c"]
    more = "\nint etel_xy_more(void);\nint etel_xy_more(void)\n{\n    return 1;\n}\n"
    assert campaign.judge({**package.files, "etel_xy.c": f"{source}\n"}) is Verdict.SAME
    assert campaign.judge({**package.files, "etel_xy.c": source + more}) is Verdict.UNCHANGED
    other_text = source.replace("faster than max_velocity", "slower than max_velocity")
    assert campaign.judge({**package.files, "etel_xy.c": other_text}) is Verdict.MISSED


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.what)
def test_fault_is_noticed(fault: Fault, package: Package, campaign: Campaign, require_tool: Tool) -> None:
    require_tool("gcc")
    assert campaign.judge(fault.spoil(dict(package.files), "etel_xy")) is Verdict.NOTICED


@pytest.mark.slow
def test_mutants_are_noticed(require_tool: Tool, monkeypatch: pytest.MonkeyPatch) -> None:
    """As many of these few as chance lets be of the many that `make verify` draws, behind an optimising compiler."""
    require_tool("gcc")
    monkeypatch.setattr(mutation, "specimens", lambda: map(specimen, ("ekf", "switching")))
    monkeypatch.setattr(mutation, "FAULTS", ())
    monkeypatch.setattr(mutation, "FLAGS", OPTIMISED)
    monkeypatch.setattr(mutation, "SECONDS", SECONDS)
    _, *of_classes = check_self_test(18, 7, print)
    # Not noticed by any judge: a few in a hundred, and what chance adds.
    for at_random, together in (of_classes[:2], of_classes[2:]):
        counted, noticed = map(int, re.findall(r"(\d+) (?:mutants|noticed)", at_random.tried))
        assert noticed > 0.8 * counted - 2.0 * math.sqrt(0.8 * 0.2 * counted), at_random.failures
        assert re.match(rf"{counted} mutants that are not equivalent, ", together.tried) and len(together.failures) <= 2


@pytest.mark.slow
def test_a_second_origin_and_filters_that_settle_early_are_noticed(tmp_path: Path, require_tool: Tool) -> None:
    """A second origin counts from the first; filters settle as long after a first reading as after a gap."""
    require_tool("gcc")
    package = emit_package(specimen("signals"))
    campaign, files = Campaign(package, tmp_path), package.files
    twice = files["specimen_signals.c"].replace("-= origin - before", "-= origin + before")
    assert campaign.judge({**files, "specimen_signals.c": twice}) is Verdict.NOTICED
    zero, text = "m->counts[2] = 0;", files["sgms_filter.h"]
    places = [found.start() for found in re.finditer(re.escape(zero), text)]
    assert len(places) == 3
    for at in places:
        early = text[:at] + zero.replace("0;", "1;") + text[at + len(zero) :]
        assert campaign.judge({**files, "sgms_filter.h": early}) is Verdict.MISSED


SURVIVED = {
    "saved while an update has written it": (
        "copy(saved->theta, self->estimate",
        "copy(saved->theta, self->parameters",
    ),
    "every state by the noise of the first": (
        "map->x[i] / self->settings.state[i]",
        "map->x[i] / self->settings.state[0]",
    ),
    "reset to the parameters in use": (
        "    copy(self->parameters.theta, self->estimate.theta, PARAMETERS);\n    start_window(self, zero, NULL);",
        "    start_window(self, zero, NULL);",
    ),
    "reset that keeps errors that stay": (
        "    start_window(self, zero, NULL);\n    start_lasting(self);\n}",
        "    start_window(self, zero, NULL);\n}",
    ),
    "start again that keeps them": (
        "    start_window(self, self->estimate.state, NULL);\n    start_lasting(self);\n",
        "    start_window(self, self->estimate.state, NULL);\n",
    ),
    "parameter set into the old window": ("    start_window(self, x, self->estimate.root);\n", ""),
    "sweep of the one before": ("        self->sweep.back = back > self->sweep.back ? back : self->sweep.back;\n", ""),
    "mean of the prior at zero": ("factor[i * FACTOR_WIDTH + FACTOR_ROWS] = inverse_sd[i] * x[i];", ";"),
    "filters of an axis at rest that never end": ("    sgms_drop_rest(self->chain.lowpass, SGMS_FILTER_STATES);\n", ""),
    "shifts of the window not counted": (
        "self->sweep.shifts = sgms_place(self->sweep.shifts, DRIFT_INTERVAL - 1) + 1;",
        "self->sweep.back = sgms_place(self->sweep.shifts, DRIFT_INTERVAL - 1) + 1;",
    ),
    "drift not taken in": ("    sgms_qr_grow(factor, FACTOR_ROWS, PARAMETERS, growth, work);\n", ""),
    "friction of an axis before": ("    self->estimate.friction = 0.0;\n", "    self->interval.friction = 0.0;\n"),
    "test ratio not loaded": ("    self->estimate.ratio = saved->ratio;\n", ""),
    "upper bounds for the drift": ("copy(settings->upper, upper_bound", "copy(settings->drift, upper_bound"),
    "slow motion never counted": ("self->interval.net += self->input", "self->interval.friction += self->input"),
    "sum of means over another": (
        "sum = add_bits(sum, self->lasting.theta, PARAMETERS);",
        "sum = add_bits(sum, self->estimate.theta, PARAMETERS);",
    ),
    "set-point not kept": ("        self->compensation.ahead[0] = velocity;\n", ""),
    "filters that need not settle after another mass": (
        "    self->chain.counts[2] = 0; /* the filters hold friction by the old one */\n",
        "",
    ),
    "work left to feedback()": ("            work(self);\n            left -= cost;\n", "            left -= cost;\n"),
    "spread of the parameters themselves": (
        "widen_root(self, square, variance, self->estimate.spread, scratch);",
        "widen_root(self, square, variance, self->estimate.theta, scratch);",
    ),
    "loaded parameters not in use": ("    copy(self->parameters.theta, saved->theta, PARAMETERS);\n", ""),
}
"""Mutants of statements that no self-test noticed once."""


@pytest.mark.parametrize("what", SURVIVED)
def test_mutant_that_survived_once_is_noticed(
    what: str, package: Package, campaign: Campaign, require_tool: Tool
) -> None:
    require_tool("gcc")
    (old, new), source = SURVIVED[what], package.files["etel_xy.c"]
    assert source.count(old) == 1
    assert campaign.judge({**package.files, "etel_xy.c": source.replace(old, new)}) is Verdict.NOTICED
