"""Files of a diagnosis: diagnosis.json and the extended machine."""

import json
from pathlib import Path
from typing import Any

from sgms_mhe.diagnosis.document import make_document
from sgms_mhe.diagnosis.result import Diagnosis
from sgms_mhe.machine import Machine
from sgms_mhe.support.files import write_text
from sgms_mhe.support.statements import Rule, Statement


def write_diagnosis(diagnosis: Diagnosis, out_dir: str | Path) -> Path:
    """Write diagnosis.json and, where there is one, the extended machine's file; return the folder."""
    folder = Path(out_dir)
    folder.mkdir(parents=True, exist_ok=True)
    write_extended(diagnosis, folder)
    write_text(folder / "diagnosis.json", json.dumps(diagnosis.to_json(), indent=2) + "\n")
    return folder


def write_extended(diagnosis: Diagnosis, folder: Path) -> None:
    """Write the extended machine where a cause is named or something learned."""
    toml = diagnosis.extended_file(folder)
    if toml is not None:
        write_text(folder / f"{diagnosis.extended_name}", toml)


def write_refusal(sentence: str, machine: Machine, out_dir: str | Path) -> dict[str, Any]:
    """Write diagnosis.json of a log that contradicts its names, and nothing else; return its content."""
    refusal = Statement(Rule.REFUSED, "record", numbers={"reason": sentence})
    content = make_document(machine, "unexplained", [refusal], law=machine.friction.law, limits=[sentence])
    folder = Path(out_dir)
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / "diagnosis.json", json.dumps(content, indent=2) + "\n")
    return content
