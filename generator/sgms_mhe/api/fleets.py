"""Results over a table of machines and logs, and their page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from sgms_mhe.api.fleet.running import Fleet, Told, run_fleet
from sgms_mhe.api.fleet.table import Verb
from sgms_mhe.api.fleet.writing import write_fleet
from sgms_mhe.support.options import Option
from sgms_mhe.support.parallel import workers
from sgms_mhe.support.processes import WorkerSlot


def fleet(
    verb: Verb,
    table: str | Path,
    out: str | Path,
    *,
    jobs: Annotated[int | None, Option("J", 1, 256)] = None,
    scheduler: Annotated[str | None, Option("ADDRESS")] = None,
    time_limit_s: Annotated[float, Option(least=1.0, most=1e6)] = 1800.0,
    progress: Told | None = None,
) -> Fleet:
    """Diagnose, estimate or identify every row of a table of machines and logs, and write the page of the fleet.

    Args:
        verb: which.
        table: CSV with columns machine, log (relative to the table); optional name, axis, date, mass.
        out: folder of the results, which a second run goes on from.
        jobs: processes at a time; None: one per core.
        scheduler: address of a Dask cluster that does the work in place of this host.
        time_limit_s: time for one log [s]; it has failed then.
        progress: called with each row that is done, and the share of rows.

    Raises:
        InputError: the table; the folder; a scheduler that does not answer.
    """
    done = run_fleet(verb, table, out, WorkerSlot(jobs or workers(), scheduler, time_limit_s), progress)
    write_fleet(done, Path(out))
    return done
