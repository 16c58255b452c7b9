"""The drawings of the documents, as SVG.

    python docs/figures/draw.py

writes them beside this file. Text stays text. Each drawing brings its own background, so that it can be read on a light
and on a dark page, and follows the reader's colour scheme where the viewer tells it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path

FOLDER = Path(__file__).parent
TITLE_CHARACTER, SMALL_CHARACTER = 8.2, 6.5
"""Width of an average character of a title and of small text [px], generously: every reader has another font."""

STYLE = """
  text { font: 13px system-ui, "Segoe UI", "DejaVu Sans", sans-serif; fill: #1f2328; }
  .small { font-size: 11.5px; fill: #59636e; }
  .title { font-weight: 600; }
  .page { fill: #ffffff; stroke: #d1d9e0; }
  .box { fill: #f6f8fa; stroke: #818b98; }
  .file { fill: #fff5d6; stroke: #b98900; }
  .c { fill: #ddf0ff; stroke: #0969da; }
  .judge { fill: #dafbe1; stroke: #1a7f37; }
  .old { fill: #eaeef2; stroke: #818b98; stroke-dasharray: 4 3; }
  .line { fill: none; stroke: #59636e; stroke-width: 1.4; }
  .thin { fill: none; stroke: #818b98; stroke-width: 1; }
  .head { fill: #59636e; }
  @media (prefers-color-scheme: dark) {
    text { fill: #e6edf3; }
    .small { fill: #9da7b3; }
    .page { fill: #0d1117; stroke: #3d444d; }
    .box { fill: #1c2128; stroke: #7d8590; }
    .file { fill: #3a2f0b; stroke: #d4a72c; }
    .c { fill: #0c2d4f; stroke: #4493f8; }
    .judge { fill: #12301b; stroke: #3fb950; }
    .old { fill: #22272e; stroke: #7d8590; }
    .line, .thin { stroke: #9da7b3; }
    .head { fill: #9da7b3; }
  }
"""


class Drawing:
    """A drawing that grows by calls; coordinates in px from the upper left."""

    def __init__(self, width: int, height: int, title: str) -> None:
        self._parts = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}"'
            f' role="img" aria-label="{escape(title)}">',
            f"<title>{escape(title)}</title>",
            f"<style>{STYLE}</style>",
            '<marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" '
            'orient="auto-start-reverse"><path class="head" d="M0 0 L8 4 L0 8 z"/></marker>',
            f'<rect class="page" x="0.5" y="0.5" width="{width - 1}" height="{height - 1}" rx="8"/>',
        ]

    def text(self, x: float, y: float, text: str, kind: str = "", anchor: str = "start") -> None:
        """A line of text whose baseline is at y."""
        self._parts.append(f'<text class="{kind}" x="{x:g}" y="{y:g}" text-anchor="{anchor}">{escape(text)}</text>')

    def box(self, x: float, y: float, w: float, h: float, lines: Sequence[str], kind: str = "box") -> None:
        """A box with centred lines: the first as title, the others small. Raises ValueError for text that is wider."""
        self._parts.append(f'<rect class="{kind}" x="{x:g}" y="{y:g}" width="{w:g}" height="{h:g}" rx="5"/>')
        top = y + h / 2 - 8 * (len(lines) - 1) + 4.5
        for i, line in enumerate(lines):
            if len(line) * (TITLE_CHARACTER if i == 0 else SMALL_CHARACTER) > w:
                raise ValueError(f"{line!r} is wider than its box")
            self.text(x + w / 2, top + 16 * i, line, "title" if i == 0 else "small", "middle")

    def line(self, *points: tuple[float, float], kind: str = "line", start: bool = False, end: bool = True) -> None:
        """A line through points, with arrow heads at its start or end."""
        path = " ".join(f"{'ML'[i > 0]}{x:g} {y:g}" for i, (x, y) in enumerate(points))
        heads = f"{' marker-start=' + chr(34) + 'url(#head)' + chr(34) if start else ''}" + (
            ' marker-end="url(#head)"' if end else ""
        )
        self._parts.append(f'<path class="{kind}" d="{path}"{heads}/>')

    def __str__(self) -> str:
        return "\n".join([*self._parts, "</svg>", ""])


def flows() -> Drawing:
    """From machine file to C, and from measured log back to a machine file."""
    d = Drawing(960, 372, "The two flows")
    w, h = 152, 56
    columns = [32 + 186 * i for i in range(5)]
    judge, first, second = 26, 128, 262

    d.text(32, first - 12, "1  machine file to C", "title")
    d.box(columns[0], first, w, h, ["machine file", "what a user writes"], "file")
    d.box(columns[1], first, w, h, ["symbolic model", "law and effects"])
    d.box(columns[2], first, w, h, ["structure", "blocks, groups, terms"])
    d.box(columns[3], first, w, h, ["emitted C", "a package"], "c")
    d.box(columns[4], first, w, h, ["estimator", "on host or target"], "c")
    d.box(columns[4], judge, w, h, ["reference", "written apart"], "judge")
    for left in columns[:4]:
        d.line((left + w, first + h / 2), (left + 186, first + h / 2))
    d.line((columns[1] + w / 2, first), (columns[1] + w / 2, judge + h / 2), (columns[4], judge + h / 2))
    d.line((columns[4] + w / 2, judge + h), (columns[4] + w / 2, first), start=True)
    d.text(columns[4] + w / 2 - 8, first - 15, "compare", "small", "end")

    d.text(32, second - 12, "2  log to machine file", "title")
    d.box(columns[0], second, w, h, ["measured log", "position, force"], "file")
    d.box(columns[1], second, w, h, ["residual", "measured - simulated"])
    d.box(columns[2], second, w, h, ["named cause", "or none"])
    d.box(columns[3], second, w, h, ["extended machine", "a machine file"], "file")
    d.box(columns[4], second, w, h, ["gain", "on held-out data"], "judge")
    for left in columns[:4]:
        d.line((left + w, second + h / 2), (left + 186, second + h / 2))
    middle = (first + h + second) / 2
    d.line((columns[3] + w / 2, first + h), (columns[3] + w / 2, middle), (columns[1] + w / 2, middle),
           (columns[1] + w / 2, second))  # fmt: skip
    d.text(columns[2] + w / 2, middle - 7, "runs along the measured motion", "small", "middle")
    bottom = second + h + 24
    d.line((columns[3] + w / 2, second + h), (columns[3] + w / 2, bottom), (14, bottom), (14, first + h / 2),
           (columns[0], first + h / 2))  # fmt: skip
    d.text(columns[1] + w / 2, bottom - 7, "and again through the first flow", "small", "middle")
    return d


def signal_chain() -> Drawing:
    """From raw position and force to the signals of the model."""
    d = Drawing(960, 344, "The signal chain")
    w, h, gap = 104, 38, 62
    x = [122, 276, 410, 552]
    out, rows = 700, [44 + gap * i for i in range(4)]
    stages = [
        ("velocity", ["difference", "one sample old"], "LP", "", "LP"),
        ("acceleration", ["difference"], "LP", "difference", "LP"),
        ("position", ["one sample old"], "LP", "", "LP"),
        ("force", ["one sample old"], "LP", "", "LP"),
    ]
    d.box(20, rows[0], 74, rows[2] + h - rows[0], ["position", "q[k]"], "file")
    d.box(20, rows[3], 74, h, ["force", "u[k]"], "file")
    for y, (name, first, *rest) in zip(rows, stages, strict=True):
        middle = y + h / 2
        d.line((94, middle), (x[0], middle))
        d.box(x[0], y, w + 20, h, first)
        last = x[0] + w + 20
        for left, label in zip(x[1:], rest, strict=True):
            if label:
                d.line((last, middle), (left, middle))
                d.box(left, y, w, h, [label])
                last = left + w
        d.line((last, middle), (out, middle))
        d.box(out, y, 104, h, [name], "c")
    d.box(848, rows[1], 96, rows[3] + h - rows[1], ["friction", "force", "- mass *", "acceleration"], "c")
    d.line((out + 104, rows[1] + h / 2), (848, rows[1] + h / 2))
    d.line((out + 104, rows[3] + h / 2), (848, rows[3] + h / 2))
    y = rows[3] + h + 26
    d.line((x[0], y), (out, y), kind="thin", start=True)
    d.text((x[0] + out) / 2, y + 18, "the same delay in every row: T = h (1 + 2 m), two low-passes and one sample",
           "small", "middle")  # fmt: skip
    d.text(20, 26, "raw", "title")
    d.text(out, 26, "what the model reads", "title")
    return d


def window() -> Drawing:
    """Nodes and intervals of a window, its sweep that resumes, and the expansion."""
    d = Drawing(960, 382, "Window and sweep")
    node = [150 + 112 * i for i in range(7)]
    names = ["x[l-N]", "", "", "", "", "x[l-1]", "x[l]"]
    line = 84
    d.text(20, 28, "window", "title")
    d.line((node[0], line), (node[-1], line), end=False)
    d.box(16, line - 22, 104, 44, ["arrival cost", "all before"], "old")
    d.line((120, line), (node[0] - 9, line))
    for i, x in enumerate(node):
        d.box(x - 9, line - 9, 18, 18, [], "c")
        d.line((x, line - 32), (x, line - 10), kind="thin")
        d.text(x, line - 37, "y", "small", "middle")
        d.text(x, line + 28, names[i], "small", "middle")
    for i in range(6):
        d.text((node[i] + node[i + 1]) / 2, line - 7, "newest" if i == 5 else "interval", "small", "middle")

    top, h = 178, 50
    d.text(20, top - 34, "sweep", "title")
    d.text(20, top - 17, "each box folds a measurement, stacks the defects, condenses a node", "small")
    for i in range(5):
        kept = i < 3
        lines = ["kept", "last update's"] if kept else ["condense", "prepare"]
        d.box(node[i], top, 98, h, lines, "old" if kept else "box")
        d.line((node[i] + 98, top + h / 2), (node[i + 1], top + h / 2))
    d.box(node[5], top, 98, h, ["condense", "feedback"], "judge")
    d.line((node[5] + 98, top + h / 2), (node[6], top + h / 2))
    d.box(node[6], top, 120, h, ["solve", "with y, in bounds"], "judge")
    d.line((node[3] + 49, top + h + 34), (node[3] + 49, top + h))
    d.text(node[3] + 49, top + h + 50, "the sweep resumes at the oldest interval", "small", "middle")
    d.text(node[3] + 49, top + h + 65, "of which a block was linearised anew", "small", "middle")

    base = 338
    d.text(20, base + 4, "expansion", "title")
    d.line((node[6] + 60, top + h), (node[6] + 60, base), (node[0], base))
    for x in node[:6]:
        d.line((x + 49, base - 6), (x + 49, base + 6), kind="thin", end=False)
    d.text((node[0] + node[6]) / 2, base + 24, "back-substitution gives the older nodes, in the next preparation",
           "small", "middle")  # fmt: skip
    return d


def timing() -> Drawing:
    """What happens at the samples of one interval, with one task and with two."""
    d = Drawing(960, 356, "Timing of one interval")
    samples, left, pitch = 13, 150, 58
    x = [left + pitch * i for i in range(samples)]
    axis = 58
    d.text(20, axis + 4, "samples", "title")
    d.line((left - 30, axis), (x[-1] + 50, axis))
    d.text(x[-1] + 50, axis - 13, "time", "small", "end")
    for i, at in enumerate(x):
        d.line((at, axis - 6), (at, axis + 6), kind="thin", end=False)
        label = {0: "0", 1: "1", 2: "2", samples - 2: "M-1", samples - 1: "M"}.get(i, "")
        d.text(at, axis - 13, label, "small", "middle")
    d.text(x[0], axis + 24, "node l-1", "small", "middle")
    d.text(x[-1], axis + 24, "node l", "small", "middle")

    y, w, h = 116, 55, 36
    d.text(20, y + 22, "one task", "title")
    for i, at in enumerate(x):
        d.box(at - w / 2, y, w, h, ["tick"], "judge" if i == 1 else "c")
        d.text(at, y + h + 15, "feedback" if i == 1 else "units", "small", "middle")

    y = 216
    d.text(20, y + 22, "two tasks", "title")
    d.text(20, y + 38, "fast", "small")
    for i, at in enumerate(x):
        last = i in (0, samples - 1)
        d.box(at - w / 2, y, w, h, ["sample"], "judge" if last else "c")
    d.text(x[0], y + h + 15, "+ feedback", "small", "middle")
    d.text(x[-1], y + h + 15, "+ feedback", "small", "middle")
    d.text(20, y + 86, "slow", "small")
    d.box(x[0] + 30, y + 64, x[7] - x[0] - 60, h, ["prepare", "older nodes, linearisation, sweep"])
    d.line((x[0], y + h + 20), (x[0], y + 64 + h / 2), (x[0] + 30, y + 64 + h / 2))
    d.text(x[7] - 18, y + 64 + 22, "done before the next feedback is due", "small")
    note = "Every tick does at most a fixed cost of units. The order of the work, and so every bit of the result, is"
    d.text(20, 338, f"{note} the same in both.", "small")
    return d


def diagnosis() -> Drawing:
    """From record to verdict."""
    d = Drawing(960, 420, "Diagnosis")
    w, h = 168, 58
    columns = [24 + 248 * i for i in range(4)]
    rows = [30, 148, 276]
    d.box(columns[0], rows[0], w, h, ["log and machine"], "file")
    d.box(columns[1], rows[0], w, h, ["record", "rows, blocks, folds"])
    d.box(columns[2], rows[0], w, h, ["base model", "all numbers free"])
    d.box(columns[3], rows[0], w, h, ["law", "the file's or the other"])
    for left in columns[:3]:
        d.line((left + w, rows[0] + h / 2), (left + 248, rows[0] + h / 2))

    d.box(columns[3], rows[1], w, h, ["search", "score test, linear gain"])
    d.box(columns[2], rows[1], w, h, ["refit", "gain by cross-validation"])
    d.box(columns[1], rows[1], w, h, ["add the best", "drop the superfluous"])
    d.box(columns[0], rows[1], w, h, ["back to the file", "groups that matter stay"])
    d.line((columns[3] + w / 2, rows[0] + h), (columns[3] + w / 2, rows[1]))
    for left in columns[3:0:-1]:
        d.line((left, rows[1] + h / 2), (left - 80, rows[1] + h / 2))
    below = rows[1] + h + 26
    d.line((columns[1] + w / 2, rows[1] + h), (columns[1] + w / 2, below), (columns[3] + w / 2, below),
           (columns[3] + w / 2, rows[1] + h))  # fmt: skip
    d.text(columns[2] + w / 2, below - 7, "again, while something material is left", "small", "middle")
    d.text(columns[0] + w + 40, rows[1] + h / 2 - 8, "nothing left", "small", "middle")

    d.box(columns[0], rows[2], w, h, ["rivals", "each in a cause's place"])
    d.box(columns[1], rows[2], w, h, ["what is named", "gain, size, constancy"])
    d.box(columns[2], rows[2], w, h, ["verdict", "is what is left noise?"], "judge")
    d.box(columns[3], rows[2], w, h, ["extended machine", "report, diagnosis.json"], "file")
    d.line((columns[0] + w / 2, rows[1] + h), (columns[0] + w / 2, rows[2]))
    for left in columns[:3]:
        d.line((left + w, rows[2] + h / 2), (left + 248, rows[2] + h / 2))
    meanings = ["adequate: nothing to name", "explained: the causes suffice", "ambiguous: rivals fit as well",
                "unexplained: something no effect has"]  # fmt: skip
    for i, meaning in enumerate(meanings):
        d.text(columns[2], rows[2] + h + 22 + 16 * i, meaning, "small")
    return d


def identification() -> Drawing:
    """From logs alone to a machine file."""
    d = Drawing(960, 300, "From logs alone to a machine file")
    w, h, gap = 160, 56, 186
    columns = [24 + gap * i for i in range(5)]
    upper, lower = 60, 190
    d.text(24, 30, "no starting value goes in; every choice is made on rows that a fit has not seen", "small")
    d.box(columns[0], upper, w, h, ["logs", "and a mass, or none"], "file")
    d.box(columns[1], upper, w, h, ["rows", "behind the chain"])
    d.box(columns[2], upper, w, h, ["convex start", "levels over distances"])
    d.box(columns[3], upper, w, h, ["clusters", "1 to 10 elements"])
    d.box(columns[4], upper, w, h, ["fits", "derivatives: emitted C"], "c")
    d.box(columns[4], lower, w, h, ["choices", "law, elements, effects"], "judge")
    d.box(columns[3], lower, w, h, ["numbers", "at the full rate"], "c")
    d.box(columns[2], lower, w, h, ["intervals", "by blocks"], "judge")
    d.box(columns[1], lower, w, h, ["weights", "what the model leaves"])
    d.box(columns[0], lower, w, h, ["machine file", "and what is open"], "file")
    for left in columns[:4]:
        d.line((left + w, upper + h / 2), (left + gap, upper + h / 2))
        d.line((left + gap, lower + h / 2), (left + w, lower + h / 2))
    d.line((columns[4] + w / 2 - 20, upper + h), (columns[4] + w / 2 - 20, lower))
    d.line((columns[4] + w / 2 + 20, lower), (columns[4] + w / 2 + 20, upper + h))
    d.text(columns[4] + w / 2 + 28, (upper + h + lower) / 2 + 4, "again", "small")
    return d


def commands() -> Drawing:
    """Draw which command leads from what is there to what is wanted."""
    d = Drawing(980, 492, "Which command")
    h, w, wide = 50, 164, 176
    left, middle, right = 24, 214, 408
    top = [24, 112, 200, 300, 400]

    d.box(left, top[0], w, h, ["a log of an axis", "any format and units"], "file")
    d.box(middle, top[0], w, h, ["inspect, identify", "read it; find numbers"], "c")
    d.box(left, top[2], w, h, ["data sheets alone", "mass, friction, rate"], "file")
    d.box(middle, top[2], w, h, ["start", "a first machine file"], "c")
    d.box(right, top[1], wide, h, ["machine file", "what a user writes"], "file")
    d.box(614, top[0], w, h, ["effects, schema", "what it may say"], "c")
    d.box(614, top[1], w, h, ["check, generate", "resolve it; emit"], "c")
    d.box(614, top[2], w, h, ["simulate, export", "here or elsewhere"], "c")
    d.box(802, top[1], 154, h, ["C", "for a controller"], "judge")
    d.box(802, top[2], 154, h, ["ci", "a whole repository"], "c")
    for row in (0, 2):
        d.line((left + w, top[row] + h / 2), (middle, top[row] + h / 2))
    d.line((middle + w, top[0] + h / 2), (right + 50, top[0] + h / 2), (right + 50, top[1]))
    d.line((middle + w, top[2] + h / 2), (right + 50, top[2] + h / 2), (right + 50, top[1] + h))
    d.line((right + wide, top[1] + h / 2), (614, top[1] + h / 2))
    d.line((right + wide - 40, top[1] + h), (right + wide - 40, top[2] + h / 2), (614, top[2] + h / 2))
    d.line((614 + w, top[1] + h / 2), (802, top[1] + h / 2))
    d.line((879, top[1] + h), (879, top[2]))

    d.box(left, top[3], w, h, ["a number is open", "its motion is missing"], "file")
    d.box(middle, top[3], w, h, ["plan", "a motion that shows it"], "c")
    d.line((left + w, top[3] + h / 2), (middle, top[3] + h / 2))
    d.box(right, top[3], wide, h, ["machine file and log", "one log, or several"], "file")
    d.line((right + 88, top[1] + h), (right + 88, top[3]))
    branch = (top[3] + h + top[4]) / 2
    d.line((right + 88, top[3] + h), (right + 88, branch), end=False)
    asked = (
        ("predict", "how large is", "the error?"),
        ("diagnose", "where does it", "come from?"),
        ("estimate, watch", "what does the C", "make of it?"),
        ("compare", "does the C do", "what it must?"),
        ("tune", "which weights", "suit this axis?"),
        ("fleet", "which of many", "has changed?"),
    )
    for i, lines in enumerate(asked):
        x = left + 158 * i
        d.box(x, top[4], 142, 68, lines, "c")
        d.line((right + 88, branch), (x + 71, branch), (x + 71, top[4]))
    return d


DRAWINGS: dict[str, Callable[[], Drawing]] = {
    "commands": commands,
    "flows": flows,
    "signal_chain": signal_chain,
    "window": window,
    "timing": timing,
    "diagnosis": diagnosis,
    "identification": identification,
}

if __name__ == "__main__":
    for name, draw in DRAWINGS.items():
        (FOLDER / f"{name}.svg").write_text(str(draw()), encoding="utf-8")
