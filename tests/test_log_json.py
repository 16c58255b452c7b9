"""JSON as programs write it: lines, lists, arrays by name, nested messages; LabVIEW's measurement files."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cli_cases import refused, run
from sgms_mhe.api.inputs import read_log
from sgms_mhe.logfiles.inspection import Unread, inspect_log
from sgms_mhe.support.errors import InputError

Columns = dict[str, NDArray[np.float64]]


def motion(seed: int, rows: int = 400) -> Columns:
    rng = np.random.default_rng(seed)
    time = np.arange(rows) / 250.0
    position = rng.uniform(0.5, 2.0) * np.sin(6.0 * time)
    torque = np.sign(np.cos(6.0 * time)) - 2.0 * position + rng.normal(0.0, 0.01, rows)
    return {"time_s": time, "position_rad": position, "torque_Nm": torque}


def samples(columns: Columns) -> list[dict[str, float]]:
    return [dict(zip(columns, row, strict=True)) for row in zip(*(v.tolist() for v in columns.values()), strict=True)]


def lists(columns: Columns) -> dict[str, list[float]]:
    return {name: values.tolist() for name, values in columns.items()}


def make_rows(columns: Columns) -> Any:
    return {name: {str(k): x for k, x in enumerate(values)} for name, values in lists(columns).items()}


def make_typed_table(columns: Columns) -> Any:
    return {"schema": {"fields": [{"name": name} for name in columns]}, "data": samples(columns)}


def make_group(columns: Columns) -> Any:
    return {"made": {"by": "a rig", "tags": ["a", "b"]}, "run": {"rate": 250, "signals": lists(columns)}}


@pytest.mark.parametrize("layout", [samples, lists, make_rows, make_typed_table, make_group])
@pytest.mark.parametrize("indent", [None, 2])
def test_samples_are_found_wherever_they_are(layout: Callable[[Columns], Any], indent: Any, tmp_path: Path) -> None:
    columns = motion(1)
    path = tmp_path / "log.json"
    path.write_text(json.dumps(layout(columns), indent=indent))
    found = read_log(path)
    for name, values in zip(("time_s", "position_m", "force_N"), columns.values(), strict=True):
        np.testing.assert_array_equal(getattr(found, name), values)


def test_runs_of_a_servo_need_no_units_of_time_and_angle(tmp_path: Path) -> None:
    """As better-actuator-models records them; its `load`, a signed number that is stored unsigned, is the user's."""
    columns = motion(1)
    entries = [
        {"timestamp": t, "position": q, "goal_position": q, "load": round(1000.0 * f) % 65536, "torque_enable": True}
        for t, q, f in zip(*(values.tolist() for values in columns.values()), strict=True)
    ]
    path = tmp_path / "run.json"
    run = {"mass": 0.5, "length": 0.1, "kp": 100, "vin": 7.4, "entries": entries}
    path.write_text(json.dumps(run))
    table = {"torque_Nm": {"variable": "load", "scale": 1e-3, "signed": 16}}
    found = read_log(path, table=table)
    for name, values in zip(("time_s", "position_m", "force_N"), columns.values(), strict=True):
        np.testing.assert_allclose(getattr(found, name), values, atol=6e-4 if name == "force_N" else 0.0)
    del run["kp"]
    path.write_text(json.dumps(run))
    with pytest.raises(InputError, match="timestamp is there without a unit"):
        read_log(path, table=table)


