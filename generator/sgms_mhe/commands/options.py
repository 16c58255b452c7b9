"""Commands out of typed functions: arguments and options with their help, types, ranges and defaults.

A positional parameter is an argument, one by keyword alone an option. Its annotation says the type, `Option` in it the
range and the metavar, its entry under `Args:` the help. A command that calls a function of `api` takes the options that
are marked in its signature too. That function is read and not imported: its module computes.
"""

import ast
import inspect
import math
import re
from collections.abc import Callable, Mapping, Sequence
from inspect import Parameter
from pathlib import Path
from typing import Any, Final

import click

from sgms_mhe.commands.completion import COMPLETIONS
from sgms_mhe.commands.log_options import load_for_log, log_table
from sgms_mhe.support.options import Option

UNIT: Final = re.compile(r"_(s|m|N|Hz)$")
"""At the end of a parameter's name."""
ENTRY: Final = re.compile(r"^    (\w[\w, ]*):((?:.|\n(?!    \S))*)", re.MULTILINE)
"""Of a section of a docstring: name and text."""
SHARED: Final = {
    "json": "print the result as JSON",
    "standalone": "write every table into the new machine file; otherwise it extends MACHINE by the path to its file",
    "trace": "folder for all decisions with their numbers: one JSON file per stage",
}
"""Help of options that mean the same in every command."""


