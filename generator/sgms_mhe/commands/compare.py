"""`sgms-mhe compare`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sgms_mhe.commands import common
from sgms_mhe.commands.options import make_command

if TYPE_CHECKING:
    from sgms_mhe.evaluation.comparison import Comparison
    from sgms_mhe.machine import Machine


@make_command("compare etel_xy axis.csv")
def command(machine: Machine, log: Path, *, json: bool = False) -> bool:
    """Compare the generated C with the reference solver.

    Both run on the same signals, and are compared update by update.

    Differences are relative: of friction and deflections to their range, of parameters and standard deviations to the
    reference's value. Double precision may differ by 1e-8 throughout. Single precision may differ by 1e-4 of the
    friction's range, 1e-3 of the deflections', 1e-3 of each parameter and 1e-2 of its standard deviation at the
    updates where it is excited (standard deviation below 90 % of the prior's). The status is to be the same but for
    flags whose number lies on its limit.

    Exit code 1 where the two are further apart.
    """
    from sgms_mhe.api.estimation import check_length
    from sgms_mhe.evaluation.comparison import compare_signals
    from sgms_mhe.signals.chain import signals_from_log

    recorded = common.recorded_log(log, machine, driven=True)
    check_length(len(recorded), recorded.source, machine)
    with common.progress_bar(f"compare {machine.name}") as progress:
        comparison = compare_signals(machine, signals_from_log(recorded, machine), progress=progress)
    common.show(common.json_text(_content(comparison)) if json else _text(comparison))
    return not comparison.agrees


def _content(comparison: Comparison) -> dict[str, Any]:
    content = {"agrees": comparison.agrees} | asdict(comparison)
    for entry, quantity in zip(content["quantities"], comparison.quantities, strict=True):
        entry["agrees"] = quantity.agrees
    content["bounds_active"] = dict(zip(("c", "reference"), comparison.bounds_active, strict=True))
    return content


def _text(comparison: Comparison) -> str:
    rows = [
        (
            quantity.name,
            f"{quantity.difference:.2e}",
            f"{quantity.relative:.2e}",
            f"{quantity.tolerance:.0e}",
            str(quantity.updates),
            "" if quantity.agrees else "beyond",
        )
        for quantity in comparison.quantities
    ]
    verdict = "agree" if comparison.agrees else "are further apart than they may be"
    return "\n".join(
        [
            f"{comparison.machine}, {comparison.precision} precision: generated C against reference, "
            f"{comparison.updates} updates",
            common.table_text(("largest difference", "absolute", "relative", "allowed", "updates", ""), rows),
            f"status differs at {comparison.status_mismatches} updates, and at {comparison.status_undecided} where a "
            "number lies on its limit",
            "a bound is active at {} updates (C) and {} (reference)".format(*comparison.bounds_active),
            f"generated C and reference {verdict}",
        ]
    )
