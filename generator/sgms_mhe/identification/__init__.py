"""From measured logs alone to a machine file: elements, levels and rates without any guess to start from."""

from sgms_mhe.identification.identify import Wanted as Wanted
from sgms_mhe.identification.identify import identify as identify
from sgms_mhe.identification.result import Identification as Identification
