"""Values of machine files that are written: what is read back is what was meant."""

import shutil
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli_cases import SMALL
from sgms_mhe.configuration import load_machine
from sgms_mhe.machine.writing import toml_extends, toml_line, toml_machine, toml_table


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


@pytest.mark.parametrize(
    ("base", "folder", "expected"),
    [
        ("axis/small.toml", "axis", "small.toml"),
        ("axis/small.toml", "axis/diagnosis/today", "../../small.toml"),
        ("machines/small.toml", "results", "../machines/small.toml"),
    ],
)
def test_a_base_is_named_by_a_path_that_moves_with_both_files(
    tmp_path: Path, base: str, folder: str, expected: str
) -> None:
    first = tmp_path / "here"
    for path in ((first / base).parent, first / folder):
        path.mkdir(parents=True, exist_ok=True)
    (first / base).write_text(SMALL)
    lines = "\n".join(toml_extends(load_machine(first / base), first / folder))
    assert tomllib.loads(lines)["extends"] == expected
    (first / folder / "extended.toml").write_text(f'{lines}\nname = "extended"\n')
    shutil.move(first, tmp_path / "elsewhere")
    assert load_machine(tmp_path / "elsewhere" / folder / "extended.toml").name == "extended"


def test_a_base_of_the_installation_is_known_by_name(tmp_path: Path) -> None:
    assert toml_extends(load_machine("etel_xy"), tmp_path)[0] == 'extends = "etel_xy"'


@pytest.mark.parametrize("path", sorted((Path(__file__).parents[1] / "machines").glob("*.toml")), ids=lambda p: p.stem)
def test_a_standalone_file_is_the_same_machine(path: Path, tmp_path: Path) -> None:
    machine = load_machine(path)
    alone = tmp_path / "alone.toml"
    alone.write_text("\n".join(toml_machine(machine.content)) + "\n")
    assert "extends" not in tomllib.loads(alone.read_text())
    assert load_machine(alone).digest == machine.digest
