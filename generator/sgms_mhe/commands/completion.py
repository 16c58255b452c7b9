"""Completion of values by a shell."""

from collections.abc import Callable, Mapping
from typing import Final

import click
from click.shell_completion import CompletionItem

from sgms_mhe.support.paths import machines_dir


def _machines(ctx: click.Context, param: click.Parameter, begun: str) -> list[CompletionItem]:
    """Names in machines/, or files where none begins so."""
    names = sorted(path.stem for path in machines_dir().glob("*.toml") if path.stem.startswith(begun))
    return [CompletionItem(name) for name in names] or [CompletionItem(begun, type="file")]


def _effects(ctx: click.Context, param: click.Parameter, begun: str) -> list[CompletionItem]:
    from sgms_mhe.model.effects import effect_definition, effect_names

    names = [name for name in effect_names() if name.startswith(begun)]
    return [CompletionItem(name, help=effect_definition(name).summary) for name in names]


def _causes(ctx: click.Context, param: click.Parameter, begun: str) -> list[CompletionItem]:
    from sgms_mhe.model.effects import cause, cause_names

    names = [name for name in cause_names() if name.startswith(begun)]
    return [CompletionItem(name, help=cause(name).summary) for name in names]


COMPLETIONS: Final[Mapping[str, Callable[[click.Context, click.Parameter, str], list[CompletionItem]]]] = {
    "machine": _machines,
    "like": _machines,
    "name": _effects,
    "separate": _causes,
}
"""By parameter."""
