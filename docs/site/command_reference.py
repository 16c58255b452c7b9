"""The page of all commands with every option, from the command line's own objects."""

from __future__ import annotations

import re
from inspect import cleandoc

import click

from markup import table
from sgms_mhe.cli import cli, command_names

HEAD = """# Commands, every option

Made from the command line itself: what `sgms-mhe COMMAND --help` says. What each command is for, and how its results
read, is on [its page](../docs/commands.md).

`-q`, `--quiet` before a command: results and errors alone. Exit codes: 0 done, 1 done and the answer is no, 2 bad
input."""


def page() -> str:
    """Markdown of all commands, in the order of --help."""
    context = click.Context(cli, info_name="sgms-mhe")
    found = ((name, cli.get_command(context, name)) for name in command_names())
    return "\n\n".join([HEAD, *(_section(name, command, context) for name, command in found if command is not None)])


def _section(name: str, command: click.Command, parent: click.Context) -> str:
    context = click.Context(command, info_name=name, parent=parent, max_content_width=10_000)
    usage = command.get_usage(context).removeprefix("Usage: ")
    # \b keeps the lines of a paragraph of help as they are.
    paragraphs = cleandoc(command.help or "").split("\n\n")
    text = [f"```\n{part[2:].lstrip()}\n```" if part.startswith("\b") else part for part in paragraphs]
    records = [record for p in command.params if (record := p.get_help_record(context)) is not None]
    rows = [[f"`{option}`", meaning] for option, meaning in records if meaning]
    epilog = (command.epilog or "").removeprefix("\b\nExample:\n")
    examples = re.sub(r"^  ", "", epilog, flags=re.MULTILINE)
    parts = [f"## {name}", f"```sh\n{usage}\n```", *text]
    parts += [table(["option", "meaning"], rows)] if rows else []
    return "\n\n".join([*parts, f"```sh\n{examples}\n```"])
