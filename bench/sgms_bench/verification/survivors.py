"""Mutants of emitted C that no judge notices and none has to, each with the reason why."""

from typing import Final

from sgms_bench.verification.gaps import GUARD, NO_MODEL, NO_NUMBER, NUMBERS, Gap
from sgms_bench.verification.mutants import Mutant

WHEN: Final = "says when work is done, not what comes out; stated work is held by tests/test_stated_work.py"
DAMAGED: Final = "a bound that damaged memory alone goes beyond; the proof in bench/c/proof.c holds it"
OVERWRITTEN: Final = "written once more before it is read, or never read in this package"
EQUAL: Final = "another branch where two numbers are equal, and both come to the same there"
ROUNDING: Final = "a bound on rounding errors: a release within it changes nothing"
PATH: Final = "another way to the one place that is best; the number of steps has a bound of its own"
SMALL: Final = "a number that no sum with another one keeps"
SHORT: Final = "a way round work that changes nothing: the long way comes to the same"
OTHER_TASK: Final = "another task comes in between two instructions; tests/test_tasks.py lets it"
ZERO: Final = "a term that is zero, or a factor that is one, in this package"
PADDING: Final = "lanes of a vector that hold copies where one interval is integrated at a time"
SUM: Final = "another sum of bits that tells as much of them"
FINITE: Final = "a derivative is finite where the number itself is"
IN_USE: Final = "parameters in use are those of the last estimate, but for the end of an update"
HEALED: Final = "zeros that are there, and put back once memory has been damaged"
REFUSED: Final = "a status that refuses is a small negative number, which has the bit of each flag too"
UNREAD: Final = "a signal that no effect of this package reads"

