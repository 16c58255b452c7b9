"""Logs whose sign, unit or columns are wrong: no cause explains them, and none may be named."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Final

from sgms_mhe.signals.logs import Log

FAULTS: Final[Mapping[str, Callable[[Log], Log]]] = MappingProxyType(
    {
        "force_of_other_sign": lambda log: replace(log, force_N=-log.force_N),
        "position_of_other_sign": lambda log: replace(log, position_m=-log.position_m),
        "position_in_thousandths": lambda log: replace(log, position_m=1e3 * log.position_m),
        "force_in_thousandths": lambda log: replace(log, force_N=1e3 * log.force_N),
        "force_in_thousands": lambda log: replace(log, force_N=1e-3 * log.force_N),
        "columns_exchanged": lambda log: replace(log, position_m=log.force_N, force_N=log.position_m),
    }
)
"""What goes wrong between a controller and a file, by name."""
