"""No effect is known by its name outside the catalogue: what is said of one stands in its definition."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import sgms_bench
import sgms_mhe
from sgms_mhe.model.effects import BASE_CAUSES, CAUSE_NAMES, EFFECT_NAMES, effect_definition

pytestmark = pytest.mark.core

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = Path(sgms_mhe.__file__).parent
BENCH = Path(sgms_bench.__file__).parent
ROOTS = (PACKAGE, BENCH)
CATALOGUE = PACKAGE / "model" / "effects"
PLANT = PACKAGE / "plant"  # independent of the catalogue: it has the effects a second time

MACHINE_KEYS = {"micro_viscous"} | {name for base in BASE_CAUSES.values() for name in (base.name, *base.frees)}
"""Names that are keys of a machine file too: only rooms that speak of effects alone must do without them."""

PARAMETERS = {p.name for name in EFFECT_NAMES for p in effect_definition(name).parameters} - {"time_s", "gain"}
"""Parameters of effects; `time_s` is a column of every log too, a gain what a diagnosis is for."""

ENDS = ("startswith", "endswith", "removeprefix", "removesuffix")

OF_EFFECTS = ("diagnosis", "report")

SPECIMENS = BENCH / "verification" / "specimens.py"  # machine files, which have effects by name

EXEMPT = {*CATALOGUE.rglob("*.py"), *PLANT.rglob("*.py"), SPECIMENS}
MODULES = sorted({path for root in ROOTS for path in root.rglob("*.py")} - EXEMPT)


def own_name(path: Path) -> Path:
    """Path of a module below its package."""
    return next(path.relative_to(root) for root in ROOTS if path.is_relative_to(root))


def texts(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Every text constant and its line."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, node.value


def ends_asked_for(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """What names are asked to begin or end with."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in ENDS:
            for argument in node.args:
                yield from texts(argument)


def named(path: Path) -> list[str]:
    """What a module says of single effects."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    forbidden = set(EFFECT_NAMES) - MACHINE_KEYS
    if own_name(path).parts[0] in OF_EFFECTS:
        forbidden |= set(CAUSE_NAMES) | PARAMETERS
        ends = [
            (line, text)
            for line, text in ends_asked_for(tree)
            if len(text) > 3 and any(name.startswith(text) or name.endswith(text) for name in forbidden)
        ]
    else:
        ends = []
    found = [(line, text) for line, text in texts(tree) if text in forbidden]
    return [f"{own_name(path)}:{line}: {text!r}" for line, text in sorted({*found, *ends})]


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_module_names_no_effect(path: Path) -> None:
    assert not named(path)


def test_a_name_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(globals(), "ROOTS", (tmp_path,))
    (tmp_path / "diagnosis").mkdir()
    module = tmp_path / "diagnosis" / "module.py"
    for line in ('x == "backlash"', 'x == "coulomb"', 'x in ("a", "pitch_m")', 'x.startswith(("amplitude", "b"))'):
        module.write_text(line + "\n")
        assert len(named(module)) == 1, line
    module.write_text('x == "backlash force"\ny.startswith("+")\n')
    assert named(module) == []
