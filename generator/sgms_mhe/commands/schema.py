"""`sgms-mhe schema`."""

from __future__ import annotations

import click

from sgms_mhe.commands.common import example, json_text, show


@click.command(short_help="JSON Schema of a machine file.", epilog=example("schema > machine.schema.json"))
def command() -> None:
    """Print the JSON Schema of a machine file: every key with unit, range and default."""
    from sgms_mhe.machine import json_schema

    show(json_text(json_schema()))
