"""Sentences of the product that claim something of a log, and the facts that make them true."""

import math
import re
from collections.abc import Iterator
from typing import Final

from sgms_bench.logs.faults import Case

CLAIMS: Final[tuple[tuple[str, tuple[str, ...]], ...]] = (
    (r"where it starts over", ("wraps",)),
    (r"such jumps|jumps by", ("wraps", "unsigned")),
    (r"signed number of", ("unsigned",)),
    (r"scale = -1|of the position's sign|drives the axis|drives the motion|the other sign", ("turned",)),
    (r"in which the axis moves|hardly moves", ("still",)),
    (r"every row = .*that changes", ("constant",)),
    (r"no time and no row number|the same signal", ()),
    (r"swapped with", ("swapped",)),
    (r"saturated", ("clipped",)),
    (r"of the friction a spring|well beyond break-away", ("still",)),
    (r"Needed[^.]*in both directions", ("one way", "still")),
    (r"is integrated from 0", ("no position",)),
    (r"stands for it", ("no force",)),
    (r"the time of the row before", ("repeated",)),
    (r"coarser than the samples", ("coarse stamps",)),
    (r"time decreases", ("backwards",)),
    (r"uniform time within 1 %", ("uneven",)),
    (r"interpolated onto|resampled", ("uneven",)),
    (r"time in another unit", ("time unit",)),
    (r"without a unit", ("no unit",)),
    (r"per A;", ("ampere",)),
    (r"as --rate", ("no time", "no unit")),
    (r"one column; .*says which", ("two columns",)),
    (r"cut to the first", ("cut",)),
    (r"sampling\.rate of", ("time unit",)),
    (
        r"a motion and the (?:force|torque) that makes it",
        ("swapped", "scaled", "still", "stuck", "unit mm", "unit mrad"),
    ),
    (r"about plant\.", ("swapped", "scaled", "unit mm", "unit mrad")),
    (r"a position in (?:metres|radians|m|rad);", ("swapped", "unit mm", "unit mrad")),
    (r"the motion shows none", ("no force", "one way", "still")),
    (r"the motion does not show it", ("no force", "one way", "still")),
    (r"a log that shows dry friction", ("one way", "still")),
    (r"dropped|left out: .*lines", ("summary",)),
)
"""Patterns of sentences; facts of which one makes it true. A sentence without one is not judged, which is wrong."""


def false_sentences(text: str, case: Case) -> Iterator[str]:
    """Sentences of an output that are not true of a case."""
    for pattern, facts in CLAIMS:
        found = re.search(pattern, text)
        if found is not None and not case.facts & set(facts):
            yield f"{found[0]}: {text.strip()}"
    for fact, pattern in (("wraps", r"wrap = ([-\d.e+]+)"), ("scaled", r"scale = ([-\d.e+]+\d)")):
        stated = re.findall(pattern, text)
        if fact in case.facts and stated:
            true = case.numbers[fact]
            near = 1e-6 if fact == "wraps" else 0.3
            if not any(math.isclose(float(number), true, rel_tol=near) for number in stated):
                yield f"{pattern} says {', '.join(stated)}, true is {true:.6g}"


def is_judged(sentence: str) -> bool:
    """Return True if one of the claims is in a sentence."""
    return any(re.search(pattern, sentence) for pattern, _ in CLAIMS)
