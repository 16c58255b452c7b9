"""Nothing that nothing uses: in the Python package and its workbench, in runtime headers, in emitted packages."""

import ast
import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import pytest

import sgms_bench
import sgms_mhe
from package_variants import VARIANTS
from sgms_mhe.support.paths import runtime_dir, templates_dir

pytestmark = pytest.mark.core

PACKAGE, BENCH = (Path(package.__file__).parent for package in (sgms_mhe, sgms_bench))

USED_FROM_OUTSIDE = {
    "list_commands": "click",
    "get_command": "click",
    "filter_stream": "jinja2",
    "emit": "logging",
    "_repr_html_": "notebooks",
    "to_frame": "Python code of users, for series as a DataFrame",
    "forget_distributions": "tests that install distributions",
}
"""What nothing in the packages uses, and who does."""

# Others register what they decorate, or call it.
PLAIN_DECORATORS = {"property", "cached_property", "staticmethod", "classmethod", "cache", "lru_cache", "dataclass"}


def words(text: str) -> Counter[str]:
    return Counter(re.findall(r"[A-Za-z_]\w*", text))


def is_registered(node: ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) -> bool:
    """Whether a decorator may hand it to somebody else."""
    named = [d.func if isinstance(d, ast.Call) else d for d in node.decorator_list]
    return any(
        (d.attr if isinstance(d, ast.Attribute) else getattr(d, "id", "")) not in PLAIN_DECORATORS for d in named
    )


def definitions(tree: ast.Module) -> Iterator[str]:
    """Names of functions, methods, classes, and of the constants of the module; without those of the language."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) and not is_registered(node):
            yield node.name
    for node in tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        yield from (target.id for target in targets if isinstance(target, ast.Name))


def uses(tree: ast.Module, *, imports: bool) -> Iterator[str]:
    """Names that are read, as variables or attributes; imported ones but where they are only handed on."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
            yield node.id
        elif isinstance(node, ast.Attribute):
            yield node.attr
        elif imports and isinstance(node, ast.ImportFrom):
            yield from (alias.name for alias in node.names)


def unused(packages: Collection[Path], templates: Path) -> set[str]:
    """Names that packages define and use nowhere, their templates included."""
    files = [path for package in packages for path in package.rglob("*.py")]
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in files}
    defined = {name for tree in trees.values() for name in definitions(tree) if not name.startswith("__")}
    used = {name for path, tree in trees.items() for name in uses(tree, imports=path.name != "__init__.py")}
    for folder in (*packages, templates):
        used |= {name for path in folder.rglob("*.jinja") for name in words(path.read_text(encoding="utf-8"))}
    return defined - used


def test_everything_in_the_package_is_used() -> None:
    """Exactly the names stated are not: one that finds a use is taken from the list."""
    assert unused((PACKAGE, BENCH), templates_dir()) == set(USED_FROM_OUTSIDE)


def test_everything_in_the_runtime_headers_is_used() -> None:
    """By emitted code or by each other. Mathematical functions are what expressions are printed as."""
    headers = {path.name: path.read_text(encoding="utf-8") for path in runtime_dir().glob("sgms_*.h")}
    others = [*templates_dir().rglob("*.jinja"), *(PACKAGE / "emission").glob("*.py")]
    used = words("\n".join([*headers.values(), *(path.read_text(encoding="utf-8") for path in others)]))
    operations = {f"sgms_{name}" for name in ("not", "cos", "floor", "lane_exp")}
    defined = Counter(
        name
        for text in headers.values()
        for name in re.findall(r"^(?:static|#define)[^(;=\n]*?\b(sgms_\w+)\(", text, re.MULTILINE)
    )
    assert len(defined) > 40
    assert {name for name, times in defined.items() if used[name] == times} == operations


SHAPES = (
    "flow", "flow, ekf", "flow, newest, single", "flow, 5 merged", "flow, all merged", "rk4, fixed", "rk4, all",
    "rk4, 4 merged, newest", "rk4, ekf", "horizon 1", "n_z 1", "micro-viscous", "accuracy",
    "compensation off", "every effect, all", "every effect, fixed, rk4, 4 merged", "effects: upstream, 5 merged",
    "linear model", "toy, states", "position loop with all", "voltage",
)  # fmt: skip
"""Variants whose code differs in kind."""


def unused_c(files: Mapping[str, str], public: str) -> set[str]:
    """Static functions and constant tables of emitted files that no other line names.

    Those of the header `public` are the application's, the vectors of the self-test as well; what begins with
    `sgms_` is a library, as the runtime headers are.
    """
    code = {
        name: re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
        for name, text in files.items()
        if name.endswith((".c", ".h")) and not name.startswith("sgms_")
    }
    named = words("\n".join(code.values()))
    own = [text for name, text in code.items() if name != public and not name.endswith("_selftest.h")]
    defined = {
        name
        for text in own
        for pattern in (r"^static [^;={(]*?\b(\w+)\(", r"^static const [^=;(]*?\b(\w+)(?:\[[^=]*)? =")
        for name in re.findall(pattern, text, re.MULTILINE)
    }
    return {name for name in defined if named[name] < 2 and not name.startswith("sgms_")}


@pytest.mark.parametrize("title", SHAPES)
def test_everything_in_a_package_is_used(title: str) -> None:
    package = VARIANTS[title].package
    found = unused_c(package.files, f"{package.machine.name}.h")
    assert not found


def test_what_nothing_uses_in_c_is_found() -> None:
    files = {
        "axis.c": "static void used(void)\n{\n}\nvoid axis(void) { used(); /* lonely, table */ }\n",
        "axis.h": "static inline int axis_of(int a)\n{\n    return a;\n}\n",
        "axis_config.h": "static int lonely(\n    int a)\n{\n}\nstatic const int table[2] = {1, 2};\n",
        "axis_selftest.h": "static const int vector[1] = {1};\n",
        "sgms_math.h": "static inline int sgms_unused(int a);\n",
    }
    assert unused_c(files, "axis.h") == {"lonely", "table"}
