"""Many machines and logs: one of diagnose, estimate and identify over a table of them."""

from sgms_mhe.api.fleet.running import Done as Done
from sgms_mhe.api.fleet.running import Fleet as Fleet
from sgms_mhe.api.fleet.running import run_fleet as run_fleet
