"""Measured records of a table: ours beside the published numbers and plain friction.

`python -m sgms_bench.measured FOLDER --table FILE`
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from sgms_bench.measured.motions import MotionOutcome, run_motion, table_of_motions
from sgms_bench.measured.running import MeasuredTally, run_table
from sgms_bench.measured.table import MeasuredTable, read_table
from sgms_mhe.support.errors import InputError


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the records and print the table; 2 where it cannot be read."""
    parser = argparse.ArgumentParser(prog="python -m sgms_bench.measured", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path, help="folder that the records are in")
    parser.add_argument(
        "--table", type=Path, help="TOML file of records; default: measured.toml in the folder, or ours"
    )
    parser.add_argument("--only", help="records whose name holds this")
    parser.add_argument("--halves", action="store_true", help="diagnose the compared stretch too, and compare numbers")
    chosen = parser.parse_args(arguments)
    tally = MeasuredTally()
    motions: list[MotionOutcome] = []

    def tell(sentence: str) -> None:
        sys.stderr.write(f"{sentence}\n")
        sys.stderr.flush()

    try:
        table = read_table(chosen.data, chosen.table)
        for name in table.absent:
            tell(f"{name}: left out, {chosen.data} does not have its file")
        records = tuple(record for record in table.records if chosen.only is None or chosen.only in record.name)
        for outcome in run_table(MeasuredTable(records, table.folder), halves=chosen.halves):
            tally.add(outcome, tell)
        for motion in table.motions:
            if chosen.only is None or chosen.only in motion.name:
                motions.append(run_motion(table, motion, tell))
                tell(f"{motion.name}: {motions[-1].ours:.4g} {motions[-1].unit} ({motions[-1].seconds:.0f} s)")
    except InputError as error:
        tell(f"error: {error}")
        return 2
    tables = tally.tables() if tally.outcomes else []
    for shown in [*tables, *(table_of_motions(motions) if motions else [])]:
        sys.stdout.write(f"{shown}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
