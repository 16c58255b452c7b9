"""Stack by call path: the deepest one of every function, from the frames and calls that a compiler writes down."""

import re
from collections.abc import Mapping
from functools import cache
from types import MappingProxyType
from typing import Final

from sgms_mhe.support.errors import BuildError

LIBRARY_FRAME: Final = 64
"""Bytes that a function of the compiler's own library, or memcpy, takes at most: the end of every call path."""

_NODE: Final = re.compile(r'^node: \{ title: "([^"]+)" label: "[^"]*?(?:\\n(\d+) bytes \((\w+)[^"]*)?"', re.MULTILINE)
_EDGE: Final = re.compile(r'^edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"', re.MULTILINE)


def call_paths(graph: str) -> Mapping[str, int]:
    """Bytes of stack of the deepest call path from each function of an object, by its name.

    Args:
        graph: what gcc writes with -fcallgraph-info=su.

    Raises:
        BuildError: a call goes through a pointer, or a function may come to call itself, or a frame has no fixed size.
    """
    frames: dict[str, int] = {}
    library: set[str] = set()
    for title, size, kind in _NODE.findall(graph):
        if title == "__indirect_call":
            raise BuildError("a call goes through a pointer: its stack is not known")
        if size and kind != "static":
            raise BuildError(f"{title}: a frame of no fixed size")
        frames[title] = int(size) if size else 0
        library |= set() if size else {title}
    calls: dict[str, set[str]] = {title: set() for title in frames}
    for caller, callee in _EDGE.findall(graph):
        calls[caller].add(callee)

    under_way: set[str] = set()

    @cache
    def deepest(title: str) -> int:
        if title in under_way:
            raise BuildError(f"{title} may come to call itself: its stack is not known")
        under_way.add(title)
        # Of the library also where nothing is called: a copy of many words is in no graph.
        below = max((deepest(callee) for callee in calls[title] - library), default=LIBRARY_FRAME)
        under_way.discard(title)
        return frames[title] + below

    return MappingProxyType({title.rpartition(":")[2]: deepest(title) for title in calls if title not in library})
