"""From a machine file to the machine it describes: effects from their catalogue, the integrator by the friction law."""

from sgms_mhe.configuration.laws import law_changes, switch_law
from sgms_mhe.configuration.resolution import (
    drop_disturbance,
    load_machine,
    make_machine,
    override_log,
    override_machine,
    step_every_sample,
)
from sgms_mhe.configuration.schema import machine_schema

__all__ = [
    "drop_disturbance",
    "law_changes",
    "load_machine",
    "machine_schema",
    "make_machine",
    "override_log",
    "override_machine",
    "step_every_sample",
    "switch_law",
]
