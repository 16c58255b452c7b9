"""Statistics of the estimator, from the command line: `python -m sgms_bench.studies NAME`.

`coverage` draws data from the estimator's own noise model, `plant` asks the same of the axis in closed loop,
`monte-carlo` compares MHE, EKF and batch smoother over random axes, `creep` follows the parameters over 10^5 updates,
`readings` asks what more friction measurements per second gain, `relinearise` what it costs to keep linearisations,
`faults` puts broken sensors into good logs, `lost` takes samples out of them, `lasting` gives the axis what its machine
file has not, `tracking` feeds friction forward on such an axis, `speed` asks what fast moves cost the integrators,
`identify` draws axes and identifies each from its log alone, `coarse` the same behind coarse encoders, with gravity, on
short moves. `others` takes joints of MuJoCo and of better-actuator-models as axes: identified, diagnosed, compensated.
`scaling` says what a task costs in 1 to 8 processes. All numbers are seeded; the same command prints the same table,
wherever it runs, but for times.
"""

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

from sgms_bench.studies.coarse import coarse_study
from sgms_bench.studies.coverage import coverage_study
from sgms_bench.studies.creep import creep_study
from sgms_bench.studies.faults import faults_study
from sgms_bench.studies.identification import identification_study
from sgms_bench.studies.lasting import lasting_study
from sgms_bench.studies.lasting_figure import lasting_figure
from sgms_bench.studies.lost import lost_study
from sgms_bench.studies.monte_carlo import monte_carlo_study
from sgms_bench.studies.others import AXES, others_study
from sgms_bench.studies.plant import plant_study
from sgms_bench.studies.readings import readings_study
from sgms_bench.studies.relinearise import relinearise_study
from sgms_bench.studies.scaling import scaling_study
from sgms_bench.studies.speed import speed_study
from sgms_bench.studies.tracking import tracking_study
from sgms_mhe.support.parallel import workers
from sgms_mhe.support.processes import WorkerSlot
from sgms_mhe.support.tables import CsvTable

DOTS_PER_INCH: Final = 110
Study = Callable[[int, int, WorkerSlot], CsvTable]

STUDIES: Final[Mapping[str, tuple[Study, int, int]]] = {
    "coverage": (coverage_study, 900, 400),
    "monte-carlo": (lambda runs, updates, place: monte_carlo_study(runs, updates / 100.0, place=place), 100, 400),
    "plant": (lambda runs, updates, place: plant_study(runs, updates / 100.0, place), 20, 2000),
    "creep": (lambda runs, updates, place: creep_study(updates), 1, 100_000),
    "relinearise": (lambda runs, updates, place: relinearise_study(runs, updates / 100.0, place), 10, 800),
    "readings": (lambda runs, updates, place: readings_study(runs, updates / 100.0, place), 6, 2000),
    "faults": (lambda runs, updates, place: faults_study(runs, place), 20, 1800),
    "lost": (lambda runs, updates, place: lost_study(runs, place), 10, 1800),
    "lasting": (lambda runs, updates, place: lasting_study(runs, updates / 100.0, place), 20, 2000),
    "tracking": (lambda runs, updates, place: tracking_study(updates / 100.0, place), 1, 600),
    "identify": (lambda runs, updates, place: identification_study(runs, updates / 100.0, place=place), 40, 2500),
    "coarse": (lambda runs, updates, place: coarse_study(runs, updates / 100.0, place=place), 100, 1200),
    "others": (lambda runs, updates, place: others_study(runs, updates / 100.0, place), len(AXES), 3000),
    "speed": (lambda runs, updates, place: speed_study(updates), 1, 150),
    "scaling": (lambda runs, updates, place: scaling_study(runs), 8, 1000),
}
"""Studies by name, with their numbers of runs and updates."""

DRAWN: Final = {"coarse": coarse_study, "identify": identification_study}
"""Studies of drawn axes, which may begin with another draw: numbers of a range that nothing was tuned on."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one study and print its table."""
    parser = argparse.ArgumentParser(prog="python -m sgms_bench.studies", description=__doc__.splitlines()[0])
    parser.add_argument("name", choices=[*STUDIES], help="which study")
    parser.add_argument("--runs", type=int, help="seeds or draws")
    parser.add_argument("--updates", type=int, help="updates per run (of 10 ms)")
    parser.add_argument("--jobs", type=int, default=workers(), help="processes at a time; 0: none but this one")
    parser.add_argument("--scheduler", help="address of a Dask cluster that does the work")
    parser.add_argument("--figure", type=Path, help="of lasting alone: draw one of its logs into this file instead")
    parser.add_argument("--first", type=int, default=0, help=f"first draw, of {' and '.join(DRAWN)} alone")
    chosen = parser.parse_args(arguments)
    study, runs, updates = STUDIES[chosen.name]
    if chosen.figure is not None:
        if chosen.name != "lasting":
            parser.error(f"argument --figure: {chosen.name} has none, lasting has")
        lasting_figure((chosen.updates or updates) / 100.0).savefig(chosen.figure, dpi=DOTS_PER_INCH)
        return 0
    place, runs, updates = WorkerSlot(chosen.jobs, chosen.scheduler), chosen.runs or runs, chosen.updates or updates
    if chosen.first:
        if chosen.name not in DRAWN:
            parser.error(f"argument --first: {chosen.name} has none, {' and '.join(DRAWN)} have")
        sys.stdout.write(f"{DRAWN[chosen.name](runs, updates / 100.0, chosen.first, place)}\n")
        return 0
    sys.stdout.write(f"{study(runs, updates, place)}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
