"""Content of diagnosis.json."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from sgms_mhe.machine import Machine
from sgms_mhe.support.json_values import finite
from sgms_mhe.support.statements import Statement, list_open

_UNKNOWN: Final[Mapping[str, Any]] = {
    "causes": [],
    "alternatives": [],
    "separating_experiment": None,
    "residual_rms_N": dict.fromkeys(("before", "after", "held_out_before", "held_out_after", "noise_floor")),
    "plain": None,
    "simulation_error": {},
    "refuted": [],
    "records": [],
    "written": [],
    "extended_machine": None,
    "learned": None,
    "law": None,
    "structure_left": [],
    "base": [],
    "limits": [],
    "warnings": [],
}


def make_document(machine: Machine, verdict: str, statements: Sequence[Statement], **known: Any) -> dict[str, Any]:
    """Content of diagnosis.json, keys in the units of the machine's axis; a missing argument is unknown."""
    content = {
        "verdict": verdict,
        "summary": statements[0].sentence,
        "statements": [statement.to_json() for statement in statements],
        **_UNKNOWN,
        "limits": [statement.sentence for statement in list_open(statements)],
        **known,
    }
    keyed: dict[str, Any] = finite(machine.plant.units.keyed(content))
    return keyed
