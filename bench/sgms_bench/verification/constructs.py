"""Constructs that emitted C avoids, so that it can be proven: checked in the syntax tree of a compiler."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Final

from sgms_bench.verification.outcome import AbsentError, CheckOutcome, require
from sgms_bench.verification.syntax import (
    Node,
    bare,
    callees,
    functions,
    is_function_pointer,
    is_variable_length,
    syntax_tree,
    walk,
)
from sgms_mhe.emission.package import Package, emit_package
from sgms_mhe.machine import Machine

JUMPS: Final = ("GotoStmt", "IndirectGotoStmt", "LabelStmt", "StmtExpr", "VAArgExpr")
DECLARATIONS: Final = ("VarDecl", "ParmVarDecl", "FieldDecl", "TypedefDecl")
BUILTINS: Final = re.compile(r"__builtin_(?:memcpy|fabsf?)|memcpy|memset")
"""All that is called from outside of a package; the compiler makes instructions of it, or takes it from a C library."""

LOOPS: Final[Mapping[tuple[str, str], str]] = {
    ("prepare", "WhileStmt"): "the cursor goes up by one; units end at nodes + steps + condensed, at most those stated",
    ("update", "WhileStmt"): "the same units",
    ("tick", "ForStmt"): "what is left of the work of one sample goes down by a cost of at least one",
    ("sgms_flow_place_of_s", "WhileStmt"): "j goes up by one to FLOW_SEGMENTS - 1",
    ("choose_block", "ForStmt"): "rank goes down by one to 0",
}
"""Loops that do not count up to a bound which stands before they start, and why they end: (function, kind)."""


def check_constructs(machines: Sequence[Machine], progress: Callable[[str], None]) -> list[CheckOutcome]:
    """Check that packages have no function pointers, recursion, jumps, writable objects, unbounded loops."""
    checks = {
        "no function pointers, no recursion": pointers_and_recursion,
        "no jumps, no variable-length arrays, no globals": jumps_and_storage,
        "loops count up to a bound, or have one stated": unbounded_loops,
    }
    try:
        require("clang")
    except AbsentError as absent:
        return [CheckOutcome(check, "", skipped=str(absent)) for check in checks]
    tried, failures = dict.fromkeys(checks, 0), {check: dict[str, None]() for check in checks}
    for machine in machines:
        package = emit_package(machine, selftest=False)
        tree = syntax_tree(package)
        for check, find in checks.items():
            count, found = find(package, tree)
            tried[check] += count
            failures[check] |= {f"{machine.name}: {text}": None for text in found}
        progress(f"syntax trees: {machine.name}")
    return [
        CheckOutcome(check, f"{tried[check]} places of {len(machines)} packages", tuple(failures[check]))
        for check in checks
    ]


# --- calls -----------------------------------------------------------------------------------------------------------


def pointers_and_recursion(_: Package, tree: Node) -> tuple[int, list[str]]:
    """Number of calls, and what is wrong: a pointer to a function, a circle of calls, a function from outside."""
    own = functions(tree)
    graph = {name: dict(callees(node)) for name, node in own.items()}
    found = [
        f"{name}: {n} is taken as a pointer" for name, to in graph.items() for n, called in to.items() if not called
    ]
    declared = [node for node in walk(tree) if node.get("kind") in DECLARATIONS and is_function_pointer(node["type"])]
    found += [f"{node.get('name')} is a pointer to a function: {node['type']}" for node in declared]
    outside = {n for to in graph.values() for n in to if n not in own and not BUILTINS.fullmatch(n)}
    found += [f"{name} is called, and not part of the package" for name in sorted(outside)]
    found += [f"{name} calls itself" for name in own if name in _reachable(graph, name)]
    return sum(len(to) for to in graph.values()), found


def _reachable(graph: Mapping[str, Mapping[str, bool]], start: str) -> set[str]:
    """Functions that a call may come to."""
    reached: set[str] = set()
    left = list(graph[start])
    while left:
        name = left.pop()
        if name not in reached:
            reached.add(name)
            left += graph.get(name, ())
    return reached


# --- storage ---------------------------------------------------------------------------------------------------------


def jumps_and_storage(_: Package, tree: Node) -> tuple[int, list[str]]:
    """Number of variables, and what is wrong: jumps, lengths that are not constant, variables that outlive a call."""
    nodes = list(walk(tree))
    variables = [node for node in nodes if node.get("kind") == "VarDecl"]
    found = [f"line {node['line']}: {node['kind']}" for node in nodes if node.get("kind") in JUMPS]
    found += [f"{v['name']} has no constant length: {v['type']}" for v in variables if is_variable_length(v["type"])]
    lasting = [node for node in tree["inner"] if node.get("kind") == "VarDecl"]
    lasting += [node for node in variables if node.get("storageClass") == "static"]
    found += [f"{v['name']} is writable and outlives a call" for v in lasting if not _is_constant(v["type"])]
    return len(variables), found


def _is_constant(type_name: str) -> bool:
    """Return True if an object of a type is constant itself: of a pointer, the part behind the star counts."""
    return "const" in type_name.rpartition("*")[2]


# --- loops -----------------------------------------------------------------------------------------------------------


def unbounded_loops(package: Package, tree: Node) -> tuple[int, list[str]]:
    """Number of loops, and those that neither count up to a bound nor are in the list."""
    count, found = 0, []
    for name, function in functions(tree).items():
        common = name.removeprefix(f"{package.machine.name}_")
        for node in walk(function):
            if node.get("kind") not in ("ForStmt", "WhileStmt", "DoStmt"):
                continue
            count += 1
            is_counted = node["kind"] == "ForStmt" and _is_counted(node)
            if not is_counted and (common, node["kind"]) not in LOOPS:
                found.append(f"{name}: line {node['line']}: a loop without a bound")
    return count, found


def _is_counted(loop: Node) -> bool:
    """Return True if it counts a variable up (or down) to a bound, and its body changes neither."""
    _, _, condition, advance, body = loop["inner"]
    counter = _counter(advance)
    if counter is None:
        return False
    written = set(_written(body))
    for left, right in _comparisons(condition):
        sides = [bare(left), bare(right)]
        if not any(_names(side) == {counter} and side.get("kind") == "DeclRefExpr" for side in sides):
            mentioned = [side for side in sides if counter in _names(side)]
            if len(mentioned) != 1 or not _is_linear(mentioned[0]):
                continue
        bound = {name for side in sides for name in _names(side)} - {counter}
        calls = any(node.get("kind") == "CallExpr" for side in sides for node in walk(side))
        if counter not in written and not bound & written and not calls:
            return True
    return False


def _counter(advance: Node) -> str | None:
    """The variable that `i++`, `i--` or `i += n` advances."""
    kind, opcode = advance.get("kind"), advance.get("opcode")
    is_step = kind == "UnaryOperator" and opcode in ("++", "--")
    is_stride = kind == "CompoundAssignOperator" and opcode in ("+=", "-=")
    if not (is_step or is_stride):
        return None
    target = bare(advance["inner"][0])
    return target["refers"]["id"] if target.get("kind") == "DeclRefExpr" else None


def _comparisons(condition: Node) -> Iterator[tuple[Node, Node]]:
    """Comparisons that all have to hold."""
    node = bare(condition)
    if node.get("kind") != "BinaryOperator":
        return
    left, right = node["inner"]
    if node["opcode"] == "&&":
        yield from _comparisons(left)
        yield from _comparisons(right)
    elif node["opcode"] in ("<", "<=", ">", ">="):
        yield left, right


def _is_linear(side: Node) -> bool:
    """Return True if an expression is a variable and a constant added to it."""
    return side.get("kind") == "BinaryOperator" and side["opcode"] in ("+", "-")


def _names(node: Node) -> set[str]:
    """Variables and fields in an expression."""
    names = {
        n["refers"]["id"]
        for n in walk(node)
        if n.get("kind") == "DeclRefExpr" and n["refers"]["kind"] != "EnumConstantDecl"
    }
    return names | {n["name"] for n in walk(node) if n.get("kind") == "MemberExpr"}


def _written(body: Node) -> Iterator[str]:
    """Variables and fields that are assigned, counted, or whose address is taken."""
    for node in walk(body):
        kind, opcode = node.get("kind"), node.get("opcode", "")
        assigns = (
            kind in ("BinaryOperator", "CompoundAssignOperator")
            and opcode.endswith("=")
            and opcode not in ("==", "<=", ">=", "!=")
        )
        if assigns or (kind == "UnaryOperator" and opcode in ("++", "--", "&")):
            target = bare(node["inner"][0])
            if target.get("kind") == "DeclRefExpr":
                if not (opcode == "&" and _is_constant(target["refers"]["type"])):
                    yield target["refers"]["id"]
            elif target.get("kind") == "MemberExpr":
                yield target["name"]
