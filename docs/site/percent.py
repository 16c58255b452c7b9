"""Scripts with cells (`# %%`, `# %% [markdown]`) as notebooks and as pages.

    python docs/site/percent.py
    python docs/site/percent.py --run examples/notebooks/own_axis.py build/notebooks/own_axis.ipynb

writes a notebook without outputs beside every script of examples/notebooks; or runs one and writes it with its outputs.
"""

from __future__ import annotations

import base64
import json
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import nbformat
from nbclient import NotebookClient
from traitlets.config import Config

FOLDER: Final = Path(__file__).resolve().parents[2] / "examples" / "notebooks"
MARK: Final = "# %%"
LIMIT_S: Final = 600
"""Of one cell: a host that is kept busy must not decide."""
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


def run(script: Path, folder: Path, environment: Mapping[str, str]) -> Any:
    """Run a script's notebook in a folder and return it with its outputs, a node of `nbformat`."""
    book = nbformat.reads(notebook(script.read_text(encoding="utf-8")), as_version=4)
    # Sockets of files: ports that are free when they are chosen may be another's a moment later.
    with tempfile.TemporaryDirectory() as sockets:  # whose paths are short: they have a limit
        config = Config({"AsyncKernelManager": {"transport": "ipc", "ip": f"{sockets}/kernel"}})
        resources = {"metadata": {"path": str(folder)}}
        limits = {"timeout": LIMIT_S, "startup_timeout": LIMIT_S}
        client = NotebookClient(book, config=config, kernel_name="python3", resources=resources, **limits)
        # Figures within the notebook, and nothing written outside of its folder.
        own = {key: value for key, value in os.environ.items() if key != "MPLBACKEND"}
        client.execute(env=own | {"IPYTHONDIR": str(folder / ".ipython")} | environment)
    return book


def page(script: Path, ran: Path) -> tuple[str, dict[str, bytes]]:
    """A script as a page, with the outputs of its notebook where that was run as the script is now.

    Returns:
        The page, and figures by their names, which it shows.
    """
    book = nbformat.read(ran, as_version=4) if ran.is_file() else None
    content = list(cells(script.read_text(encoding="utf-8")))
    parts, figures = [], {}
    if book is not None and [cell.source for cell in book.cells] != [part for _, part in content]:
        book = None
    for i, (kind, part) in enumerate(content):
        parts.append(part if kind == "markdown" else f"```python\n{part}\n```")
        for output in book.cells[i].get("outputs", ()) if book is not None else ():
            data = output.get("data", {})
            if "image/png" in data:
                name = f"{script.stem}_{i}.png"
                figures[name] = base64.b64decode(data["image/png"])
                parts.append(f"![What the cell draws]({name})")
            elif output.get("name") != "stderr":
                said = output.get("text") or data.get("text/plain", "")
                parts.append(f"```text\n{said.rstrip()}\n```")
    name = f"examples/notebooks/{script.stem}"
    return "\n\n".join([parts[0], f"`{name}.py`, and as a notebook `{name}.ipynb`.", *parts[1:]]), figures


def main() -> None:
    """Write the notebooks, or run one of them and write it with its outputs."""
    if sys.argv[1:2] == ["--run"]:
        script, ran = map(Path, sys.argv[2:])
        with tempfile.TemporaryDirectory() as folder:
            book = run(script, Path(folder), {})
        ran.parent.mkdir(parents=True, exist_ok=True)
        nbformat.write(book, ran)
        return
    for script in scripts():
        text = notebook(script.read_text(encoding="utf-8"))
        script.with_suffix(".ipynb").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
