"""The rooms of the package: all on the map in CONTRIBUTING, and each imports from rooms below its own alone.

And what keeps them fit to live in: nothing is imported in hiding, and no effect is known by its name outside the
catalogue: what is said of one stands in its definition.
"""

import ast
import re
from collections.abc import Iterator
from dataclasses import MISSING, Field, fields
from pathlib import Path

import pytest

from sgms_mhe.model.effects import BASE_CAUSES, CAUSE_NAMES, EFFECT_NAMES, EffectDefinition, cause, effect_definition

pytestmark = pytest.mark.core

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "generator" / "sgms_mhe"
BENCH = ROOT / "bench" / "sgms_bench"
DOORS = {"__main__": "cli"}
"""Modules that only lead into a room."""
LATE = "commands"
"""The room whose imports may stand in functions: the help of a command has to come without casadi and numpy."""


def rooms_on_the_map() -> list[str]:
    """Rooms in the order of the map, the uppermost first."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    table = text.partition("| room | holds |")[2].partition("\n\n")[0]
    return re.findall(r"^\| `([\w.]+?)(?:/|\.py)` \|", table, flags=re.MULTILINE)


def room_of(module: str) -> str:
    """Room of a module `sgms_mhe.room.name`; of one in the package's root its own name."""
    parts = module.split(".")
    return parts[1] if len(parts) > 1 else "__init__"


def imported_by(path: Path) -> Iterator[str]:
    """Modules of the package that a file imports, wherever in it: in functions and under TYPE_CHECKING too."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name.partition(".")[0] == "sgms_mhe")
        elif isinstance(node, ast.ImportFrom) and node.module == "sgms_mhe":
            yield from (f"sgms_mhe.{alias.name}" for alias in node.names if not alias.name.startswith("__"))
        elif isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("sgms_mhe."):
            yield node.module


def arrows() -> dict[tuple[str, str], list[str]]:
    """(room, room that it imports from) and the files that do."""
    found: dict[tuple[str, str], list[str]] = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        own = path.relative_to(PACKAGE)
        for module in imported_by(path):
            room = own.parts[0].removesuffix(".py")
            arrow = (DOORS.get(room, room), room_of(module))
            if arrow[0] != arrow[1]:
                found.setdefault(arrow, []).append(own.as_posix())
    return found


def test_every_room_is_on_the_map() -> None:
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    modules = {path.stem for path in PACKAGE.glob("*.py")} - {"__init__", *DOORS}
    assert sorted(rooms_on_the_map()) == sorted(folders | modules)


def test_arrows_point_downwards() -> None:
    """So there is no circle either."""
    order = {room: place for place, room in enumerate(rooms_on_the_map())}
    found = arrows()
    assert len(found) > len(order)
    upwards = [f"{a} -> {b}: {', '.join(files)}" for (a, b), files in found.items() if order[a] > order[b]]
    assert not upwards


def test_imports_stand_at_the_top() -> None:
    hidden = []
    for path in PACKAGE.rglob("*.py"):
        own = path.relative_to(PACKAGE)
        tree = ast.parse(path.read_text(encoding="utf-8"))
        nested = set(ast.walk(tree)) - set(tree.body)
        for node in nested:
            if isinstance(node, ast.Import | ast.ImportFrom) and own.parts[0] != LATE:
                names = [node.module or ""] if isinstance(node, ast.ImportFrom) else [a.name for a in node.names]
                hidden += [f"{own}:{node.lineno}" for name in names if name.startswith("sgms_mhe")]
    assert not hidden


def test_the_product_knows_nothing_of_the_workbench() -> None:
    """It may be absent: a wheel does not hold it. Entry points alone lead there."""
    files = [path for folder in ("generator", "templates", "runtime_c") for path in (ROOT / folder).rglob("*.*")]
    texts = {path.relative_to(ROOT): path.read_bytes() for path in files if path.is_file() and path.suffix != ".pyc"}
    assert [str(path) for path, text in texts.items() if b"sgms_bench" in text] == []
    assert any("sgms_mhe" in path.read_text(encoding="utf-8") for path in BENCH.rglob("*.py"))


# --- definitions of effects --------------------------------------------------------------------------------------

OPTIONAL = [field for field in fields(EffectDefinition) if field.default is not MISSING and field.name != "plant_force"]
"""Fields that a definition may leave out; `plant_force` is what other distributions alone have."""


@pytest.mark.parametrize("field", OPTIONAL, ids=lambda field: str(field.name))
def test_field_of_a_definition_serves_more_than_one_effect(field: Field[object]) -> None:
    """One that a single effect sets is that effect's name in disguise."""
    causes = [cause(name) for name in CAUSE_NAMES] + [effect_definition(name) for name in EFFECT_NAMES]
    setting = {known.name for known in causes if getattr(known, field.name, field.default) != field.default}
    assert len(setting) > 1


# --- names of effects --------------------------------------------------------------------------------------------

MACHINE_KEYS = {"micro_viscous"} | {name for base in BASE_CAUSES.values() for name in (base.name, *base.frees)}
"""Names that are keys of a machine file too: only rooms that speak of effects alone must do without them."""

PARAMETERS = {p.name for name in EFFECT_NAMES for p in effect_definition(name).parameters} - {"time_s", "gain"}
"""Parameters of effects; `time_s` is a column of every log too, a gain what a diagnosis is for."""

ENDS = ("startswith", "endswith", "removeprefix", "removesuffix")

OF_EFFECTS = ("diagnosis", "report")

SPECIMENS = (  # machine files, axes and what a benchmark hides, which have effects by name
    BENCH / "diagnosis" / "specimens.py",
    BENCH / "verification" / "specimens.py",
    BENCH / "studies" / "coarse.py",
    BENCH / "studies" / "lasting_errors.py",
)

CATALOGUE = PACKAGE / "model" / "effects"
PLANT = PACKAGE / "plant"  # independent of the catalogue: it has the effects a second time
EXEMPT = {*CATALOGUE.rglob("*.py"), *PLANT.rglob("*.py"), *SPECIMENS}


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


def named(path: Path, root: Path) -> list[str]:
    """Lines of a module below `root` that name a single effect."""
    own = path.relative_to(root)
    tree = ast.parse(path.read_text(encoding="utf-8"))
    forbidden = set(EFFECT_NAMES) - MACHINE_KEYS
    if own.parts[0] in OF_EFFECTS:
        forbidden |= set(CAUSE_NAMES) | PARAMETERS
        ends = [
            (line, text)
            for line, text in ends_asked_for(tree)
            if len(text) > 3 and any(name.startswith(text) or name.endswith(text) for name in forbidden)
        ]
    else:
        ends = []
    found = [(line, text) for line, text in texts(tree) if text in forbidden]
    return [f"{own}:{line}: {text!r}" for line, text in sorted({*found, *ends})]


def test_no_module_names_an_effect() -> None:
    modules = [(path, root) for root in (PACKAGE, BENCH) for path in sorted(root.rglob("*.py")) if path not in EXEMPT]
    assert len(modules) > len(EXEMPT) and [line for path, root in modules for line in named(path, root)] == []


def test_a_name_is_seen(tmp_path: Path) -> None:
    (tmp_path / "diagnosis").mkdir()
    module = tmp_path / "diagnosis" / "module.py"
    for line in ('x == "backlash"', 'x == "coulomb"', 'x in ("a", "pitch_m")', 'x.startswith(("amplitude", "b"))'):
        module.write_text(line + "\n")
        assert len(named(module, tmp_path)) == 1, line
    module.write_text('x == "backlash force"\ny.startswith("+")\n')
    assert named(module, tmp_path) == []
