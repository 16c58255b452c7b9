"""`sgms-mhe schema`."""

from __future__ import annotations

from sgms_mhe.commands.common import json_text, note_broken_effects, show
from sgms_mhe.commands.options import make_command


@make_command("schema > machine.schema.json")
def command() -> None:
    """Print the JSON Schema of a machine file.

    It holds every key with unit, range and default, and every effect by name.
    """
    from sgms_mhe.configuration import machine_schema

    note_broken_effects()
    show(json_text(machine_schema()))
