"""Measurement data of ASAM's format MDF 4 (and 3), by asammdf."""

import gc
import logging
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from sgms_mhe.logfiles.table import Table, array_row, columns_of, damage_error, real, refuse_damage
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.libraries import optional_library

_WHOLE = "a whole MDF file of numeric channels"


def read_mdf(path: Path) -> Table:
    """The table of all channels, the time of each group among them; the file states their units.

    Raises InputError for a damaged file and where asammdf is absent, OSError as open does.
    """
    asammdf = optional_library("asammdf", "mdf", "MDF", path)

    def open_file() -> Any:
        with _silence():
            try:
                return asammdf.MDF(path)
            except Exception as error:  # whatever a damaged file makes it stumble over
                refusal = damage_error(path, _WHOLE, error)
            gc.collect()
        raise refusal

    with open_file() as content:
        places = [(g, c) for g, group in enumerate(content.groups) for c in range(len(group.channels))]
        channels = [content.groups[g].channels[c] for g, c in places]
        # asammdf copies the bytes of a channel by code in C that reads wherever a damaged file sends it.
        if astray := next(
            (c.name for (g, _), c in zip(places, channels, strict=True) if _is_astray(content, g, c)), ""
        ):
            raise damage_error(path, _WHOLE, ValueError(f"channel {astray} lies beyond its records"))
        columns = columns_of([channel.name for channel in channels], [_unit(channel) for channel in channels])
        masters = {g: content.masters_db.get(g) for g in range(len(content.groups))}
    where = {column.name: place for column, place in zip(columns, places, strict=True)}
    at = {place: name for name, place in where.items()}
    clocks = {
        name: at[g, master] for name, (g, c) in where.items() if (master := masters[g]) is not None and c != master
    }

    def read(names: Sequence[str]) -> Mapping[str, Array]:
        values: dict[str, Array] = {}
        with open_file() as content:
            for name in names:
                group, channel = where[name]
                with refuse_damage(path, _WHOLE), _silence():
                    signal = content.get(group=group, index=channel)
                is_clock = masters[group] == channel
                time = np.asarray(signal.timestamps, dtype=np.float64)
                values[name] = time if is_clock else real(path, f"channel {name}", signal.samples)
        return values

    return Table("MDF", columns, read, array_row, clocks=clocks)


def _unit(channel: Any) -> str:
    """The unit of a channel, or of its conversion, as version 3 has it."""
    return str(channel.unit or getattr(channel.conversion, "unit", "") or "")


def _is_astray(content: Any, group: int, channel: Any) -> bool:
    """Return True if a channel has bits beyond the records of its group."""
    records = content.groups[group].channel_group
    if hasattr(channel, "byte_offset"):
        begin = 8 * channel.byte_offset + channel.bit_offset
        size = records.samples_byte_nr + records.invalidation_bytes_nr
    else:  # version 3
        begin = channel.start_offset + 8 * getattr(channel, "additional_byte_offset", 0)
        size = records.samples_byte_nr
    return bool(begin + channel.bit_count > 8 * size)


@contextmanager
def _silence() -> Iterator[None]:
    """Silence asammdf's log messages about a damaged file, and its complaints about one left half open."""
    logger = logging.getLogger("asammdf")
    before, hook = logger.disabled, sys.unraisablehook
    logger.disabled, sys.unraisablehook = True, lambda _: None
    try:
        yield
    finally:
        logger.disabled, sys.unraisablehook = before, hook
