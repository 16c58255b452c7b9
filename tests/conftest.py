"""Fixtures shared by all tests, and the rule that in CI nothing is skipped in silence."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any

import hypothesis
import pytest

from sgms_mhe.support.errors import speak_to_command_line

os.environ.setdefault("MPLBACKEND", "Agg")
if "PYTEST_XDIST_WORKER" in os.environ:  # the cores are shared out already
    os.environ.setdefault("SGMS_MHE_WORKERS", "1")

REPO_ROOT = Path(__file__).resolve().parents[1]
MARKED_TOOLS = {
    "needs_arm": ("arm-none-eabi-gcc", "qemu-system-arm"),
    "needs_riscv": ("riscv64-unknown-elf-gcc", "qemu-system-riscv32"),
}
"""Cross compiler and emulator that the tests with a marker take."""
LONGEST = """
test_mutants_are_noticed
test_a_curve_of_another_form_is_named_and_not_its_imitations test_late_film_of_a_curve_is_found_with_its_lag
test_an_effect_that_cannot_switch_is_found_on_an_axis_that_does test_experiment_is_the_recorded_one
test_a_joint_of_mujoco_is_identified_judged_and_compensated test_from_a_trace_to_firmware
test_what_is_known_to_look_alike_is_tried_where_a_derivative_tells_half
test_every_condition_decides_or_is_explained test_every_kind_of_code_has_no_hit_without_a_reason
""".split()
"""Tests of a minute and more: they begin first, or one worker is alone with one of them at the end."""

# The only thing a CI machine may lack: measured data whose licence keeps it out of the repository.
DATA_ABSENT = "measured data absent"
CI_SKIPS_ALLOWED = (DATA_ABSENT,)

# Derandomised: the same commit gives the same verdict. Deadlines would measure the machine, not the code.
hypothesis.settings.register_profile("repeatable", deadline=None, derandomize=True)
hypothesis.settings.load_profile("repeatable")

pytest_plugins = ["pytester"]


# --- fixtures ---------------------------------------------------------------------------------------------------


@pytest.fixture(autouse=True)
def command_line_words() -> Iterable[None]:
    """Let messages name keys and options, whoever calls: tests of Python's words print them in a context of its own."""
    with speak_to_command_line():
        yield


@pytest.fixture(scope="session")
def repo_root() -> Path:
    """Root of the checkout."""
    return REPO_ROOT


@pytest.fixture(scope="session")
def measured_data() -> Callable[[str], Path]:
    """Path of measured data by its name, as in `measured_data("emps/DATA_EMPS.mat")`; skips where it is absent.

    Looked for in the folder that SGMS_MHE_DATA names, otherwise in shared/data beside the checkout.
    """

    def locate(name: str) -> Path:
        stated = os.environ.get("SGMS_MHE_DATA")
        folder = Path(stated) if stated else REPO_ROOT.parent / "shared" / "data"
        path = folder / name
        if not path.exists():
            pytest.skip(f"{DATA_ABSENT}: {name} (SGMS_MHE_DATA names the folder)")
        return path

    return locate


@pytest.fixture(scope="session")
def machine() -> Any:
    """The axis that most tests are about."""
    from sgms_mhe.configuration import load_machine

    return load_machine("etel_xy")


@pytest.fixture(scope="session")
def require_tool() -> Callable[[str], str]:
    """Full path of an external tool, as in `require_tool("valgrind")`; skips where it is absent."""

    def locate(name: str) -> str:
        path = shutil.which(name)
        if path is None:
            pytest.skip(f"tool absent: {name}")
        return path

    return locate


@pytest.fixture(scope="session")
def bound(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Any]:
    """Package of a kind with every binding, made once; see binding_cases.py."""
    from binding_cases import bound_package

    return lru_cache(lambda kind: bound_package(kind, tmp_path_factory.mktemp("bound")))


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, made of the source distribution as `make wheel` does."""
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder), str(REPO_ROOT)]
    subprocess.run(command, check=True, capture_output=True)
    (found,) = folder.glob("*.whl")
    return found


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The machine file of the command line's tests, in a folder of its own."""
    from cli_cases import SMALL  # beside this file in the repository only, not where a test copies it to

    path = tmp_path_factory.mktemp("machine") / "small.toml"
    path.write_text(SMALL)
    return path


# --- markers ----------------------------------------------------------------------------------------------------


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip what needs a cross compiler where there is none; mark what reads measured data; the longest first."""
    items.sort(key=lambda item: item.name not in LONGEST)
    lacking = {marker: [tool for tool in tools if shutil.which(tool) is None] for marker, tools in MARKED_TOOLS.items()}
    for item in items:
        for marker, absent in lacking.items():
            if absent and item.get_closest_marker(marker):
                item.add_marker(pytest.mark.skip(reason=f"tool absent: {', '.join(absent)}"))
        if "measured_data" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.needs_data)


# --- in CI a skipped check is a failure -------------------------------------------------------------------------


def pytest_configure(config: pytest.Config) -> None:
    """Install the rule on skips."""
    config.pluginmanager.register(_SkipRule(config), "sgms-mhe-skip-rule")


class _SkipRule:
    """With SGMS_MHE_CI=1, turns a session with a skip that is not allowed into a failed one and lists the skips."""

    def __init__(self, config: pytest.Config) -> None:
        self.skips: dict[str, str] = {}
        # Under xdist every worker has a session of its own; only the controlling one sees all reports.
        self.active = os.environ.get("SGMS_MHE_CI") == "1" and not hasattr(config, "workerinput")

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        # An expected failure is reported as skipped too, but it did run.
        if report.skipped and not hasattr(report, "wasxfail"):
            self.skips[report.nodeid] = _reason(report)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.skipped:
            self.skips[report.nodeid] = _reason(report)

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if self.active and list(self._refused()) and session.exitstatus in (0, pytest.ExitCode.NO_TESTS_COLLECTED):
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        refused = list(self._refused()) if self.active else []
        if refused:
            terminalreporter.section("checks that CI must run were skipped", red=True)
            for line in refused:
                terminalreporter.line(line, red=True)

    def _refused(self) -> Iterable[str]:
        for nodeid, reason in sorted(self.skips.items()):
            if not reason.startswith(CI_SKIPS_ALLOWED):
                yield f"{nodeid}: {reason}"


def _reason(report: pytest.TestReport | pytest.CollectReport) -> str:
    # A skip's longrepr is (path, line, "Skipped: reason").
    text = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
    return text.removeprefix("Skipped: ")
