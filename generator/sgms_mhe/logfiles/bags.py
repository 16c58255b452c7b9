"""Bags of ROS 1 and 2 and MCAP files, by rosbags: a column for each number in the messages of a topic."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any, Final

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

    columns: dict[str, tuple[str, str, str]] = {}  # clock, unit and topic by name
    unread = []
    with open_bag() as reader:
        for connection in reader.connections:
            units = UNITS if connection.msgtype.endswith("/JointState") else {}
            try:
                for _, numbers in islice(_messages(reader, [connection]), BEGINNING):
                    for group, member, _ in numbers:
                        columns[f"{group}.{member}"] = f"{group}.stamp", units.get(member, ""), connection.topic
            except (stores.TypesysError, KeyError):
                unread.append(f"{connection.topic} is left out, its messages of an unknown type: {connection.msgtype}")
    clocks = {name: clock for name, (clock, _, _) in columns.items()}
    columns = {clock: (clock, "s", topic) for clock, _, topic in columns.values()} | columns

    def read(names: Sequence[str]) -> Mapping[str, Array]:
        rows: dict[str, list[dict[str, float]]] = {columns[name][0]: [] for name in names}
        topics = {columns[name][2] for name in names}
        with open_bag() as reader:
            for time, numbers in _messages(reader, [c for c in reader.connections if c.topic in topics]):
                row: dict[str, dict[str, float]] = {}
                for group, member, number in numbers:
                    row.setdefault(clock := f"{group}.stamp", {clock: time})[f"{group}.{member}"] = number
                for clock in row.keys() & rows.keys():
                    rows[clock].append(row[clock])
        return {name: np.array([row.get(name, np.nan) for row in rows[columns[name][0]]]) for name in names}

    found = columns_of(list(columns), [unit for _, unit, _ in columns.values()])
    stamps = frozenset(clocks.values())
    return Table("ROS bag", found, read, array_row, stamped=stamps, notes=tuple(unread), clocks=clocks)


def _messages(reader: Any, connections: Sequence[Any]) -> Iterator[tuple[float, Iterator[tuple[str, str, float]]]]:
    """Yield each message's time since the bag began [s], and its numbers."""
    for connection, recorded, data in reader.messages(connections):
        message = reader.deserialize(data, connection.msgtype)
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        time = 0 if stamp is None else stamp.sec * 10**9 + stamp.nanosec
        yield ((time or recorded) - reader.start_time) / 1e9, _numbers(connection.topic, message)


def _numbers(topic: str, message: Any) -> Iterator[tuple[str, str, float]]:
    """Yield the topic, or the topic and a joint, member and value of the numbers of a message."""
    joints = getattr(message, "name", None) or getattr(message, "joint_names", None)
    joints = joints if isinstance(joints, list) else []
    for member in (name for name in vars(message) if name not in ("header", "name", "joint_names")):
        value = getattr(message, member)
        if joints and isinstance(value, np.ndarray) and len(value) == len(joints):
            yield from ((f"{topic}.{joint}", member, float(n)) for joint, n in zip(joints, value, strict=True))
        else:
            yield from ((topic, name, number) for name, number in _flatten(member, value))


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
