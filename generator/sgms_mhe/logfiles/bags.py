"""Bags of ROS 1 and 2 and MCAP files, by rosbags: a column for each number in the messages of a topic."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from sgms_mhe.logfiles.table import Table, array_row, columns_of, refuse_damage
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.libraries import optional_library

BEGINNING: Final = 100
"""Messages of a topic that tell its columns: of joints that several nodes publish, each has its own."""
MOST: Final = 64
"""Elements of an array that are columns: a longer one is a picture or a cloud of points."""
UNITS: Final = {"position": "rad or m", "velocity": "rad/s or m/s", "effort": "N m or N"}
"""Of sensor_msgs/JointState, by whether the joint turns or slides."""

_WHOLE: Final = "a whole bag of ROS 1 or 2, or MCAP file of ROS messages in CDR"


class _Value(NamedTuple):
    """A number of a message: its clock, that of its topic or joint; its column; and the unit of that."""

    clock: str
    column: str
    unit: str
    number: float


def read_bag(path: Path) -> Table:
    """The table of a bag's topics: `TOPIC.member`, of a JointState `TOPIC.JOINT.position`, each with its topic's time.

    That is the stamp of the messages' header, else when they were recorded. Raises InputError for a damaged file and
    where rosbags is absent, OSError as open does.
    """
    highlevel = optional_library("rosbags.highlevel", "ros", "a bag", path)
    stores = optional_library("rosbags.typesys", "ros", "a bag", path)

    @contextmanager
    def open_bag() -> Iterator[Any]:
        store = stores.get_typestore(stores.Stores.LATEST)  # for bags that hold no definitions of their messages
        with refuse_damage(path, _WHOLE), highlevel.AnyReader([path], default_typestore=store) as reader:
            yield reader

    units, clocks, topics, unread = {}, {}, {}, []
    with open_bag() as reader:
        for connection in reader.connections:
            try:
                values = list(islice(_messages(reader, [connection]), BEGINNING))
            except (stores.TypesysError, KeyError):
                unread.append(f"{connection.topic} ({connection.msgtype})")
                continue
            for value in (value for _, found in values for value in found):
                units[value.column], clocks[value.column] = value.unit, value.clock
                topics[value.column] = topics[value.clock] = connection.topic
    stamps = dict.fromkeys(clocks.values())

    def read(names: Sequence[str]) -> Mapping[str, Array]:
        wanted = {name: clocks.get(name, name) for name in names}
        rows: dict[str, list[dict[str, float]]] = {clock: [] for clock in wanted.values()}
        with open_bag() as reader:
            asked = {topics[name] for name in names}
            for time, found in _messages(reader, [c for c in reader.connections if c.topic in asked]):
                row: dict[str, dict[str, float]] = {}
                for value in found:
                    row.setdefault(value.clock, {value.clock: time})[value.column] = value.number
                for clock in row.keys() & rows.keys():
                    rows[clock].append(row[clock])
        return {name: np.array([row.get(name, np.nan) for row in rows[clock]]) for name, clock in wanted.items()}

    units = dict.fromkeys(stamps, "s") | units
    columns = columns_of(list(units), list(units.values()))
    notes = [f"left out, its messages are of an unknown type: {name}" for name in unread]
    return Table("ROS bag", columns, read, array_row, stamped=frozenset(stamps), notes=tuple(notes), clocks=clocks)


def _messages(reader: Any, connections: Sequence[Any]) -> Iterator[tuple[float, list[_Value]]]:
    """Yield each message's time since the bag began [s] and its numbers."""
    for connection, recorded, data in reader.messages(connections):
        message = reader.deserialize(data, connection.msgtype)
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        time = 0 if stamp is None else stamp.sec * 10**9 + stamp.nanosec
        units = UNITS if connection.msgtype.endswith("/JointState") else {}
        yield ((time or recorded) - reader.start_time) / 1e9, list(_numbers(connection.topic, message, units))


def _numbers(topic: str, message: Any, units: Mapping[str, str]) -> Iterator[_Value]:
    """Yield the numbers of a message; of arrays beside a list of joints' names, each by its joint."""
    joints = getattr(message, "name", None) or getattr(message, "joint_names", None)
    joints = joints if isinstance(joints, list) else []
    for member in (name for name in vars(message) if name not in ("header", "name", "joint_names")):
        value = getattr(message, member)
        if joints and isinstance(value, np.ndarray) and len(value) == len(joints):
            for joint, number in zip(joints, value, strict=True):
                clock = f"{topic}.{joint}"
                yield _Value(f"{clock}.stamp", f"{clock}.{member}", units.get(member, ""), float(number))
        else:
            for name, number in _flatten(member, value):
                yield _Value(f"{topic}.stamp", f"{topic}.{name}", units.get(member, ""), number)


def _flatten(name: str, value: Any) -> Iterable[tuple[str, float]]:
    """Yield each number of a member by its path."""
    if isinstance(value, (bool, int, float, np.number)):
        yield name, float(value)
    elif isinstance(value, (list, np.ndarray)) and len(value) <= MOST:
        for k, element in enumerate(value):
            yield from _flatten(f"{name}[{k}]", element)
    elif hasattr(value, "__msgtype__"):
        for member, inner in vars(value).items():
            yield from _flatten(f"{name}.{member}", inner)
