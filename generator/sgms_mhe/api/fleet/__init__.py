"""Many machines and logs: one of diagnose, estimate and identify over a table of them."""

from sgms_mhe.api.fleet.running import Done, Fleet, run_fleet

__all__ = ["Done", "Fleet", "run_fleet"]
