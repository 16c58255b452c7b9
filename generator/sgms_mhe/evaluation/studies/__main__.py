"""Statistics of the estimator, from the command line: `python -m sgms_mhe.evaluation.studies NAME`.

`coverage` draws data from the estimator's own noise model, `plant` asks the same of the axis in closed loop,
`monte-carlo` compares MHE, EKF and batch smoother over random axes, `creep` follows the parameters over 10^5 updates,
`readings` asks what more friction readings per second gain, `relinearise` what it costs to keep linearisations,
`faults` puts broken sensors into good logs, `speed` asks what fast moves cost the integrators, `identify` draws axes
and identifies each from its log alone.
All numbers are seeded; the same command prints the same table.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Final

from sgms_mhe.evaluation.studies.coverage import coverage_study
from sgms_mhe.evaluation.studies.creep import creep_study
from sgms_mhe.evaluation.studies.faults import faults_study
from sgms_mhe.evaluation.studies.identification import identification_study
from sgms_mhe.evaluation.studies.monte_carlo import monte_carlo_study
from sgms_mhe.evaluation.studies.plant import plant_study
from sgms_mhe.evaluation.studies.readings import readings_study
from sgms_mhe.evaluation.studies.relinearise import relinearise_study
from sgms_mhe.evaluation.studies.speed import speed_study
from sgms_mhe.support.tables import Table

STUDIES: Final[Mapping[str, tuple[Callable[[int, int], Table], int, int]]] = {
    "coverage": (coverage_study, 900, 400),
    "monte-carlo": (lambda runs, updates: monte_carlo_study(runs, updates / 100.0), 100, 400),
    "plant": (lambda runs, updates: plant_study(runs, updates / 100.0), 20, 2000),
    "creep": (lambda runs, updates: creep_study(updates), 1, 100_000),
    "relinearise": (lambda runs, updates: relinearise_study(runs, updates / 100.0), 10, 800),
    "readings": (lambda runs, updates: readings_study(runs, updates / 100.0), 6, 2000),
    "faults": (lambda runs, updates: faults_study(runs), 20, 1800),
    "identify": (lambda runs, updates: identification_study(runs, updates / 100.0), 40, 2500),
    "speed": (lambda runs, updates: speed_study(updates), 1, 150),
}
"""Studies by name, with their numbers of runs and updates."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one study and print its table."""
    parser = argparse.ArgumentParser(prog="python -m sgms_mhe.evaluation.studies", description=__doc__.splitlines()[0])
    parser.add_argument("name", choices=[*STUDIES], help="which study")
    parser.add_argument("--runs", type=int, help="seeds or draws")
    parser.add_argument("--updates", type=int, help="updates per run (of 10 ms)")
    chosen = parser.parse_args(arguments)
    study, runs, updates = STUDIES[chosen.name]
    sys.stdout.write(f"{study(chosen.runs or runs, chosen.updates or updates)}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