class RangedNumber(click.FloatRange):
    """A finite number within a stated range, its ends included."""

    def __init__(self, option: Option) -> None:
        super().__init__(option.least, option.most)
        self._infinite = option.infinite

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The number of a text; refuses other texts, and NaN, which lies outside no range."""
        if self._infinite and value in (self._infinite, math.inf):
            return math.inf
        number = super().convert(value, param, ctx)
        if math.isnan(number):
            self.fail(f"{value} is not in the range {self._describe_range()}.", param, ctx)
        return number


class NamedValue(click.ParamType[tuple[str, Any]]):
    """A text `name=value`; the value is a number where a range is stated."""

    name = "pair"

    def __init__(self, option: Option) -> None:
        self._form, self._most = option.metavar, option.most

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, Any]:
        """(name, value) of a text; refuses one without both, and a number out of range."""
        name, _, text = (part.strip() for part in str(value).partition("="))
        if self._most is None and name and text:
            return name, text
        if self._most is None:
            self.fail(f"{value!r} is not {self._form}.", param, ctx)
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        if not (name and abs(number) <= self._most):
            limits = f"a number up to {self._most:g}, as in stiffness=1.2"
            self.fail(f"{value!r} is not {self._form} with {limits}", param, ctx)
        return name, number


Function = Callable[..., bool | int | None]
"""Of a command; returns its exit code, or None."""


def make_command(*examples: str, of: str = "") -> Callable[[Function], click.Command]:
    """Make a command of a function.

    An option that is not given does not reach the function: its own default holds. `machine` comes loaded. With an
    argument `log`, or a parameter `log_table`, the command also has the options on keys missing in a log; they
    are laid over the machine's table `[log]`, and are the value of `log_table`.

    Args:
        examples: calls, for the end of the help.
        of: function of `api` that the command calls, as `simulation.simulate`: its options are the command's, its
            description stands behind the first paragraph of the command's own.
    """
    return lambda function: TypedCommand(function, examples, of)


class TypedCommand(click.Command):
    """A command whose options are read when they are asked for: the list of all commands needs none."""

    def __init__(self, function: Function, examples: Sequence[str], of: str) -> None:
        short = (function.__doc__ or "").partition("\n")[0]
        epilog = "\b\nExample:\n" + "\n".join(f"  sgms-mhe {line}" for line in examples)
        super().__init__(None, callback=self._call, short_help=short, epilog=epilog)
        self._function, self._of = function, of
        self._own = inspect.signature(function).parameters
        log = self._own.get("log")
        reads_log = "log_table" in self._own or (log is not None and log.kind is not log.KEYWORD_ONLY)
        self._log_options = inspect.signature(log_table).parameters if reads_log else {}
        del self.params, self.help

    def __getattr__(self, name: str) -> Any:
        if name not in ("params", "help"):
            raise AttributeError(name)
        (first, *rest), texts = _parse_doc(inspect.getdoc(self._function) or "")
        own = self._own.values()
        parameters = {p.name: p for p in own if p.name != "log_table" and p.kind != p.VAR_KEYWORD}
        if self._of:
            (_, *between), more, options = _read_function(*self._of.split("."))
            rest, texts = [*between, *rest], more | texts
            parameters |= {option.name: option for option in options}
        texts = SHARED | _parse_doc(inspect.getdoc(log_table) or "")[1] | texts
        self.params = [_parameter(p, texts) for p in (*parameters.values(), *self._log_options.values())]
        self.help = "\n\n".join([first, *rest])
        return vars(self)[name]

    def _call(self, **values: Any) -> None:
        given = {name: value for name, value in values.items() if value not in (None, (), {})}
        said = {name: given.pop(name) for name in self._log_options if name in given}
        table = log_table(**said) if said else {}
        if "log_table" in self._own:
            given["log_table"] = table
        if "machine" in given:
            given["machine"] = load_for_log(given["machine"], table)
        if code := self._function(**given):
            click.get_current_context().exit(int(code))


def _parse_doc(doc: str) -> tuple[list[str], dict[str, str]]:
    """Paragraphs of a docstring before its sections, and the entries of `Args:` by name."""
    prose, *sections = re.split(r"\n\n(?=(?:Args|Returns|Raises):\n)", doc)
    entries = [entry for section in sections if section.startswith("Args:") for entry in ENTRY.findall(section)]
    return prose.split("\n\n"), {name: " ".join(text.split()) for name, text in entries}


def _read_function(module: str, name: str) -> tuple[list[str], dict[str, str], list[Parameter]]:
    """Description of a function of `api`, texts of its parameters, and those that are options."""
    source = Path(__file__).parents[1] / "api" / f"{module}.py"
    body = ast.parse(source.read_text(encoding="utf-8")).body
    function = next(node for node in body if isinstance(node, ast.FunctionDef) and node.name == name)
    given = function.args
    first = len(given.args) - len(given.defaults)
    defaults = [*[None] * first, *given.defaults, *given.kw_defaults]
    options = [
        Parameter(
            argument.arg,
            Parameter.KEYWORD_ONLY,
            default=Parameter.empty if default is None else ast.literal_eval(default),
            annotation=ast.unparse(argument.annotation),
        )
        for argument, default in zip([*given.args, *given.kwonlyargs], defaults, strict=True)
        if argument.annotation is not None and ast.unparse(argument.annotation).startswith("Annotated[")
    ]
    return *_parse_doc(ast.get_docstring(function) or ""), options


def _parameter(parameter: Parameter, texts: Mapping[str, str]) -> click.Parameter:
    """The argument or option a parameter of a function is."""
    name, complete = parameter.name, COMPLETIONS.get(parameter.name)
    kind, form = _read_annotation(parameter.annotation)
    holder, _, inner = kind.removesuffix("]").partition("[")
    is_map, is_list = holder in ("Mapping", "dict"), holder == "Sequence" or inner.endswith(", ...")
    value = NamedValue(form) if is_map else _click_type(inner.removesuffix(", ...") if is_list else kind, form)
    required = parameter.default is Parameter.empty
    if parameter.kind is not parameter.KEYWORD_ONLY:
        count = -1 if is_list else 1
        return click.Argument([name], required=required, type=value, nargs=count, shell_complete=complete)
    unit, (text, _, without) = UNIT.search(name), texts[name].partition("; None: ")
    text += f"; default: {without}" if without and not required else ""
    metavar = unit[1].upper() if unit else "FILE" if isinstance(value, click.Path) else None
    stated = not required and kind != "bool" and parameter.default not in (None, (), math.inf)
    return click.Option(
        [form.name or f"--{UNIT.sub('', name).replace('_', '-')}", name],
        type=value,
        is_flag=True if kind == "bool" else None,
        required=required,
        multiple=is_map or is_list,
        callback=(lambda _context, _option, pairs: dict(pairs)) if is_map else None,
        metavar=form.metavar or metavar,
        help=f"{text[:1].upper()}{text[1:]}{'' if text.endswith('.') else '.'}",
        shell_complete=complete,
        **({"default": parameter.default, "show_default": True} if stated else {}),
    )


def _read_annotation(text: str) -> tuple[str, Option]:
    """Type of an annotation, without None, and its `Option`."""
    node, form = ast.parse(text, mode="eval").body, Option()
    if text.startswith("Annotated[") and isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Tuple):
        node, call = node.slice.elts
        if isinstance(call, ast.Call):
            named = {keyword.arg or "": ast.literal_eval(keyword.value) for keyword in call.keywords}
            form = Option(*map(ast.literal_eval, call.args), **named)
    return ast.unparse(node).removesuffix(" | None"), form


def _click_type(kind: str, form: Option) -> Any:
    """Type of a single value; of the alternatives of a union the first counts."""
    kind = kind.partition(" | ")[0]
    holder, _, inner = kind.removesuffix("]").partition("[")
    if holder == "Literal":
        return click.Choice(ast.literal_eval(f"({inner},)"))
    if holder == "tuple":
        return tuple(_click_type(each, form) for each in inner.split(", "))
    if kind == "int":
        least, most = (None if end is None else int(end) for end in (form.least, form.most))
        return click.IntRange(least, most)
    plain = {"float": RangedNumber(form), "str": click.STRING, "Machine": click.STRING, "bool": click.BOOL}
    return plain.get(kind, click.Path(path_type=Path))
