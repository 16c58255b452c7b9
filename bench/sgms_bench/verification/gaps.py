"""Lines and branches that neither self-test nor exercise reach, each with the reason why that is as it should be."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Gap:
    """A line that is not reached, or not both ways.

    Attributes:
        function: regular expression of the function's whole name; the machine's name in it is NAME.
        code: regular expression found in the line.
        reason: why, and where it is held instead.
    """

    function: str
    code: str
    reason: str

    def explains(self, function: str, code: str) -> bool:
        """Return True if a line is this one."""
        return re.fullmatch(self.function, function) is not None and re.search(self.code, code) is not None


OVERLAPS: Final = "another task comes in between two instructions; tests/test_tasks.py lets it, at every function"
NO_NUMBER: Final = "the state is no number before anything else is; random calls come here"
GUARD: Final = "a guard against what those before it leave no room for"

DAMAGED: Final = "an index that damaged memory alone has out of its range; the proof in bench/c/proof.c holds it"
LASTING: Final = "an error of the model that stays for seconds; tests/test_lasting.py has them"
NUMBERS: Final = "numbers of IEEE 754 are here; tests/test_package.py has builds and processors without"
NO_MODEL: Final = "a level of zero where it has no bounds; tests/test_life.py sets it"

GAPS: Final[tuple[Gap, ...]] = (
    Gap("sgms_has_ieee_numbers", r"none|least|unit|rounds|whole", NUMBERS),
    Gap("start_fresh|NAME_check", r"sgms_has_ieee_numbers|NAME_ARITHMETIC", NUMBERS),
    Gap("NAME_status_text", r"NAME_ARITHMETIC|does not compute", NUMBERS),
    Gap("is_model", r"all_finite\(at\.q", NO_MODEL),
    Gap("NAME_set_parameter", r"!is_model\(whole\)|return NAME_REFUSED", NO_MODEL),
    Gap("abort_call", r"phase == ABORTED", OVERLAPS),
    Gap("NAME_prepare", r"self->calls\.phase (?:!= IDLE|== PREPARING)", OVERLAPS),
    Gap("NAME_feedback", r"phase != INVALID|return NAME_OVERLAP|phase == INVALID|: update\(self\)", OVERLAPS),
    Gap("NAME_estimate", r"attempt < 3|version % 2u == 0u|NAME_OVERLAP", OVERLAPS),
    Gap("NAME_save", r"attempt < 3|version % 2u == 0u|NAME_OVERLAP|~checksum_of", OVERLAPS),
    Gap("start_with", r"is_plausible\(end\)", NO_NUMBER),
    Gap("NAME_status_text", r"OVERLAP|overlapped", OVERLAPS),
    Gap("update", r"all_finite\(&friction|return start_again", NO_NUMBER),
    Gap("sgms_flow_enter", r"elastic > flow_table.start|\*r = elastic|return 0", GUARD),
    Gap("sgms_flow_step", r"move.r >= flow_table.end", GUARD),
    Gap("sgms_filter_disturbed", r"counts\[0\] != 3|counts\[2\] < chain->settle|valid = 1", GUARD),
    Gap("sgms_qr", r"c < rows", GUARD),
    Gap("take_wander", r"is_end && is_known", GUARD),
    Gap("sgms_exp", r"SGMS_EXP_HIGHEST", GUARD),
    Gap("GROUP_line_count", r"\(sgms_real\)whole == wanted", "a whole number of substeps, by chance alone"),
    Gap("take_colour", r"block\[2\] > 0\.0", GUARD),
    Gap("is_doubted", r"spread > DOUBTED_SPREAD", LASTING),
    Gap(
        "is_whole", r"saved->spread\[p\] >= 1\.0", "saved data that were never saved, with their checksum; random calls"
    ),
    Gap("next_inner|next_cost", r"self->inner\.folded < INNER", DAMAGED),
    Gap("units_done", r"self->sweep\.cursor < most", DAMAGED),
    Gap("NAME_due", r"self->interval\.step < 0", DAMAGED),
    Gap("start_sweep|workload_of", r"self->linearisation\.slot < SLOTS", DAMAGED),
    Gap("sgms_place", r"value <= most", DAMAGED),
    Gap("take_signals", r"self->input\.elapsed < INT64_MAX", "a counter that ends after millions of years"),
)
"""All of them: one that is missing, and one that no package has any more, fails the verification."""
