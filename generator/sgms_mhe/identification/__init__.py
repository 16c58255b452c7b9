"""From measured logs alone to a machine file: elements, levels and rates without any guess to start from."""

from __future__ import annotations

from sgms_mhe.identification.identify import Wanted, identify
from sgms_mhe.identification.result import Identification, Number

__all__ = ["Identification", "Number", "Wanted", "identify"]
