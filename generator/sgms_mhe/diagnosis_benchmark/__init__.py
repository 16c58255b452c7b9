"""How often a diagnosis is right: causes hidden in simulated logs, and what it makes of them."""

from __future__ import annotations

from sgms_mhe.diagnosis_benchmark.causes import Hidden
from sgms_mhe.diagnosis_benchmark.draws import Draw, machine_of, make_draw, simulate_draw
from sgms_mhe.diagnosis_benchmark.planned import run_planned
from sgms_mhe.diagnosis_benchmark.running import run_diagnosis_benchmark, run_draw
from sgms_mhe.diagnosis_benchmark.scoring import Found, Summary, outcome, summarise, summary_json, summary_text
from sgms_mhe.diagnosis_benchmark.small import run_small

__all__ = [
    "Draw",
    "Found",
    "Hidden",
    "Summary",
    "machine_of",
    "make_draw",
    "outcome",
    "run_diagnosis_benchmark",
    "run_draw",
    "run_planned",
    "run_small",
    "simulate_draw",
    "summarise",
    "summary_json",
    "summary_text",
]
