"""The bounded part of the mutated logs of `make verify`, and that their judge finds what it is there to find."""

from pathlib import Path

import pytest

from sgms_bench.logs import mutations
from sgms_bench.logs.mutations import FORMS, check_logs, original
from sgms_mhe.logfiles.reading import read_log


@pytest.mark.slow
@pytest.mark.parametrize("part", range(6))
def test_no_log_trips_the_command_line(part: int) -> None:
    outcomes = check_logs(range(40 * part, 40 * (part + 1)), print)
    assert [failure for outcome in outcomes for failure in outcome.failures] == []


@pytest.mark.parametrize(
    "name", [name for name, form in FORMS.items() if not form.log and name != "groups of thousands"]
)
def test_what_is_mutated_is_read(name: str, tmp_path: Path) -> None:
    path = tmp_path / f"log{FORMS[name].suffix}"
    path.write_bytes(original(name))
    assert len(read_log(path)) == mutations.SAMPLES