def test_messages_of_joints_have_paths(tmp_path: Path) -> None:
    first, second = motion(2), motion(3)
    lines = [
        {
            "header": {"stamp": {"sec": 1_700_000_000 + k // 250, "nanosec": 4_000_000 * (k % 250)}},
            "name": ["shoulder", "elbow"],
            "position": [first["position_rad"][k], second["position_rad"][k]],
            "effort": [first["torque_Nm"][k], second["torque_Nm"][k]],
        }
        for k in range(400)
    ]
    path = tmp_path / "log.jsonl"
    path.write_text("\n".join(map(json.dumps, lines)) + "\n")
    with pytest.raises(InputError, match=r"position\[0\], position\[1\] are there without a unit"):
        read_log(path)
    table = {
        "position_rad": {"variable": "position[1]", "unit": "rad"},
        "torque_Nm": {"variable": "effort[1]", "unit": "N m"},
    }
    found = read_log(path, table=table)
    assert found.rate == pytest.approx(250.0)
    np.testing.assert_array_equal(found.position_m, second["position_rad"])


def test_events_with_names_are_turned_into_columns(tmp_path: Path) -> None:
    columns = motion(4)
    events = [
        {"time [s]": sample["time_s"], "signal": name, "value": sample[name]}
        for sample in samples(columns)
        for name in ("position_rad", "torque_Nm")
    ]
    path = tmp_path / "log.ndjson"
    path.write_text("\n".join(map(json.dumps, events)))
    np.testing.assert_array_equal(read_log(path).position_m, columns["position_rad"])


def test_what_a_message_lacks_is_missing(tmp_path: Path) -> None:
    lines: list[dict[str, Any]] = [dict(sample) for sample in samples(motion(5))]
    del lines[7]["torque_Nm"]
    lines[9]["torque_Nm"] = None
    path = tmp_path / "log.jsonl"
    path.write_text("\n".join(map(json.dumps, lines)))
    assert np.flatnonzero(np.isnan(read_log(path).force_N)).tolist() == [7, 9]
    lines[11]["torque_Nm"] = "off"
    path.write_text("\n".join(map(json.dumps, lines)))
    with pytest.raises(InputError, match=r"row 12 \(line 12\), column torque_Nm = 'off'"):
        read_log(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ('{"time_s": 0.0}\n{"time_s": 0.1, "po', "line 2"),
        ("[1, 2", "line 1"),
        ("", "line 1"),
        ("[]", "no samples"),
        ("[[0, 1], [2, 3]]", "no samples"),
        ('{"rate": 100}', "no samples"),
        ('{"a": ' * 5000 + "1" + "}" * 5000, "objects within objects"),
        ("3\n4", "column time_s"),
    ],
)
def test_what_is_no_log_is_refused(content: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "log.json"
    path.write_text(content)
    with pytest.raises(InputError, match=message):
        read_log(path)


# --- LabVIEW ------------------------------------------------------------------------------------------------------


def labview(path: Path, columns: Columns, form: str, *, comment: str = "\t") -> Path:
    """Write a measurement file whose channels have X columns of their own (Multi), one (One), or none (No)."""
    time, position, torque = (values.tolist() for values in columns.values())
    gap = "\t\t" if form == "Multi" else "\t"
    keys = {"Samples": "400", "Y_Unit_Label": "rad{}N m", "X_Dimension": "Time{}Time", "Delta_X": "0.004{}0.004"}
    lines = ["LabVIEW Measurement", "Separator\tTab", f"X_Columns\t{form}", "***End_of_Header***", "", "Channels\t2"]
    lines += [f"{key}\t{value.format(gap)}\t" for key, value in keys.items()]
    names = ["X_Value", "Angle", *(["X_Value"] if form == "Multi" else []), "Torque", "Comment"]
    lines += ["***End_of_Header***\t\t\t", "\t".join(names)]
    for t, x, f in zip(time, position, torque, strict=True):
        clock = "" if form == "No" else repr(t)
        lines.append("\t".join([clock, repr(x), *([clock] if form == "Multi" else []), repr(f)]) + comment)
    path.write_text("\r\n".join(lines))
    return path


@pytest.mark.parametrize("form", ["One", "Multi"])
@pytest.mark.parametrize("comment", ["", "\t"])
def test_measurement_files_of_labview_are_read(form: str, comment: str, tmp_path: Path) -> None:
    columns = motion(6)
    found = read_log(labview(tmp_path / "log.lvm", columns, form, comment=comment))
    np.testing.assert_array_equal(found.position_m, columns["position_rad"])
    np.testing.assert_array_equal(found.time_s, columns["time_s"])


def test_a_measurement_file_without_times_states_their_step_or_needs_a_rate(tmp_path: Path) -> None:
    path = labview(tmp_path / "log.lvm", motion(7), "No")
    assert read_log(path, note=lambda _: None).rate == pytest.approx(250.0)
    path.write_text(path.read_text().replace("Delta_X", "Other"))
    shown = inspect_log(path, None, None)
    assert isinstance(shown, Unread) and shown.missing == ("time_s",) and "as --rate" in shown.problems[0]
    assert run("inspect", path, "--rate", "250").exit_code == 0


def test_a_file_with_more_names_than_values_is_refused(tmp_path: Path) -> None:
    path = labview(tmp_path / "log.lvm", motion(8), "One", comment="")
    path.write_text(path.read_text().replace("Torque\tComment", "Torque\tOther\tComment"))
    assert "5 names" in refused("inspect", path)
