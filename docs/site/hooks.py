"""Source of the site for MkDocs: the pages at their place in the repository, so that their links hold, and made ones.

Called by MkDocs (`hooks` in mkdocs.yml).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from html import unescape
from pathlib import Path
from typing import Any, Final

from math_core import LatexError, LatexToMathML
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import c_reference
import command_reference
import effect_reference
import machine_reference
import percent
import python_reference

ROOT: Final = Path(__file__).resolve().parents[2]
STORED: Final = ("*.md", "docs/*.md", "docs/figures/*.svg", "docs/figures/*.png")
MADE: Final[tuple[Callable[[], dict[str, str]], ...]] = (
    command_reference.pages,
    machine_reference.pages,
    effect_reference.pages,
    python_reference.pages,
    lambda: c_reference.pages((ROOT / "generated/etel_xy/etel_xy.h").read_text("utf-8"), "etel_xy"),
)
"""Writers of the pages that are not in git, by address: an overview first, then its parts."""

EQUATION: Final = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>([.,:;)]*)', flags=re.DOTALL)
"""TeX as the Markdown extension marks it, within a line or of a block, and the punctuation behind it."""


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Write the references, and put the parts of each behind its overview in the navigation."""
    references = [write() for write in MADE]
    config.extra["references"] = {address: text for reference in references for address, text in reference.items()}
    parts = {next(iter(reference)): list(reference) for reference in references if len(reference) > 1}
    config.nav = _with_parts(config.nav, parts)
    return config


def _with_parts(entry: Any, parts: dict[str, list[str]]) -> Any:
    if isinstance(entry, list):
        return [_with_parts(one, parts) for one in entry]
    if isinstance(entry, dict):
        return {title: _with_parts(one, parts) for title, one in entry.items()}
    return parts.get(entry, entry)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """All files of the site, each at its place in the repository."""
    pages = [path for pattern in STORED for path in sorted(ROOT.glob(pattern))]
    found = {path.relative_to(ROOT).as_posix(): path for path in pages}
    found |= {f"assets/{path.name}": path for path in sorted((ROOT / "docs/site/assets").iterdir())}
    stored = [File.generated(config, uri, abs_src_path=str(path)) for uri, path in found.items()]
    made = [File.generated(config, uri, content=text) for uri, text in config.extra["references"].items()]
    for script in percent.scripts():
        uri = script.relative_to(ROOT).with_suffix(".md").as_posix()
        page, figures = percent.page(script, Path(config.site_dir).parent / "notebooks" / f"{script.stem}.ipynb")
        made.append(File.generated(config, uri, content=page))
        folder = Path(uri).parent
        made += [File.generated(config, f"{folder}/{name}", content=image) for name, image in figures.items()]
    theme = [file for file in files if file.src_dir != config.docs_dir]
    return Files([*theme, *stored, *made])


def on_page_content(html: str, page: Page, **_: Any) -> str:
    """Typeset the equations of a page as MathML, which browsers show without a script."""
    typesetter = LatexToMathML(fancy_error=False)

    def typeset(found: re.Match[str]) -> str:
        tag, tex, punctuation = found[1], unescape(found[2]).strip(), found[3]
        try:
            equation = typesetter.convert_with_local_state(tex, displaystyle=tag == "div")
        except LatexError as error:
            raise PluginError(f"{page.file.src_uri}: {tex!r} is no equation: {error}") from error
        return f'<{tag} class="equation">{equation}{punctuation}</{tag}>'

    return EQUATION.sub(typeset, html)
