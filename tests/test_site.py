"""The documents as a site: built strictly, whole without a network, every page in reach, references complete."""

import inspect
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest

import sgms_mhe
from browser import Browser
from cli_cases import run
from sgms_mhe.cli import command_names
from sgms_mhe.model.effects import EFFECT_NAMES
from sgms_mhe.support.toolchain import compiler

ROOT = Path(__file__).resolve().parents[1]
NO_PAGE_OF_ITS_OWN = {"404.html"}
LOADED = {"script": "src", "img": "src", "iframe": "src", "source": "src", "link": "href"}
"""Attributes that a browser fetches without being asked."""


class Addresses(HTMLParser):
    """What a page links to, what it loads, and its text."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.words: list[str] = []
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag == "a" and given.get("href"):
            self.links.append(str(given["href"]))
        if tag in LOADED and given.get(LOADED[tag]):
            self.loaded.append(str(given[LOADED[tag]]))

    def handle_data(self, data: str) -> None:
        self.words.append(data)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(folder)]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[str, Addresses]:
    found = {path.relative_to(site).as_posix(): Addresses(path) for path in site.rglob("*.html")}
    assert found.keys() >= {"index.html", "docs/walk.html", "reference/c.html"}
    return found


def text_of(pages: dict[str, Addresses], name: str) -> str:
    return " ".join(pages[name].words)


def local(site: Path, page: str, address: str) -> Path:
    """The file that an address on a page stands for."""
    assert not re.match(r"[a-z]+:|//|/", address), f"{page}: {address}"
    path = unquote(re.split(r"[?#]", address)[0])
    return ((site / page).parent / path).resolve() if path else site / page


# --- whole -----------------------------------------------------------------------------------------------------------


def test_nothing_is_loaded_from_elsewhere(site: Path, pages: dict[str, Addresses]) -> None:
    for name, page in pages.items():
        if name not in NO_PAGE_OF_ITS_OWN:
            assert page.loaded
            assert [address for address in page.loaded if not local(site, name, address).is_file()] == []
    sheets = list(site.rglob("*.css"))
    assert len(sheets) >= 3
    for sheet in sheets:
        assert not re.search(r"url\(\s*[\"']?(https?:|//)|@import", sheet.read_text(encoding="utf-8")), sheet


def test_links_within_the_site_lead_to_files(site: Path, pages: dict[str, Addresses]) -> None:
    for name, page in pages.items():
        inside = [address for address in page.links if not re.match(r"https?:", address)]
        if name not in NO_PAGE_OF_ITS_OWN:
            assert [address for address in inside if not local(site, name, address).is_file()] == []


def test_every_page_is_in_the_navigation(site: Path, pages: dict[str, Addresses]) -> None:
    text = (site / "index.html").read_text(encoding="utf-8")
    navigation = re.search(r'<nav class="md-nav md-nav--primary.*?</nav>\s*</div>', text, flags=re.DOTALL)
    assert navigation
    linked = {local(site, "index.html", address) for address in re.findall(r'href="([^"]+)"', navigation[0])}
    assert {name for name in pages if site / name not in linked} == NO_PAGE_OF_ITS_OWN
    stored = {f"docs/{path.stem}.html" for path in (ROOT / "docs").glob("*.md")} - {"docs/README.html"}
    assert stored <= pages.keys()


def test_search_index_holds_terms_and_places(site: Path) -> None:
    script = (site / "search" / "search_index.js").read_text(encoding="utf-8")
    index = json.loads(script.partition("=")[2])
    entries: list[dict[str, Any]] = index["docs"]
    for term, place in {
        "arrival cost": "docs/estimation.html",
        "set_mass": "reference/c/functions.html",
        "held-out": "reference/commands/diagnose.html",
        "stribeck_velocity": "reference/machine/friction.html",
        "presliding": "docs/glossary.html",
    }.items():
        found = [entry["location"] for entry in entries if term in entry["text"] + entry["title"]]
        assert any(location.startswith(place) for location in found), term
    assert {entry["location"].partition("#")[0] for entry in entries if not (site / entry["location"]).is_file()} <= {
        path.relative_to(site).as_posix() for path in site.rglob("*.html")
    }


@pytest.fixture(scope="module")
def browser(require_tool: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    shown = Browser(require_tool("chromium"), require_tool("chromedriver"), tmp_path_factory.mktemp("profile"))
    yield shown
    shown.driver.quit()


def test_search_finds_in_files_without_a_server(browser: Browser, site: Path) -> None:
    browser.show(site / "index.html")
    browser.requests(), browser.complaints()
    browser.show(site / "docs" / "walk.html")
    browser.ask("document.querySelector('[data-md-toggle=search]').click()")
    browser.ask(
        "const field = document.querySelector('[data-md-component=search-query]');"
        "field.focus(); field.value = 'Coulomb'; field.dispatchEvent(new Event('keyup')); "
        "field.dispatchEvent(new Event('input', { bubbles: true }));"
    )
    until = time.monotonic() + 60.0
    found: list[str] = []
    while not found and time.monotonic() < until:
        found = browser.ask("return [...document.querySelectorAll('.md-search-result__link')].map(a => a.href)")
        time.sleep(0.2)
    assert found and all(address.startswith(site.as_uri()) for address in found)
    assert [address for address in browser.requests() if not address.startswith(("file:", "about:", "blob:"))] == []
    assert browser.complaints() == []


# --- read on every screen ---------------------------------------------------------------------------------------------


def test_equations_are_typeset_at_build_time(site: Path) -> None:
    for path in (ROOT / "docs").glob("*.md"):
        blocks = path.read_text(encoding="utf-8").count("```math\n")
        page = (site / "docs" / ("index.html" if path.stem == "README" else f"{path.stem}.html")).read_text("utf-8")
        assert page.count('<math display="block">') == blocks, path.name
        assert "arithmatex" not in page and "<merror" not in page, path.name
    assert '<div class="equation"><math' in (site / "docs" / "model.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("width", [400, 1400])
def test_pages_fit_the_screen_and_buttons_cover_no_code(browser: Browser, site: Path, width: int) -> None:
    for page in ("index.html", "docs/walk.html", "docs/model.html", "docs/signals.html"):
        browser.show(site / page, width=width)
        assert browser.ask("return document.documentElement.scrollWidth") == width, page
        covered = browser.ask(
            "return [...document.querySelectorAll('pre')].filter(pre => { const button = pre.querySelector('button');"
            " const code = pre.querySelector('code'); return button && code &&"
            " button.getBoundingClientRect().left < code.getBoundingClientRect().right - 1; }).length"
        )
        assert covered == 0, page


@pytest.mark.parametrize("folder", ["commands", "effects", "python"])
def test_overviews_have_an_anchor_and_a_page_for_every_entry(site: Path, folder: str) -> None:
    overview = (site / "reference" / f"{folder}.html").read_text(encoding="utf-8")
    pages = {path.stem for path in (site / "reference" / folder).glob("*.html")}
    assert len(pages) > 10
    assert {name for name in pages if f'href="{folder}/{name}.html" id="{name}"' not in overview} == set()


# --- references that are made ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", command_names())
def test_every_option_is_in_the_reference(site: Path, name: str) -> None:
    page = (site / "reference" / "commands" / f"{name}.html").read_text(encoding="utf-8")
    said = run(name, "--help").output.partition("Options:")[2].partition("Example:")[0]
    options = set(re.findall(r"^ +(?:-\w, )?(--[a-z-]+)", said, flags=re.MULTILINE)) - {"--help"}
    assert options or name == "schema"
    assert {option for option in options if not re.search(rf"<code>[^<]*{option}\b", page)} == set()


def keys(schema: Any) -> Iterator[str]:
    """Every key that a machine file may have, those of effects left out."""
    for name, value in schema.items() if isinstance(schema, dict) else ():
        if name == "properties":
            yield from value
        if name != "allOf":
            yield from keys(value)


def test_every_key_of_the_schema_is_in_the_reference(site: Path) -> None:
    tables = {path.stem: path.read_text(encoding="utf-8") for path in (site / "reference" / "machine").glob("*.html")}
    overview = (site / "reference" / "machine.html").read_text(encoding="utf-8")
    assert [name for name in tables if f'href="machine/{name}.html"' not in overview] == []
    page = "".join([overview, *tables.values()])
    found = set(keys(json.loads(run("schema").stdout)))
    assert found >= {"extends", "law", "horizon", "counts_per", "lambda", "unexplained", "tick_budget"}
    assert {key for key in found - set(tables) if f"<code>{key}</code>" not in page} == set()


def test_every_effect_and_parameter_is_in_the_reference(site: Path) -> None:
    rules = json.loads(run("schema").stdout)["$defs"]["Effect"]["allOf"]
    assert [rule["if"]["properties"]["name"]["const"] for rule in rules] == list(EFFECT_NAMES)
    for rule in rules:
        name = rule["if"]["properties"]["name"]["const"]
        page = (site / "reference" / "effects" / f"{name}.html").read_text(encoding="utf-8")
        lacking = [key for key in rule["then"]["properties"] if f"<code>{key}</code>" not in page]
        assert lacking == []


def test_the_python_interface_is_in_the_reference(site: Path) -> None:
    sections = {path.stem: path.read_text(encoding="utf-8") for path in (site / "reference" / "python").iterdir()}
    assert sections and set(sections) == set(sgms_mhe.__all__)
    for name, section in sections.items():
        member = getattr(sgms_mhe, name)
        named = fields(member) if is_dataclass(member) and "Attributes:" in (member.__doc__ or "") else ()
        wanted = [field.name for field in named]
        wanted += [] if isinstance(member, type) else list(inspect.signature(member).parameters)
        cells = set(re.findall(r"\w+", " ".join(re.findall(r"<td><code>(.*?)</code>", section))))
        assert not set(wanted) - cells, (name, set(wanted) - cells)


def test_every_function_of_a_package_is_in_the_reference(
    site: Path, require_tool: Callable[[str], str], tmp_path: Path
) -> None:
    """Those that a compiled package exports, and those in its header."""
    package = ROOT / "generated" / "etel_xy"
    exported: set[str] = set()
    for source in package.glob("*.c"):
        made = tmp_path / f"{source.stem}.o"
        subprocess.run([*compiler(), "-std=c99", f"-I{package}", "-c", str(source), "-o", str(made)], check=True)
        command = [require_tool("nm"), "--extern-only", "--defined-only", str(made)]
        listed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        exported |= {line.split()[2] for line in listed.splitlines() if line.split()[1] == "T"}
    inside = re.findall(r"^static inline .*\b(\w+)\(", (package / "etel_xy.h").read_text("utf-8"), flags=re.MULTILINE)
    assert {"etel_xy_tick", "etel_xy_selftest"} <= exported and inside
    page = (site / "reference" / "c" / "functions.html").read_text(encoding="utf-8")
    headings = set(re.findall(r"\w+", " ".join(re.findall(r"<h2[^>]*>(.*?)<a", page))))
    assert {*exported, *inside} - headings == set()
