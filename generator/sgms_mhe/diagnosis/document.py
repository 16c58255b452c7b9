"""Content of diagnosis.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from sgms_mhe.machine import Machine
from sgms_mhe.support.json_values import finite

_NO_ERRORS: Final[Mapping[str, float]] = {}
_NO_RMS: Final = dict.fromkeys(("before", "after", "held_out_before", "held_out_after", "noise_floor"))


def make_document(
    machine: Machine,
    verdict: str,
    summary: str,
    limits: Sequence[str],
    *,
    law: str,
    causes: Sequence[Mapping[str, Any]] = (),
    alternatives: Sequence[Mapping[str, Any]] = (),
    separating_experiment: str | None = None,
    residual_rms_N: Mapping[str, float | None] = _NO_RMS,
    plain: Mapping[str, float] | None = None,
    simulation_error: Mapping[str, float] = _NO_ERRORS,
    refuted: Sequence[Mapping[str, Any]] = (),
    records: Sequence[Mapping[str, Any]] = (),
    written: Sequence[Mapping[str, Any]] = (),
    extended_machine: str | None = None,
    learned: Mapping[str, Any] | None = None,
    structure_left: Sequence[Mapping[str, Any]] = (),
    base: Sequence[Mapping[str, Any]] = (),
    warnings: Sequence[str] = (),
) -> dict[str, Any]:
    """Content of diagnosis.json, keys in the units of the machine's axis; what is left out is not known."""
    content = {
        "verdict": verdict,
        "summary": summary,
        "causes": causes,
        "alternatives": alternatives,
        "separating_experiment": separating_experiment,
        "residual_rms_N": residual_rms_N,
        "plain": plain,
        "simulation_error": simulation_error,
        "refuted": refuted,
        "records": records,
        "written": written,
        "extended_machine": extended_machine,
        "learned": learned,
        "law": law,
        "structure_left": structure_left,
        "base": base,
        "limits": limits,
        "warnings": warnings,
    }
    keyed: dict[str, Any] = finite(machine.plant.units.keyed(content))
    return keyed
