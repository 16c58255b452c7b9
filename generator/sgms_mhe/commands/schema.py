"""`sgms-mhe schema`."""

from __future__ import annotations

import click

from sgms_mhe.commands.common import example, json_text, note_broken_effects, show


@click.command(short_help="JSON Schema of a machine file.", epilog=example("schema > machine.schema.json"))
def command() -> None:
    """Print the JSON Schema of a machine file: every key with unit, range and default, every effect by name."""
    from sgms_mhe.configuration import machine_schema

    note_broken_effects()
    show(json_text(machine_schema()))
