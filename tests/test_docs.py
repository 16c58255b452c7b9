"""The documents: no line too long, no link that leads nowhere, no command, option, path or word that does not exist."""

import importlib
import importlib.util
import re
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from sgms_mhe.cli import COMMANDS, Commands, command_names
from sgms_mhe.configuration import load_machine
from sgms_mhe.model.effects import BASE_CAUSES, EFFECT_NAMES, cause, effect_definition

pytestmark = pytest.mark.core

ROOT = Path(__file__).resolve().parents[1]
PAGES = tuple(sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")]))
COLUMNS = 100

READERS_OWN = frozenset({"my_axis.c", "my_axis.toml", "plots/parameters.png", "diagnosis/report.html"})
"""What looks like a path and stands for a file that the reader will have."""

FENCE = re.compile(r"^```(\w*)\n(.*?)^```", flags=re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
CALL = re.compile(r"sgms-mhe ([a-z-]+)((?:[^`\n]|\\\n)*)")
ONE_COMMAND = Commands().get_command


def page_id(page: Path) -> str:
    """A page as tests name it."""
    return page.relative_to(ROOT).as_posix()


each_page = pytest.mark.parametrize("page", PAGES, ids=page_id)


def read(page: Path) -> str:
    """Text of a page."""
    return page.read_text(encoding="utf-8")


def without_code(text: str) -> str:
    """A page's text with blocks of code and code within lines left out."""
    return re.sub(r"`[^`\n]*`", "``", FENCE.sub("", text))


def anchors(page: Path) -> set[str]:
    """Fragments that the headings of a page can be linked by, as GitHub makes them."""
    headings = re.findall(r"^#+ +(.+)$", FENCE.sub("", read(page)), flags=re.MULTILINE)
    plain = [re.sub(r"[^\w\- ]", "", heading.strip().lower()) for heading in headings]
    return {heading.replace(" ", "-") for heading in plain}


def rows(text: str) -> list[list[str]]:
    """Cells of all rows of all tables of a page, heads and rules left out."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    cells = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]
    rules = {i for i, row in enumerate(cells) if all(re.fullmatch(r":?-+:?", cell) for cell in row)}
    return [row for i, row in enumerate(cells) if i not in rules and i + 1 not in rules]


def section(text: str, heading: str) -> str:
    """What stands under a heading of the second level."""
    found = re.search(rf"^## {re.escape(heading)}\n(.*?)(?=^## |\Z)", text, flags=re.DOTALL | re.MULTILINE)
    assert found, f"no section {heading}"
    return found[1]


def test_pages_are_found() -> None:
    assert {page.name for page in PAGES} >= {"README.md", "DESIGN.md", "CHANGELOG.md", "model.md", "glossary.md"}


@each_page
def test_lines_are_short(page: Path) -> None:
    long = [f"line {i}: {len(line)}" for i, line in enumerate(read(page).splitlines(), 1) if len(line) > COLUMNS]
    assert not long, f"more than {COLUMNS} columns: {', '.join(long)}"


@each_page
def test_links_lead_somewhere(page: Path) -> None:
    dead = []
    for target in LINK.findall(without_code(read(page))):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, fragment = target.partition("#")
        place = (page.parent / path).resolve() if path else page
        if not place.exists() or (fragment and fragment not in anchors(place)):
            dead.append(target)
    assert not dead


def test_every_page_is_in_the_index() -> None:
    index = ROOT / "docs" / "README.md"
    linked = {(index.parent / target.partition("#")[0]).resolve() for target in LINK.findall(read(index))}
    assert {page for page in PAGES if page.parent == index.parent and page != index} <= linked


# --- commands ---------------------------------------------------------------------------------------------------


def options(name: str) -> set[str]:
    """Options of a command, --help included."""
    command = ONE_COMMAND(click.Context(Commands()), name)
    assert command is not None
    own = {option for p in command.params if isinstance(p, click.Option) for option in p.opts}
    return own | {"--help", "-h"}


def calls(text: str) -> Iterator[tuple[str, set[str]]]:
    """Commands that the code of a page calls, each with the options that it gives."""
    code = [block for _, block in FENCE.findall(text)] + re.findall(r"`([^`\n]+)`", FENCE.sub("", text))
    for block in code:
        for name, rest in CALL.findall(block.replace("\\\n", " ")):
            yield name, set(re.findall(r"(?<![\w-])--?[a-z][a-z-]*", re.sub(r'"[^"]*"', "", rest)))


@each_page
def test_commands_and_options_exist(page: Path) -> None:
    for name, given in calls(read(page)):
        assert name in command_names(), f"sgms-mhe {name}"
        assert given <= options(name), f"sgms-mhe {name}: {given - options(name)}"


@pytest.mark.parametrize("name", command_names())
def test_every_command_is_described_with_all_its_options(name: str) -> None:
    page = read(ROOT / "docs" / "commands.md")
    synopsis = FENCE.findall(section(page, name))[0][1]
    assert synopsis.startswith(f"sgms-mhe {name}")
    of_logs = set(re.findall(r"`(--[a-z-]+)`", page.partition("Every command that reads one")[2].partition(".")[0]))
    own = {option for option in options(name) if option.startswith("--")} - {"--help"}
    shared = of_logs if of_logs <= own else set()  # stand on the page once
    assert set(re.findall(r"--[a-z-]+", synopsis)) | shared == own


@each_page
def test_modules_exist(page: Path) -> None:
    text = re.sub(r"\s+", " ", read(page))
    for module, argument in re.findall(r"python -m (sgms_(?:mhe|bench)[\w.]*)(?: ([a-z][a-z-]*))?", text):
        found = importlib.import_module(module)
        if hasattr(found, "__path__"):
            found = importlib.import_module(f"{module}.__main__")
        assert hasattr(found, "main"), module
        assert not argument or argument in found.STUDIES, argument


# --- paths ------------------------------------------------------------------------------------------------------


def places(path: str) -> Iterator[Path]:
    """What a path on a page may stand for: in the repository, in tests/, in a Python package, or in one of its rooms.

    Or in an emitted package, whose machine is called NAME.
    """
    yield from ROOT.glob(path)
    yield from (ROOT / "tests").glob(path)
    for package in ("generator/sgms_mhe", "bench/sgms_bench"):
        for pattern in (path, f"*/{path}", f"*/*/{path}"):
            yield from (ROOT / package).glob(pattern)
    for machine in (ROOT / "generated").iterdir():
        yield from machine.glob(path.replace("NAME", machine.name))
    yield from (ROOT / "templates").glob(f"{path.removeprefix('NAME_')}.jinja")  # of some packages


@each_page
def test_paths_exist(page: Path) -> None:
    for code in re.findall(r"`([^`\n]+)`", FENCE.sub("", read(page))):
        is_path = re.fullmatch(r"[\w.-]+(/[\w.*-]*)+|[\w*-]+\.(py|c|h|md|jinja|toml)", code)
        if is_path and code not in READERS_OWN:
            assert any(places(code)), code


# --- code on the pages ------------------------------------------------------------------------------------------


@each_page
def test_machine_files_on_the_pages_are_right(page: Path, tmp_path: Path) -> None:
    for i, (language, block) in enumerate(FENCE.findall(read(page))):
        if language != "toml":
            continue
        content = tomllib.loads(block)
        if "extends" not in content:  # a few tables: laid over a whole machine
            block = f'name = "some_axis"\nextends = "etel_xy"\n\n{block}'
        path = tmp_path / f"machine_{i}.toml"
        path.write_text(block, encoding="utf-8")
        load_machine(path)


# --- catalogue of effects ---------------------------------------------------------------------------------------


def test_effects_are_described_as_they_define_themselves() -> None:
    text = re.sub(r"\s+", " ", read(ROOT / "docs" / "effects.md"))
    for name in (*EFFECT_NAMES, *BASE_CAUSES):
        definition = cause(name)
        lines = [f"**`{name}`**: {definition.summary}."]
        if name in EFFECT_NAMES:
            lines += [f"- `{p.name}`: {p.description}" for p in effect_definition(name).parameters]
        lines.append(f"- To be seen: {definition.excitation.text}.")
        assert " ".join(lines) in text, "docs/effects.md wants:\n" + "\n".join(lines)
    assert Counter(re.findall(r"\*\*`(\w+)`\*\*", text)) == Counter((*EFFECT_NAMES, *BASE_CAUSES))


# --- glossary ---------------------------------------------------------------------------------------------------


def test_terms_of_the_glossary_are_unique() -> None:
    text = read(ROOT / "docs" / "glossary.md")
    terms = [row[0].lower() for row in rows(text.partition("## Words not used")[0])]
    assert len(terms) > 50
    assert [term for term, count in Counter(terms).items() if count > 1] == []


def retired_words() -> list[str]:
    """The left column of the glossary's last table."""
    table = rows(section(read(ROOT / "docs" / "glossary.md"), "Words not used"))
    words = [word for row in table for word in row[0].split(", ")]
    assert len(words) > 5
    return words


@each_page
def test_words_that_are_not_used(page: Path) -> None:
    if page.name == "glossary.md":
        return
    text = re.sub(r"\s+", " ", without_code(read(page)))
    found = [word for word in retired_words() if re.search(rf"\b{re.escape(word)}(s|d|ed)?\b", text)]
    assert not found


# --- drawings ---------------------------------------------------------------------------------------------------


def test_gallery_shows_every_figure() -> None:
    figures = {path.name for path in (ROOT / "docs" / "figures").iterdir() if path.suffix in (".png", ".svg")}
    assert set(re.findall(r"\]\(figures/([^)]+)\)", read(ROOT / "docs" / "gallery.md"))) == figures


def test_drawing_of_commands_has_every_command() -> None:
    drawn = re.findall(r'class="title"[^>]*>([^<]+)', read(ROOT / "docs" / "figures" / "commands.svg"))
    assert {name for title in drawn for name in title.split(", ")} >= set(COMMANDS)


def test_drawings_are_what_their_script_draws() -> None:
    folder = ROOT / "docs" / "figures"
    spec = importlib.util.spec_from_file_location("draw", folder / "draw.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    for name, draw in module.DRAWINGS.items():
        stored = (folder / f"{name}.svg").read_text(encoding="utf-8")
        assert stored == str(draw()), f"{name}.svg: python docs/figures/draw.py"
