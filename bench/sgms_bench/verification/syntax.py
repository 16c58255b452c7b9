"""The syntax tree of one emitted package, as clang dumps it: functions, what they call, their loops."""

import json
import re
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from sgms_bench.verification.outcome import run
from sgms_mhe.emission.package import Package, write_package
from sgms_mhe.support.errors import BuildError

Node = Mapping[str, Any]
KEPT = ("kind", "name", "opcode", "value", "inner", "storageClass", "isUsed", "castKind", "mangledName")


def syntax_tree(package: Package) -> Node:
    """The tree of a package's translation unit; every node has the `line` at which it begins.

    Raises:
        BuildError: clang refused.
    """
    name = package.machine.name
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / name
        write_package(package, folder)
        # No vector registers: the code that every processor has. A tile is then one lane.
        flags = ["-std=c99", "-fsyntax-only", "-Xclang", "-ast-dump=json"]
        done = run(["clang", *flags, folder / f"{name}.c"])
    if done.code != 0:
        raise BuildError(f"clang: {done.output[-2000:]}")
    tree: Node = json.loads(done.output, object_hook=_Places())
    return tree


class _Places:
    """Fills in the lines: clang leaves one out that is the same as that of the place before in its text."""

    def __init__(self) -> None:
        self.line = 0

    def __call__(self, read: dict[str, Any]) -> dict[str, Any]:
        if "kind" not in read:
            if "offset" in read:
                self.line = read["line"] = read.get("line", self.line)
            return read
        kept = {key: read[key] for key in KEPT if key in read}
        kept["id"] = read.get("id")
        kept["type"] = read.get("type", {}).get("qualType", "")
        kept["line"] = _first_line(read.get("range", {}).get("begin", {}))
        kept["refers"] = read.get("referencedDecl")
        return kept


def _first_line(place: Node) -> int:
    if "expansionLoc" in place:
        place = place["expansionLoc"]
    return int(place.get("line", 0))


def walk(node: Node) -> Iterator[Node]:
    """A node and all below it."""
    yield node
    for child in node.get("inner", ()):
        yield from walk(child)


def functions(tree: Node) -> Mapping[str, Node]:
    """Functions that have a body, by name."""
    found = (node for node in tree["inner"] if node.get("kind") == "FunctionDecl")
    return {node["name"]: node for node in found if any(c.get("kind") == "CompoundStmt" for c in node.get("inner", ()))}


def bare(node: Node) -> Node:
    """An expression without parentheses and conversions around it."""
    while node.get("kind") in ("ParenExpr", "ImplicitCastExpr", "CStyleCastExpr", "ConstantExpr"):
        node = node["inner"][0]
    return node


def callees(function: Node) -> Iterator[tuple[str, bool]]:
    """(function that is named, whether it is called there and then)."""
    called = set()
    for node in walk(function):
        if node.get("kind") == "CallExpr":
            called.add(id(bare(node["inner"][0])))
        if node.get("kind") == "DeclRefExpr" and (node["refers"] or {}).get("kind") == "FunctionDecl":
            yield node["refers"]["name"], id(node) in called


def is_function_pointer(type_name: str) -> bool:
    """Return True if a type is, or holds, a pointer to a function."""
    return re.search(r"\(\*[^()]*\)\s*\(", type_name) is not None


def is_variable_length(type_name: str) -> bool:
    """Return True if a type is an array whose length is not a constant."""
    return re.search(r"\[[^\]\d]", type_name) is not None
