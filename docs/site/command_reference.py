"""Pages of the commands with every option, from the command line's own objects."""

from __future__ import annotations

import re
from inspect import cleandoc

import click

from markup import split, table
from sgms_mhe.cli import cli, command_names

HEAD = """# Commands, every option

One page per command, made from the command line itself: the output of `sgms-mhe COMMAND --help`. The purpose of each
command, and the meaning of its results, are in [commands](../docs/commands.md).

`-q`, `--quiet` before a command: results and errors alone. Exit codes: 0 done, 1 done and the answer is no, 2 bad
input."""


def pages() -> dict[str, str]:
    """Return the Markdown of an overview and of every command, by address, in the order of --help."""
    context = click.Context(cli, info_name="sgms-mhe")
    found = [(name, cli.get_command(context, name)) for name in command_names()]
    rows = [(name, _page(name, one, context), one.get_short_help_str(200)) for name, one in found if one is not None]
    return split("reference/commands.md", HEAD, ["command", "summary"], rows)


def _page(name: str, command: click.Command, parent: click.Context) -> str:
    context = click.Context(command, info_name=name, parent=parent, max_content_width=10_000)
    usage = command.get_usage(context).removeprefix("Usage: ")
    # \b keeps the lines of a paragraph of help as they are.
    paragraphs = cleandoc(command.help or "").split("\n\n")
    text = [f"```\n{part[2:].lstrip()}\n```" if part.startswith("\b") else part for part in paragraphs]
    records = [record for p in command.params if (record := p.get_help_record(context)) is not None]
    rows = [[f"`{option}`", meaning] for option, meaning in records if meaning]
    epilog = (command.epilog or "").removeprefix("\b\nExample:\n")
    examples = re.sub(r"^  ", "", epilog, flags=re.MULTILINE)
    parts = [f"# {name}", f"```sh\n{usage}\n```", *text]
    parts += [table(["option", "meaning"], rows)] if rows else []
    return "\n\n".join([*parts, f"```sh\n{examples}\n```"])
