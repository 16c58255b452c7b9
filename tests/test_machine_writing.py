"""Values of machine files that are written: what is read back is what was meant."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli_cases import SMALL
from sgms_mhe.configuration import load_machine
from sgms_mhe.machine.writing import toml_extends, toml_line, toml_table


@pytest.mark.parametrize(
    "value",
    [
        True,
        20,
        0.1,
        1e-9,
        'he said "µm"',
        [120e3, 25e3],
        [],
        {"zeta": 0.9, "lambda": 35.0},
        {"unit": "mm", "a key": [1, 2.5], "within": {"deep": False}},
    ],
    ids=str,
)
def test_what_is_written_is_read_back(value: Any) -> None:
    read = tomllib.loads("\n".join(toml_table("[table]", {"key": value}, "a note")))["table"]["key"]
    assert read == value
    assert type(read) is type(value)


def test_numbers_of_arrays_are_plain_numbers() -> None:
    assert toml_line("shares", tuple(np.array([0.1, 2.0]))) == "shares = [0.1, 2.0]"


def test_a_base_is_named_where_everybody_finds_it(tmp_path: Path) -> None:
    assert toml_extends(load_machine("etel_xy")) == 'extends = "etel_xy"'
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    line = toml_extends(load_machine(path))
    assert tomllib.loads(line)["extends"] == path.resolve().as_posix()
