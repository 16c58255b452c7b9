"""From a machine file to the machine it describes: effects from their catalogue, the integrator by the friction law."""

from sgms_mhe.configuration.laws import law_changes as law_changes
from sgms_mhe.configuration.laws import smooth_elements as smooth_elements
from sgms_mhe.configuration.laws import switch_law as switch_law
from sgms_mhe.configuration.resolution import G_N as G_N
from sgms_mhe.configuration.resolution import carry_load as carry_load
from sgms_mhe.configuration.resolution import drop_disturbance as drop_disturbance
from sgms_mhe.configuration.resolution import load_machine as load_machine
from sgms_mhe.configuration.resolution import make_machine as make_machine
from sgms_mhe.configuration.resolution import override_log as override_log
from sgms_mhe.configuration.resolution import override_machine as override_machine
from sgms_mhe.configuration.resolution import step_every_sample as step_every_sample
from sgms_mhe.configuration.schema import machine_schema as machine_schema
