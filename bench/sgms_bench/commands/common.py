"""Options that commands of the workbench share."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from typing import Any, TypeVar

import click

F = TypeVar("F", bound=Callable[..., Any])


def flags_option(default: str) -> Callable[[F], F]:
    """The option --cflags: words as a shell splits them, None where it is not given."""
    return click.option("--cflags", callback=_words, metavar="FLAGS", help=f"Compiler flags; default {default}.")


def _words(ctx: click.Context, param: click.Parameter, text: str | None) -> tuple[str, ...] | None:
    try:
        return None if text is None else tuple(shlex.split(text))
    except ValueError as error:
        raise click.BadParameter(f"{text!r}: {str(error).lower()}.", ctx, param) from None
