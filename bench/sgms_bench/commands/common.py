"""Options that commands of the workbench share."""

import shlex

import click


def split_flags(text: str | None) -> tuple[str, ...] | None:
    """Return the option --cflags as words, as a shell splits them; None where it is not given."""
    try:
        return None if text is None else tuple(shlex.split(text))
    except ValueError as error:
        raise click.BadParameter(f"{text!r}: {str(error).lower()}.", param_hint="'--cflags'") from None
