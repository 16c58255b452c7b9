"""Recordings of robots: bags of ROS 1 and 2, MCAP, LeRobot data sets."""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

from cli_cases import run
from sgms_mhe.api.inputs import read_log
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import InputError

START_NS = 1_700_000_000 * 10**9
ELBOW = {"position_rad": "/joint_states.elbow.position", "torque_Nm": "/joint_states.elbow.effort"}


def motion(seed: int, n: int = 600, rate: float = 100.0) -> Log:
    """A rotor of 2 kg m^2 with friction, at times that are whole nanoseconds."""
    time = np.arange(n) / rate
    position = np.random.default_rng(seed).uniform(1.0, 3.0) * np.sin(3.0 * time) + 0.2 * np.sin(11.0 * time)
    speed = np.gradient(position, 1.0 / rate)
    return Log(time, position, 2.0 * np.gradient(speed, 1.0 / rate) + np.tanh(speed / 0.01), rate, kind="rotary")


def write_bag(
    path: Path, plugin: str, joints: Mapping[str, Log], *, together: bool = True, stamped: bool = True
) -> Path:
    """Write a bag with a topic of JointState and one of wrenches; joints in one message, or each in its own."""
    first = plugin == "ros1"
    types = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_HUMBLE)
    state, wrench = (types.types[name] for name in ("sensor_msgs/msg/JointState", "geometry_msgs/msg/Wrench"))
    vector = types.types["geometry_msgs/msg/Vector3"]
    header, instant = types.types["std_msgs/msg/Header"], types.types["builtin_interfaces/msg/Time"]
    serialize = types.serialize_ros1 if first else types.serialize_cdr

    def message(k: int, names: Sequence[str]) -> Any:
        at = START_NS + round(1e9 * joints[names[0]].time_s[k]) if stamped else 0
        own = {"seq": k} if first else {}
        values = [np.array([getattr(joints[n], part)[k] for n in names]) for part in ("position_m", "force_N")]
        stamp = header(stamp=instant(sec=at // 10**9, nanosec=at % 10**9), frame_id="", **own)
        return state(header=stamp, name=list(names), position=values[0], velocity=np.zeros(0), effort=values[1])

    options = {} if first else {"version": 9, "storage_plugin": rosbag2.StoragePlugin[plugin]}
    with (rosbag1 if first else rosbag2).Writer(path, **options) as bag:
        about = [
            bag.add_connection(t, m.__msgtype__, typestore=types)
            for t, m in (("/joint_states", state), ("/ft", wrench))
        ]
        for k in range(min(map(len, joints.values()))):
            for names in [list(joints)] if together else [[name] for name in joints]:
                at = START_NS + round(1e9 * joints[names[0]].time_s[k])
                bag.write(about[0], at, serialize(message(k, names), state.__msgtype__))
            push = wrench(force=vector(x=1.0, y=2.0, z=3.0), torque=vector(x=0.0, y=0.0, z=float(k)))
            bag.write(about[1], START_NS + 10**7 * k, serialize(push, wrench.__msgtype__))
    return path


def assert_same(found: Log, log: Log) -> None:
    np.testing.assert_allclose(found.position_m, log.position_m)
    np.testing.assert_allclose(found.force_N, log.force_N)
    assert found.kind == "rotary" and found.rate == pytest.approx(log.rate)


def alone(suffix: str) -> Callable[[Path], Path]:
    return lambda folder: next(folder.glob(f"*{suffix}"))


@pytest.mark.parametrize(
    ("name", "plugin", "choose"),
    [
        ("log.bag", "ros1", lambda path: path),
        ("folder", "MCAP", lambda path: path),
        ("folder", "MCAP", alone(".mcap")),
        ("folder", "SQLITE3", lambda path: path),
        ("folder", "SQLITE3", alone(".db3")),
    ],
)
@pytest.mark.parametrize(("together", "stamped"), [(True, True), (False, True), (True, False)])
def test_a_joint_of_a_bag_is_read(
    name: str, plugin: str, choose: Callable[[Path], Path], together: bool, stamped: bool, tmp_path: Path
) -> None:
    """From messages of all joints, or of each its own; by the stamps of headers, or when they were recorded."""
    joints = {"shoulder": motion(1), "elbow": motion(2)}
    path = choose(write_bag(tmp_path / name, plugin, joints, together=together, stamped=stamped))
    assert_same(read_log(path, table=ELBOW), joints["elbow"])
    with pytest.raises(InputError, match=r"one column; .* says which: .*/joint_states\.shoulder\.position"):
        read_log(path, table={"position_rad": {"unit": "rad"}})


def test_a_wrench_beside_the_joint_is_a_torque(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "log", "MCAP", {"elbow": motion(3)})
    torque = {"variable": "/ft.torque.z", "unit": "N m"}
    found = read_log(path, table={"position_rad": "/joint_states.elbow.position", "torque_Nm": torque})
    np.testing.assert_allclose(found.force_N, np.arange(600.0))


def test_a_bag_of_one_joint_wants_to_know_whether_it_turns(tmp_path: Path) -> None:
    """A JointState is in rad and N m of a joint that turns, in m and N of one that slides."""
    log = motion(4)
    path = write_bag(tmp_path / "log", "MCAP", {"elbow": log})
    assert "position_m = {" in (said := run("inspect", path).output) and "position_rad = {" in said
    assert_same(read_log(path, table={"position_rad": {"unit": "rad"}}), log)
    slide = read_log(path, table={"position_m": {"unit": "m"}})
    assert slide.kind == "linear" and np.allclose(slide.force_N, log.force_N)


def test_a_damaged_bag_is_refused(tmp_path: Path) -> None:
    whole = alone(".mcap")(write_bag(tmp_path / "log", "MCAP", {"elbow": motion(5)}))
    part = tmp_path / "part.mcap"
    part.write_bytes(whole.read_bytes()[:3000])
    for path in (part, tmp_path):
        with pytest.raises(InputError, match=r"a whole bag|a folder with metadata\.yaml or meta"):
            read_log(path)


# --- LeRobot ------------------------------------------------------------------------------------------------------

STATE = {"variable": "observation.state.elbow.pos", "unit": "deg"}
GOAL = {"variable": "action.elbow.pos", "unit": "deg"}


def write_data_set(path: Path, episodes: Sequence[Log], files: Sequence[Sequence[int]]) -> Path:
    """Write a data set with the episodes of each of its files."""
    names = ["shoulder.pos", "elbow.pos"]
    features = {
        "observation.state": {"names": names},
        "action": {"names": {"motors": names}},
        "timestamp": {"names": None},
    }
    (path / "meta").mkdir(parents=True)
    (path / "meta/info.json").write_text(json.dumps({"fps": 100, "features": features}))
    folder = path / "data/chunk-000"
    folder.mkdir(parents=True)

    def table(number: int) -> pa.Table:
        log = episodes[number]
        degrees = np.degrees(np.column_stack((np.zeros(len(log)), log.position_m)))
        return pa.table(
            {
                "observation.state": pa.array(degrees.tolist(), type=pa.list_(pa.float32(), 2)),
                "action": pa.array((degrees + 1.0).tolist(), type=pa.list_(pa.float32())),
                "timestamp": pa.array(log.time_s, type=pa.float32()),
                "episode_index": np.full(len(log), number),
            }
        )

    for k, numbers in enumerate(files):
        pq.write_table(pa.concat_tables([table(number) for number in numbers]), folder / f"file-{k:03d}.parquet")
    return path


@pytest.mark.parametrize("files", [[[0], [1], [2]], [[0, 1], [2]]], ids=["a file an episode", "a file for several"])
def test_a_data_set_is_read_whole_and_by_files(files: list[list[int]], tmp_path: Path) -> None:
    """Episodes follow each other; the second between them is a gap, in which no position is made up."""
    episodes = [motion(k, n) for k, n in ((6, 300), (7, 250), (8, 400))]
    path = write_data_set(tmp_path / "arm", episodes, files)
    notes: list[str] = []
    found = read_log(path, table={"position_rad": STATE, "goal_rad": GOAL}, note=notes.append)
    assert any("3 episodes" in note and "100 samples are missing" in note for note in notes)
    assert len(found) == 950 + 2 * 100 and found.rate == pytest.approx(100.0, rel=1e-4)
    known = np.isfinite(found.position_m)
    np.testing.assert_allclose(found.position_m[known], np.concatenate([e.position_m for e in episodes]), atol=1e-6)
    np.testing.assert_array_equal(np.flatnonzero(np.diff(known)), [299, 399, 649, 749])
    assert found.goal_m is not None
    np.testing.assert_allclose((found.goal_m - found.position_m)[known], np.radians(1.0), atol=1e-6)
    last = read_log(
        next((path / "data/chunk-000").glob(f"*{len(files) - 1}.parquet")),
        table={"position_rad": STATE, "goal_rad": GOAL},
    )
    np.testing.assert_allclose(last.position_m, episodes[2].position_m, atol=1e-6)


def test_a_data_set_states_no_unit(tmp_path: Path) -> None:
    path = write_data_set(tmp_path / "arm", [motion(9)], [[0]])
    said = run("inspect", path).output
    assert re.search(r"observation\.state\.elbow\.pos are there without a unit", said)
    (path / "meta/info.json").write_text("{}")
    with pytest.raises(InputError, match=r"info\.json: .*a LeRobot data set says of itself"):
        read_log(path)
