"""Templates to text: one strict environment, in which a template reads like the C that it makes.

A literal of the C text stands in a template as it is, `0.5`; outside of comments and strings it gets the suffix of the
package's precision. Numbers that Python computed are printed by a filter:

    real    0.1 -> 0.1, or 0.1f
    reals   numbers, separated by commas
    array   the same in braces: an initialiser
    series  coefficients c_0, c_1, ... -> x^2 (c_0 - c_1 x + c_2 x^2 - ...), by Horner's scheme, of the given x
    braced  anything in braces, separated by commas
    each    values put into a pattern: [0, 1] | each("at{}") -> at0, at1
    rows    literals separated by commas -> lines of an initialiser
    zip     pairs of two sequences
    dotted  a unit as FMI and Modelica write it: N m s/rad -> N.m.s/rad
    product the same as Simscape writes it: N*m*s/rad
"""

import hashlib
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields, replace
from functools import lru_cache
from typing import Final, Literal

import jinja2
from jinja2.ext import Extension
from jinja2.lexer import Token, TokenStream

from sgms_mhe.emission.c_source import REAL, CPrinter
from sgms_mhe.emission.columns import COLUMNS, INDENT, wrap_columns
from sgms_mhe.emission.context import PackageView
from sgms_mhe.support.paths import templates_dir

Precision = Literal["double", "single"]
C_SUFFIXES: Final = (".c", ".h", ".hpp")

_PIECE = re.compile(
    rf"""(?P<open>/\*) | (?P<close>\*/) | "(?:[^"\\\n]|\\.)*"
    | (?<![\w.])(?P<literal>{REAL})(?![\w.])""",
    re.VERBOSE,
)


class _Literals(Extension):
    """Floating-point literals in the text of templates get the suffix of single precision."""

    def filter_stream(self, stream: TokenStream) -> Iterator[Token]:
        in_comment = False

        def replaced(match: re.Match[str]) -> str:
            nonlocal in_comment
            if match["open"] or match["close"]:
                in_comment = bool(match["open"])
            return match[0] + ("f" if match["literal"] and not in_comment else "")

        for token in stream:
            yield Token(token.lineno, token.type, _PIECE.sub(replaced, token.value)) if token.type == "data" else token


def render(view: PackageView, *, model_alone: bool = False) -> dict[str, str]:
    """The emitted C of a package, by file name; `view` as `stamp_digest`.

    `model_alone`: the headers a model runs by without its estimator, their lines as long as they come.
    """
    name = view.package.name
    parts = ["config.h", "model.h", "integrator.h"]
    parts += ["flow.h"] * (view.flow is not None) + ["table.h"] * bool(view.tables)
    parts += ["selftest.h", "selftest.c"] * (view.vectors is not None)
    files = {f"{name}.h": "machine.h", **{f"{name}_{part}": part for part in parts}}
    if not model_alone:
        files |= {f"{name}.c": "machine.c", f"{name}_compensation.h": "compensation.h"}
    precision, wraps = view.machine.code.precision, not model_alone
    return {file: _render(view, template, precision, wraps=wraps) for file, template in files.items()}


def render_page(view: PackageView, template: str, delivery: object) -> str:
    """A file of a package that is no C.

    Args:
        view: of the package.
        template: without its suffix.
        delivery: the package's C as templates name it.
    """
    return _render(view, template, "double", delivery=delivery)


def render_text(template: str, context: Mapping[str, object]) -> str:
    """A file that is no part of a package; `context` has all that its template names."""
    return _environment("double").get_template(f"{template}.jinja").render(context)


def render_c(template: str, context: Mapping[str, object]) -> str:
    """The same for C, whose lines are broken as those of packages are."""
    return wrap_columns(render_text(template, context))


def dot_unit(unit: str) -> str:
    """A unit as FMI and Modelica write it: `kg m^2` -> `kg.m2`."""
    return unit.replace("^", "").replace(" ", ".")


def stamp_digest(view: PackageView) -> PackageView:
    """The view with the digest of the public header's declarations."""
    header = _render(view, "machine.h", "double")
    return replace(view, package=replace(view.package, header_digest=declared_digest(header)))


def declared_digest(header: str) -> str:
    """Eight hexadecimal digits of all that a header declares and defines, comments and layout left out."""
    code = re.sub(r"/\*.*?\*/", " ", header, flags=re.DOTALL)
    return hashlib.sha256(" ".join(code.split()).encode()).hexdigest()[:8]


def _render(view: PackageView, template: str, precision: Precision, *, wraps: bool = True, **more: object) -> str:
    """One template's text; literals in it as those of a precision."""
    subjects = {field.name: getattr(view, field.name) for field in fields(view)}
    subjects |= {"name": view.package.name, "NAME": view.package.NAME, "units": view.machine.plant.units, **more}
    text = _environment(precision).get_template(f"{template}.jinja").render(subjects)
    return wrap_columns(text) if wraps and template.endswith(C_SUFFIXES) else text


@lru_cache(maxsize=2)
def _environment(precision: Precision) -> jinja2.Environment:
    """Templates and their functions; compiled templates stay with it."""
    printer = CPrinter(precision)
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(templates_dir()),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
        auto_reload=False,
        extensions=[_Literals] if precision == "single" else [],
    )
    environment.filters.update(
        real=printer.number,
        reals=printer.numbers,
        array=printer.array,
        series=printer.series,
        rows=_rows,
        each=lambda values, pattern: [pattern.format(value) for value in values],
        shown=_show,
        braced=lambda values: "{" + ", ".join(map(str, values)) + "}",
        zip=zip,
        dotted=dot_unit,
        product=lambda unit: unit.replace(" ", "*"),
    )
    return environment


def _show(values: Iterable[float]) -> str:
    """Numbers for a comment, one for all that are the same."""
    return ", ".join(dict.fromkeys(f"{value:g}" for value in values))


def _rows(literals: str) -> str:
    """Lines of an initialiser, as full as they get."""
    return "\n".join(textwrap.wrap(literals, COLUMNS, initial_indent=INDENT * " ", subsequent_indent=INDENT * " "))


_UNUSED: Final = """\
/* No package uses all of the runtime; in a header clang does not mind. */
#if defined(__clang__)
#pragma clang diagnostic ignored "-Wunused-function"
#endif
"""
_INCLUDE: Final = re.compile(r'^#include "(\w+\.h)"\n', re.MULTILINE)


def amalgamate_files(files: Mapping[str, str], name: str) -> dict[str, str]:
    """The same C in NAME.c and NAME.h: every other header stands where it is first included.

    Args:
        files: C of a package by file name; it includes nothing else by name in quotes.
        name: of the machine.
    """
    public = f"{name}.h"
    placed = {public}

    def place(include: re.Match[str]) -> str:
        file = include[1]
        if file in placed:
            return ""
        placed.add(file)
        return _INCLUDE.sub(place, files[file])

    sources = sorted(file for file in files if file.endswith(".c"))
    parts = [_INCLUDE.sub(place, files[file]) for file in sources]
    return {public: files[public], f"{name}.c": f'#include "{public}"\n\n{_UNUSED}\n' + "\n".join(parts)}
