"""Drawn logs in every format with every fault: what came of each, right or wrong.

`python -m sgms_bench.logs --draws 200`
"""

import argparse
import sys
from collections.abc import Sequence
from typing import Final

from sgms_bench.logs.running import Outcome, run_draws, tables

LEAST_RIGHT: Final = 0.95


def main(arguments: Sequence[str] | None = None) -> int:
    """Run draws and print the tables; 1 where too much is wrong, or one sentence false."""
    parser = argparse.ArgumentParser(prog="python -m sgms_bench.logs", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--draws", type=int, default=200, help="logs")
    parser.add_argument("--seed", type=int, default=0, help="of the first")
    chosen = parser.parse_args(arguments)

    def progress(outcome: Outcome) -> None:
        if outcome.came != "right":
            sys.stderr.write(f"seed {outcome.seed}, {outcome.format}, {outcome.fault}: {outcome.came}: ")
            sys.stderr.write(f"{outcome.reason}\n")
            sys.stderr.flush()

    outcomes = run_draws(range(chosen.seed, chosen.seed + chosen.draws), progress)
    for table in tables(outcomes):
        sys.stdout.write(f"{table}\n")
    right = sum(outcome.came == "right" for outcome in outcomes)
    sound = all(outcome.came in ("right", "wrong") for outcome in outcomes)
    return int(not sound or right < LEAST_RIGHT * len(outcomes))


if __name__ == "__main__":
    raise SystemExit(main())
