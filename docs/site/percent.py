"""Scripts with cells (`# %%`, `# %% [markdown]`) as notebooks and as pages.

    python docs/site/percent.py

writes a notebook without outputs beside every script of examples/notebooks.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

FOLDER: Final = Path(__file__).resolve().parents[2] / "examples" / "notebooks"
MARK: Final = "# %%"
KERNEL: Final = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}


def scripts() -> list[Path]:
    """Scripts with cells."""
    return sorted(FOLDER.glob("*.py"))


def cells(script: str) -> Iterator[tuple[str, str]]:
    """Kind (markdown or code) and text of every cell; text of Markdown without the marks of comments.

    Raises:
        ValueError: something stands before the first cell, or a line of Markdown is no comment.
    """
    before, *parts = f"\n{script}".split(f"\n{MARK}")
    if before.strip():
        raise ValueError(f"before the first cell stands {before.strip()!r}; allowed is nothing")
    for part in parts:
        head, _, text = part.partition("\n")
        if head.strip() != "[markdown]":
            yield "code", text.strip("\n")
            continue
        lines = text.strip("\n").splitlines()
        wrong = [line for line in lines if line != "#" and not line.startswith("# ")]
        if wrong:
            raise ValueError(f"a cell of Markdown has {wrong[0]!r}; allowed are lines that begin with '# '")
        yield "markdown", "\n".join(line[2:] for line in lines)


def notebook(script: str) -> str:
    """The notebook of a script, as JSON of format 4.5, the same bytes every time."""
    made: list[dict[str, Any]] = []
    for number, (kind, text) in enumerate(cells(script), start=1):
        cell: dict[str, Any] = {"cell_type": kind, "id": f"cell-{number}", "metadata": {}}
        if kind == "code":
            cell |= {"execution_count": None, "outputs": []}
        made.append(cell | {"source": text.splitlines(keepends=True)})
    content = {"cells": made, "metadata": KERNEL, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def page(script: Path) -> str:
    """A script as a page."""
    text = script.read_text(encoding="utf-8")
    parts = [part if kind == "markdown" else f"```python\n{part}\n```" for kind, part in cells(text)]
    name = f"examples/notebooks/{script.stem}"
    return "\n\n".join([parts[0], f"`{name}.py`, and as a notebook `{name}.ipynb`.", *parts[1:]])


def main() -> None:
    """Write the notebooks."""
    for script in scripts():
        text = notebook(script.read_text(encoding="utf-8"))
        script.with_suffix(".ipynb").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
