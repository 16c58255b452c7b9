"""How often a diagnosis is right: causes hidden in simulated logs, and what it makes of them."""

from __future__ import annotations

from sgms_bench.diagnosis.causes import Hidden
from sgms_bench.diagnosis.draws import Draw, machine_of, make_draw, simulate_draw
from sgms_bench.diagnosis.planned import run_planned
from sgms_bench.diagnosis.running import run_diagnosis_benchmark, run_draw
from sgms_bench.diagnosis.scoring import Found, Summary, outcome, summarise, summary_json, summary_text
from sgms_bench.diagnosis.small import run_small

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