SURVIVORS: Final[tuple[Gap, ...]] = (
    Gap(r"next_cost|workload_of|units_done", r"", WHEN),
    Gap(r"update", r"next_cost\(self\) > 0", WHEN),
    Gap(r"NAME_tick", r"self->input\.count > 0|left -= |cost <= left", WHEN),
    Gap(r"sgms_place", r"most \?", DAMAGED),
    Gap(r"\w+", r"sgms_place\(.*: (?:- -> \+|1 -> 0|\+ -> -)$", DAMAGED),
    Gap(r"start_fresh|start_window|start_signals|start_with", r"fill\(|side = 0|version = 0|counts", OVERWRITTEN),
    Gap(r"start_fresh", r"i < SLOTS", OVERWRITTEN),
    Gap(r"fold_interval", r"fill\(rows", OVERWRITTEN),
    Gap(r"linearise_step|start_row", r"\{ 0 \}", OVERWRITTEN),
    Gap(r"course_ahead", r"c\.duration\[0\] : 0\.0;: 0\.0f? -> 1\.0f?$", OVERWRITTEN),
    Gap(r"sgms_filter_disturbed", r"counts\[1\] = 0|SGMS_POSITION\) != 0", OVERWRITTEN),
    Gap(r"sgms_filter_step", r"\(wanted & SGMS_POSITION\) != 0", OVERWRITTEN),
    Gap(r"sgms_variances", r"variance\[c\] \+= ", OVERWRITTEN),
    Gap(r"sgms_flow_place_of_s", r"< -> <=$", EQUAL),
    Gap(r"sgms_exp", r"SGMS_EXP_HIGHEST.*: > -> >=$", EQUAL),
    Gap(r"GROUP_ahead_slow", r"substeps > 1", EQUAL),
    Gap(r"take_sample", r"MAX_VELOCITY\) \{: > -> >=$", EQUAL),
    Gap(r"sgms_metres_between", r"may_overflow = .*< -> <=$", EQUAL),
    Gap(r"sgms_box_least_squares", r"rounding \*/: [<>] -> [<>]=$", EQUAL),
    Gap(r"GROUP_line_of", r"sgms_copy_sign\(1\.0, .*: \* -> /$", EQUAL),
    Gap(r"sgms_flow_\w+", r"^(?:d_\w+|slope) = \w+ \* \w+ \+ \w+;: \* -> /$", ZERO),
    Gap(r"sgms_box_least_squares", r"blocking = move.*< -> <=$", EQUAL),
    Gap(r"sgms_box_least_squares", r"size \+= |SGMS_ROUNDING", ROUNDING),
    Gap(r"sgms_box_least_squares", r"step = |iteration|c = free_count - 1", PATH),
    Gap(r"sgms_filter_step", r"m->counts\[[01]\] == [03] &&", SHORT),
    Gap(r"sgms_box_least_squares", r"active == 0", SHORT),
    Gap(r"sgms_box_least_squares", r"^x\[i\] \+= step .*-> x\[i\] = x\[i\] < lower", ROUNDING),
    Gap(r"restore_factor", r"fill\(factor", HEALED),
    Gap(r"GROUP_flow_tile", r"any_slow != 0", SHORT),
    Gap(r"sgms_qr_grow", r"by == .*-> \(0\)$", SHORT),
    Gap(r"is_unsound", r"status < 0 .*: status -> \w+$", REFUSED),
    Gap(r"start_sweep", r"sweep\.back == 0.*: back -> cursor$", EQUAL),
    Gap(r"GROUP_step|GROUP_take_kinds", r"any_more|is_cut = 1", SHORT),
    Gap(r"GROUP_runge_kutta_line", r"substeps == 1", SHORT),
    Gap(r"take_inner", r"valid > 0\.0.*: > -> >=$", SHORT),
    Gap(r"NAME_save|NAME_estimate", r"attempt", OTHER_TASK),
    Gap(r"start_with", r"^abort_call\(self\);: .*-> ;$", OTHER_TASK),
    Gap(r"sgms_has_ieee_numbers", r"", NUMBERS),
    Gap(r"start_with", r"newest_slot\(self\) \* STATES", ZERO),
    Gap(r"take_newest", r"slot \* STATES;", ZERO),
    Gap(r"inner_row", r"row\[couples.*: \+= -> =$", ZERO),
    Gap(r"GROUP_wanted", r"GROUP_AT_REST \* LANE_STRIDE\]", ZERO),
    Gap(r"moved_most", r"COUPLED \+ k\].*: \+ -> -$", ZERO),
    Gap(r"lane_end|GROUP_end", r"\bblock \* |d_scale|k < GROUP_STATES|/ p->scale\[from\]", ZERO),
    Gap(r"all_finite", r"\* 0\.0", ZERO),
    Gap(r"specimen_levels_integrator\.h: GROUP_runge_kutta", r"\b(?:block|slope|sum|y|k)\[(?:6|8|9|10|13|14)\b", ZERO),
    Gap(r"drop_rest", r"&self->chain\.last\[1\], 1\)", SMALL),
    Gap(r"GROUP_runge_kutta(?:_line)?", r"LANE_STRIDE \+ l.*: \+ -> -$", PADDING),
    Gap(r"GROUP_step", r"l < lanes", PADDING),
    Gap(r"is_model", r"d_q", FINITE),
    Gap(r"add_bits", r"31u \* sum", SUM),
    Gap(r"sum_of|sum_of_lasting", r"add_bits\(.*-> sum = add_bits\(", SUM),
    Gap(r"\w+", r"^(?!copy\().*theta.*: (?:parameters -> estimate|estimate -> parameters)$", IN_USE),
    Gap(r"\w+", r"^SGMS_FENCE\(\);: SGMS_FENCE\(\); -> ;$", OTHER_TASK),
    Gap(r"NAME_tick", r"phase == IDLE\) .*-> \(0\)$|is_complete\(self\)\) .*-> \(1\)$", WHEN),
    Gap(r"take_sample", r"drop_rest\(self\);|age % 128u", SMALL),
    Gap(r"start_with|start_again", r"window\.friction\[0\] = 0", OVERWRITTEN),
    Gap(r"start_sweep", r"older_intervals\(self\) > 0\) .*-> \(1\)$", OVERWRITTEN),
    Gap(r"start_interval", r"fill\(self->input\.merged", OVERWRITTEN),
    Gap(r"start_lasting", r"fill\(self->lasting\.theta", OVERWRITTEN),
    Gap(r"start_signals", r"chain\.position\[[01]\] = 0", OVERWRITTEN),
    Gap(r"sgms_filter_disturbed", r"counts\[2\] = 0;: .*-> ;$", OVERWRITTEN),
    Gap(r"start_with", r"is_plausible\(end\)", NO_NUMBER),
    Gap(r"update", r"^friction = output_at\(.*-> numeric = all_finite\(&friction", NO_NUMBER),
    Gap(r"is_model|NAME_set_parameter", r"^parameter_terms\(&at\);: .*-> ;$|!is_model\(", NO_MODEL),
    Gap(r"node_row", r"theta\[p\];: \* -> /$", ZERO),
    Gap(r"friction_ahead", r"is_finite\(friction\) \? friction", NO_NUMBER),
    Gap(r"friction_ahead", r"^w\[W_(?:ACCELERATION|FORCE|POSITION|TIME)\]", UNREAD),
    Gap(r"take_colour", r"block\[2\] > 0\.0", GUARD),
)
"""All of them. A mutant that is noticed needs no reason, even where one of these would fit it."""


def is_explained(mutant: Mutant) -> bool:
    """Return True if an entry of the list is about a mutant: its function, its line and what has become of what.

    An entry may begin with a file, whose numbers are those of one package.
    """
    names = mutant.function, f"{mutant.file}: {mutant.function}"
    return any(survivor.explains(name, mutant.change) for survivor in SURVIVORS for name in names)
