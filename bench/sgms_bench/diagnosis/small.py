"""How small a cause may be: each one hidden alone, in sizes that are asked for, on both laws of friction."""

import json
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from sgms_bench.diagnosis.axes import LAWS, PlantLaw
from sgms_bench.diagnosis.draws import Draw, sized_draw
from sgms_bench.diagnosis.running import (
    LIMIT_S,
    RESULT,
    RESULTS,
    Progress,
    diagnose_draw,
    digest_of,
    kept_result,
    plain_json,
    read_result,
)
from sgms_bench.diagnosis.scoring import FOUND, SIGMAS, ScoredDiagnosis, Share, outcome, parameter_errors
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import CAUSE_NAMES
from sgms_mhe.support.files import write_text
from sgms_mhe.support.kept import run_kept
from sgms_mhe.support.processes import Task, WorkerSlot
from sgms_mhe.support.tables import CsvTable

WRONG: Final = ("misnamed", "extra")


@dataclass(frozen=True)
class Cell:
    """One log: a cause, its size (peak force over the Coulomb level), the law that the simulated axis obeys."""

    index: int
    name: str
    size: float
    obeys: PlantLaw


@dataclass(frozen=True)
class Covered:
    """A number `name` (cause.parameter): share of logs inside its stated 95 % interval, RMS and largest error / std."""

    name: str
    share: Share
    rms: float
    largest: float


def cells(sizes: Sequence[float], draws: int) -> list[Cell]:
    """As many logs, every cause in every size on either law once before any comes again."""
    turn = [(name, size, law) for size in sizes for law in LAWS for name in CAUSE_NAMES]
    return [Cell(index, *turn[index % len(turn)]) for index in range(draws)]


def run_cell(machine: Machine, seed: int, cell: Cell) -> tuple[Draw, ScoredDiagnosis] | None:
    """Hide the cause, diagnose the log; None where no log shows a cause of that size."""
    draw = sized_draw(machine, seed, cell.index, cell.name, cell.size, cell.obeys)
    return None if draw is None else (draw, diagnose_draw(machine, draw))


def run_small(
    machine: Machine,
    out: str | Path,
    sizes: Sequence[float],
    *,
    draws: int,
    seed: int = 1,
    jobs: int = 2,
    progress: Progress | None = None,
) -> tuple[CsvTable, CsvTable]:
    """Run every cell; results are kept in the folder as they come. Tables of what was found, and of intervals.

    Args:
        machine: whose axis is simulated and whose file is diagnosed.
        out: folder; results that it holds are not computed again.
        sizes: of the causes, peak force over the Coulomb level.
        draws: logs in all.
        seed: of everything.
        jobs: processes; 1 runs here.
        progress: called with (logs done, logs in all).
    """
    folder, chosen = Path(out), cells(sizes, draws)
    digest = digest_of(machine, seed)
    keys = {f"{cell.name}-{cell.size:g}-{cell.obeys}-{cell.index}-{digest}": cell for cell in chosen}
    tasks = [Task(key, _kept, (machine, seed, cell)) for key, cell in keys.items()]
    said: list[tuple[Cell, tuple[Draw, ScoredDiagnosis] | None, str]] = []
    for result in run_kept(tasks, folder / RESULTS, WorkerSlot(jobs if jobs > 1 else 0, limit_s=LIMIT_S)):
        said.append((keys[result.task.key], None if result.failure else _read(result.value), result.failure))
        if progress is not None:
            progress(len(said), len(keys))
    logs = [(cell, *had) for cell, had, _ in said if had is not None]
    failed = sum(bool(failure) for _, _, failure in said)
    tables = _found(machine, sizes, logs, failed), _intervals(machine, [(draw, found) for _, draw, found in logs])
    write_text(folder / "small.txt", "".join(f"{table}\n" for table in tables))
    return tables


def covered_shares(machine: Machine, results: Iterable[tuple[Draw, ScoredDiagnosis]]) -> list[Covered]:
    """How often each number of a cause that was found is inside its stated interval, the least covered first."""
    errors: dict[str, list[float]] = {}
    for draw, found in results:
        if outcome(draw, found) in FOUND:
            for e in parameter_errors(machine, draw, found):
                if e.std > 0.0:
                    errors.setdefault(e.name, []).append(abs(e.error) / e.std)
    rows = [
        Covered(name, Share(sum(v <= SIGMAS for v in z), len(z)), math.sqrt(sum(v * v for v in z) / len(z)), max(z))
        for name, z in errors.items()
    ]
    return sorted(rows, key=lambda row: (row.share.value, row.name))


def _kept(machine: Machine, seed: int, cell: Cell) -> dict[str, bytes]:
    result = run_cell(machine, seed, cell)
    return {RESULT: json.dumps(plain_json(None)).encode()} if result is None else kept_result(*result)


def _read(folder: Path) -> tuple[Draw, ScoredDiagnosis] | None:
    return None if json.loads((folder / RESULT).read_bytes()) is None else read_result(folder)


def _found(
    machine: Machine, sizes: Sequence[float], logs: Sequence[tuple[Cell, Draw, ScoredDiagnosis]], failed: int
) -> CsvTable:
    how = {cell: outcome(draw, found) for cell, draw, found in logs}
    columns = {f"{size:.3g} {law}": (size, law) for law in LAWS for size in sizes}
    rows: list[dict[str, str]] = []
    for name in CAUSE_NAMES:
        row = {"cause": name}
        for column, (size, law) in columns.items():
            said = [h for cell, h in how.items() if (cell.name, cell.size, cell.obeys) == (name, size, law)]
            row[column] = _cell(said)
        called = Counter(
            other
            for cell, _, found in logs
            if cell.name == name and how[cell] in WRONG
            for other in found.names
            if other != name
        )
        row["called"] = ", ".join(f"{other} {count}" for other, count in called.most_common())
        rows.append(row)
    whole = {"cause": "all"}
    for column, (size, law) in columns.items():
        whole[column] = _cell([h for cell, h in how.items() if (cell.size, cell.obeys) == (size, law)])
    return CsvTable(
        f"One cause hidden in a log of {machine.name}: found of logs, sizes over f_C, by law of the axis",
        dict.fromkeys(("cause", *columns, "called"), ""),
        [*rows, whole],
        (
            "found: named, or ambiguous with it; !n: n logs with a name that is not there; -: no log shows that size",
            f"no diagnosis: {failed + sum(h == 'error' for h in how.values())}",
        ),
    )


def _cell(said: Sequence[str]) -> str:
    if not said:
        return "-"
    wrong = sum(h in WRONG for h in said)
    return f"{sum(h in FOUND for h in said)}/{len(said)}" + (f" !{wrong}" if wrong else "")


def _intervals(machine: Machine, logs: Iterable[tuple[Draw, ScoredDiagnosis]]) -> CsvTable:
    rows = covered_shares(machine, logs)
    total = Share(sum(r.share.hits for r in rows), sum(r.share.total for r in rows))
    low, high = total.interval
    return CsvTable(
        "Numbers inside their stated 95 % intervals, of causes that were found",
        {"number": "", "inside": "d", "of": "d", "RMS error / std": ".2f", "largest": ".1f"},
        [
            {
                "number": r.name,
                "inside": r.share.hits,
                "of": r.share.total,
                "RMS error / std": r.rms,
                "largest": r.largest,
            }
            for r in rows
        ],
        (f"all: {total.hits} of {total.total}, {total.value:.1%} ({low:.0%} to {high:.0%})",),
    )
