"""What MkDocs builds the site from: the pages as they lie in the repository, so that their links hold, and made ones.

Called by MkDocs (`hooks` in mkdocs.yml).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

import c_reference
import command_reference
import effect_reference
import machine_reference
import percent
import python_reference

ROOT: Final = Path(__file__).resolve().parents[2]
STORED: Final = ("*.md", "docs/*.md", "docs/figures/*.svg", "docs/figures/*.png")
MADE: Final[dict[str, Callable[[], str]]] = {
    "reference/commands.md": command_reference.page,
    "reference/machine.md": machine_reference.page,
    "reference/effects.md": effect_reference.page,
    "reference/python.md": python_reference.page,
    "reference/c.md": lambda: c_reference.page((ROOT / "generated/etel_xy/etel_xy.h").read_text("utf-8"), "etel_xy"),
}
"""Pages that are not in git, each with what writes it."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """All files of the site, each where it lies in the repository."""
    pages = [path for pattern in STORED for path in sorted(ROOT.glob(pattern))]
    found = {path.relative_to(ROOT).as_posix(): path for path in pages}
    found |= {f"assets/{path.name}": path for path in sorted((ROOT / "docs/site/assets").iterdir())}
    stored = [File.generated(config, uri, abs_src_path=str(path)) for uri, path in found.items()]
    made = [File.generated(config, uri, content=write()) for uri, write in MADE.items()]
    for script in percent.scripts():
        uri = script.relative_to(ROOT).with_suffix(".md").as_posix()
        page, figures = percent.page(script, Path(config.site_dir).parent / "notebooks" / f"{script.stem}.ipynb")
        made.append(File.generated(config, uri, content=page))
        folder = Path(uri).parent
        made += [File.generated(config, f"{folder}/{name}", content=image) for name, image in figures.items()]
    theme = [file for file in files if file.src_dir != config.docs_dir]
    return Files([*theme, *stored, *made])
