"""`sgms-mhe tune`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from sgms_mhe.commands import common
from sgms_mhe.commands.options import make_command
from sgms_mhe.support.options import Option

if TYPE_CHECKING:
    from sgms_mhe.evaluation.tuning import Tuned
    from sgms_mhe.machine import Machine


@make_command("tune etel_xy log.csv --out tuned.toml", of="tuning.tune")
def command(
    machine: Machine,
    log: Path,
    *,
    out: Annotated[Path | None, Option("MACHINE.toml")] = None,
    objective: Literal["force", "motion", "both"] = "force",
    standalone: bool = False,
    json: bool = False,
) -> None:
    """Noise weights and horizon from a log.

    Those are written under which LOG is likeliest. The innovations are then as large as the estimator says they are:
    the mean test ratio is near 1. Weights the log cannot distinguish from the file's stay as they are. Standard
    deviations at the start (parameter, initial_state) are the user's and stay.

    Args:
        out: a machine file that extends MACHINE by the weights.
    """
    if out is not None:
        common.check_output_file(out, (".toml",))

    from sgms_mhe.api import tuning
    from sgms_mhe.support.files import write_text

    with common.step_notes() as progress:
        tuned = tuning.tune(machine, log, objective=objective, note=common.note, progress=progress)
    if out is not None:
        write_text(out, _toml(tuned, out, log.name, standalone))
    outputs = [] if out is None else [out]
    lines = [*(statement.line for statement in tuned.statements), *(f"written: {path}" for path in outputs)]
    common.show(common.json_text(_content(tuned)) if json else "\n".join(lines), *outputs)


def _content(tuned: Tuned) -> dict[str, Any]:
    return {
        "machine": tuned.machine.name,
        "changes": tuned.changes(),
        "loss": {"before": tuned.start.mean, "after": tuned.best.mean},
        "test_ratio": {"before": tuned.start.ratio, "after": tuned.best.ratio},
        "better_by_sigmas": tuned.best.better_by(tuned.start) if tuned.best.changes else 0.0,
        "kept": list(tuned.kept),
        "statements": [statement.to_json() for statement in tuned.statements],
    }


def _toml(tuned: Tuned, path: Path, log: str, alone: bool) -> str:
    """Return a machine file with the weights alone, or with every table."""
    from sgms_mhe.configuration import override_machine
    from sgms_mhe.machine.writing import toml_extends, toml_line, toml_machine, toml_tables, wrap_comment

    head = [f"# Weights by sgms-mhe tune over {log}."]
    head += [line for statement in tuned.statements for line in wrap_comment(statement.line)]
    if alone:
        changed = override_machine(tuned.machine, {"name": path.stem, **tuned.changes()})
        return "\n".join([*head, *toml_machine(changed.content)]) + "\n"
    changes = toml_tables("estimator", tuned.changes().get("estimator", {}))
    lines = [*head, *toml_extends(tuned.machine, path.parent), toml_line("name", path.stem), *changes]
    return "\n".join(lines) + "\n"
