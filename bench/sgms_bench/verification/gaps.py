"""Lines and branches that neither self-test nor exercise reach, each with the reason why that is as it should be."""

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
NUMBERS: Final = "numbers of IEEE 754 are here; tests/test_package.py has builds and processors without"
NO_MODEL: Final = "a level of zero, which its bounds leave out: packages without them are asked for one"

GAPS: Final[tuple[Gap, ...]] = (
    Gap("sgms_has_ieee_numbers", r"none|least|unit|rounds|whole", NUMBERS),
    Gap("NAME_set_parameter", r"!is_model\(whole\)|return NAME_REFUSED", NO_MODEL),
    Gap("NAME_prepare", r"self->calls\.phase (?:!= IDLE|== PREPARING)", OVERLAPS),
    Gap("NAME_estimate", r"attempt < 3|version % 2u == 0u|NAME_OVERLAP", OVERLAPS),
    Gap("NAME_save", r"attempt < 3|version % 2u == 0u|NAME_OVERLAP|~checksum_of", OVERLAPS),
    Gap("start_with", r"is_plausible\(end\)", NO_NUMBER),
    Gap("update", r"all_finite\(&friction|return start_again", NO_NUMBER),
    Gap("sgms_exp", r"SGMS_EXP_HIGHEST", GUARD),
    Gap("start_sweep|workload_of", r"self->linearisation\.slot < SLOTS", DAMAGED),
    Gap(
        "output_force",
        r"\(sgms_real\)\(a\d+ <= 0\.0\)",
        "travel since a reversal is within its grid: no state is below it",
    ),
    Gap("take_signals", r"self->input\.elapsed < INT64_MAX", "a counter that ends after millions of years"),
)
"""All of them: one that is missing, and one that no package has any more, fails the verification."""
