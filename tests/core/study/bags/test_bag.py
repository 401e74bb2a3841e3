"""A run is read the same from every kind of bag."""

from __future__ import annotations

import math
import sqlite3
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

from fopid_core.errors import InputError
from fopid_core.study.bags.bag import read_bag
from fopid_core.study.bags.repair import repair

from ..recording import BY_FREQUENCY, EXPERIMENT, IN_TIME, SAMPLE_TIME, START, Recording, record_loop

SCALAR = "fopid_msgs/msg/ScalarStamped"


@pytest.fixture(params=list(StoragePlugin), ids=lambda plugin: plugin.name.lower())
def storage(request: pytest.FixtureRequest) -> StoragePlugin:
    return request.param


def record(folder: Path, storage: StoragePlugin = StoragePlugin.MCAP, namespace: str = "", **kwargs):
    """A whole recording of the loop, and what went into it."""
    recording = Recording(folder, storage, namespace)
    written = record_loop(recording, **kwargs)
    recording.writer.set_custom_data("experiment", EXPERIMENT)
    recording.writer.close()
    return written


def test_signals_come_back_bit_for_bit(tmp_path: Path, storage: StoragePlugin) -> None:
    written = record(tmp_path / "bag", storage)
    run = read_bag(tmp_path / "bag")
    for name in ("measurement", "control"):
        assert np.array_equal(run.signals[name].value, written[name])
        assert np.array_equal(run.signals[name].time, np.round(written["time"], 9))
    for name in ("setpoint", "disturbance"):
        assert np.array_equal(run.signals[name].held_at(written["time"]), written[name])
        assert np.array_equal(run.signals[name].time, [0.0, 30.0, 60.0, 90.0])


def test_state_tunings_phases_and_metadata_come_back(tmp_path: Path, storage: StoragePlugin) -> None:
    written = record(tmp_path / "bag", storage)
    run = read_bag(tmp_path / "bag")
    assert np.array_equal(run.state["control"], written["control"])
    assert {tuple(row) for row in zip(*(run.state[n] for n in ("kp", "ki", "kd", "lam", "mu")), strict=True)} == {
        START.gains, BY_FREQUENCY.gains, IN_TIME.gains,
    }  # fmt: skip
    assert [(t.time, t.method, t.gains, t.applied) for t in run.tunings] == [
        (30.0, "frequency", BY_FREQUENCY, True), (90.0, "time", IN_TIME, True),
    ]  # fmt: skip
    assert run.tunings[0].achieved.phase_margin == math.radians(60.0)
    assert math.isnan(run.tunings[0].achieved.gain_margin_db)
    assert [(p.time, p.name) for p in run.phases][1] == (30.0, "tuned by frequency")
    assert run.metadata == {"experiment": EXPERIMENT}
    assert str(run.process) == "1/(s^3 + 3 s^2 + 3 s + 1)"
    assert run.sample_time == pytest.approx(SAMPLE_TIME, rel=1e-9)


def test_a_wall_clock_counts_from_the_first_message(tmp_path: Path) -> None:
    epoch = 1_790_000_000
    written = record(tmp_path / "bag", origin=float(epoch))
    run = read_bag(tmp_path / "bag")
    assert run.start == epoch * 10**9
    # The stamps were made from numbers of 2.4e-7 s resolution.
    assert np.allclose(run.signals["measurement"].time, written["time"] - epoch, atol=3e-7, rtol=0.0)


def test_messages_without_a_stamp_are_taken_at_their_log_time(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "bag", StoragePlugin.MCAP)
    for k in range(3):
        recording.write("control", 0.1 * k, "std_msgs/msg/Float64", data=float(k))
        recording.write("measurement", 0.1 * k, "sensor_msgs/msg/Temperature", temperature=20.0 + k, variance=0.5)
    recording.writer.close()
    run = read_bag(tmp_path / "bag")
    assert np.allclose(run.signals["control"].time, [0.0, 0.1, 0.2], rtol=1e-15)
    assert run.signals["control"].value.tolist() == [0.0, 1.0, 2.0]
    # its header is there, and never filled in
    assert np.allclose(run.signals["measurement"].time, [0.0, 0.1, 0.2], rtol=1e-15)
    assert run.signals["measurement"].value.tolist() == [20.0, 21.0, 22.0]


def test_the_bag_can_name_the_field_of_a_signal(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "bag", StoragePlugin.MCAP)
    vector = recording.message("geometry_msgs/msg/Vector3", x=1.0, y=2.0, z=3.0)
    recording.write("measurement", 0.0, "geometry_msgs/msg/Twist", linear=vector)
    recording.write("control", 0.0, "std_msgs/msg/Float64MultiArray", data=np.array([4.0, 5.0]))
    recording.writer.set_custom_data("measurement.field", "linear.z")
    recording.writer.set_custom_data("control.field", "data[1]")
    recording.writer.close()
    signals = read_bag(tmp_path / "bag").signals
    assert (signals["measurement"].value.tolist(), signals["control"].value.tolist()) == ([3.0], [5.0])


def test_messages_out_of_order_are_put_in_order(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "bag", StoragePlugin.MCAP)
    for stamp in (0.2, 0.1, 0.3):
        for topic in ("measurement", "control"):
            recording.write(topic, 0.5, SCALAR, header=recording.header(stamp), value=stamp)
    recording.writer.close()
    measurement = read_bag(tmp_path / "bag").signals["measurement"]
    assert measurement.time.tolist() == measurement.value.tolist() == [0.1, 0.2, 0.3]


def test_one_of_several_loops_is_chosen_by_its_namespace(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "bag", StoragePlugin.MCAP)
    for namespace, value in (("/one", 1.0), ("/two", 2.0)):
        recording.namespace = namespace
        for topic in ("measurement", "control"):
            recording.write(topic, 0.0, SCALAR, value=value)
        recording.write("fopid_controller/state", 0.0, "fopid_msgs/msg/FopidState", kp=value)
    recording.writer.close()
    with pytest.raises(InputError, match="several loops; choose a namespace: /one, /two"):
        read_bag(tmp_path / "bag")
    run = read_bag(tmp_path / "bag", namespace="/two")
    assert (run.signals["control"].value.tolist(), run.state["kp"].tolist()) == ([2.0], [2.0])


def test_the_controllers_state_stands_in_for_signals_that_were_not_recorded(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "bag", StoragePlugin.MCAP)
    recording.write("pid/state", 0.0, "fopid_msgs/msg/FopidState", setpoint=1.0, measurement=0.5, control=2.0)
    recording.writer.close()
    signals = read_bag(tmp_path / "bag").signals
    assert {name: signal.value.tolist() for name, signal in signals.items()} == {
        "setpoint": [1.0], "measurement": [0.5], "control": [2.0],
    }  # fmt: skip


def test_parameter_changes_of_this_loop_are_read(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "bag", StoragePlugin.MCAP, "/one")
    for topic in ("measurement", "control"):
        recording.write(topic, 0.0, SCALAR, value=0.0)
    for node, limit in (("/one/fopid_controller", 3.0), ("/two/fopid_controller", 9.0)):
        value = recording.message("rcl_interfaces/msg/ParameterValue", type=3, double_value=limit)
        change = recording.message("rcl_interfaces/msg/Parameter", name="control_max", value=value)
        recording.write("/parameter_events", 0.0, "rcl_interfaces/msg/ParameterEvent", node=node,
                        new_parameters=[], changed_parameters=[change], deleted_parameters=[])  # fmt: skip
    recording.writer.close()
    run = read_bag(tmp_path / "bag")
    assert [(change.node, change.name, change.value) for change in run.parameters] == [
        ("/one/fopid_controller", "control_max", 3.0)
    ]


def test_a_bag_without_its_metadata_file_is_read(tmp_path: Path, storage: StoragePlugin) -> None:
    written = record(tmp_path / "bag", storage)
    (tmp_path / "bag" / "metadata.yaml").unlink()
    (file,) = (tmp_path / "bag").iterdir()
    for path in (tmp_path / "bag", file):
        assert np.array_equal(read_bag(path).signals["measurement"].value, written["measurement"])


def test_a_bag_that_was_cut_off_is_read_up_to_its_last_whole_chunk(tmp_path: Path) -> None:
    written = record(tmp_path / "bag")
    path = tmp_path / "bag" / "bag.mcap"
    whole = path.read_bytes()
    assert read_bag(tmp_path / "bag").whole
    path.write_bytes(whole[: len(whole) * 2 // 3])
    run = read_bag(tmp_path / "bag")
    kept = run.signals["measurement"].value.size
    assert not run.whole
    assert 0 < kept < written["measurement"].size
    assert np.array_equal(run.signals["measurement"].value, written["measurement"][:kept])
    assert run.metadata == {"experiment": EXPERIMENT}
    assert len(path.read_bytes()) == len(whole) * 2 // 3  # reading changes nothing


@pytest.mark.parametrize(
    ("prepare", "message"),
    [
        (lambda _: None, "does not exist"),
        (lambda path: path.mkdir(), "is no bag, it holds nothing"),
        (lambda path: (path.mkdir(), (path / "notes.txt").touch()), r"is no bag, it holds notes\.txt"),
        (lambda path: path.write_text("hello"), "cannot be read"),
        (lambda path: (path.mkdir(), (path / "metadata.yaml").write_text("a: 1")), r"it holds metadata\.yaml"),
        (lambda path: (path.mkdir(), (path / "x.mcap").write_text("hello, I am no bag")), "no mcap file"),
        (lambda path: (path.mkdir(), (path / "x.db3").write_text("hello, I am no bag")), "cannot be read"),
    ],
)
def test_what_is_no_bag_is_refused_in_one_line_that_names_it(tmp_path: Path, prepare, message: str) -> None:
    path = tmp_path / "thing"
    prepare(path)
    with pytest.raises(InputError, match=message) as caught:
        read_bag(path)
    assert "thing" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_folder_of_an_experiment_stands_for_its_bag(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "demo" / "bag", StoragePlugin.MCAP)
    record_loop(recording)
    recording.writer.close()
    (tmp_path / "demo" / "experiment.yaml").touch()
    assert read_bag(tmp_path / "demo").path == tmp_path / "demo" / "bag"
    assert repair(tmp_path / "demo").counts


def test_a_bag_without_the_loop_is_refused_with_what_it_has(tmp_path: Path, storage: StoragePlugin) -> None:
    recording = Recording(tmp_path / "bag", storage)
    recording.write("/temperature", 0.0, "std_msgs/msg/Float64", data=1.0)
    recording.write("control", 0.0, SCALAR, value=1.0)
    recording.writer.close()
    with pytest.raises(InputError, match="no messages on /measurement; it has /control, /temperature"):
        read_bag(tmp_path / "bag")
    assert read_bag(tmp_path / "bag", needed=["control"]).signals["control"].value.tolist() == [1.0]


def test_an_old_bag_without_definitions_is_refused_by_the_type_it_lacks(tmp_path: Path) -> None:
    record(tmp_path / "bag", StoragePlugin.SQLITE3)
    with sqlite3.connect(tmp_path / "bag" / "bag.db3") as database:
        database.execute("DELETE FROM message_definitions")
    with pytest.raises(InputError, match=r"no definition of .*fopid_msgs/msg/ScalarStamped"):
        read_bag(tmp_path / "bag")


def test_reading_needs_no_ros(tmp_path: Path) -> None:
    record(tmp_path / "bag")
    program = (
        "import sys; from fopid_core.study.bags.bag import read_bag; read_bag(sys.argv[1]);"
        "print([name for name in ('rclpy', 'fopid_msgs', 'std_msgs') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program, tmp_path / "bag"], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_text_that_is_damaged_is_told_by_the_type_of_its_message(tmp_path: Path) -> None:
    record(tmp_path / "bag", StoragePlugin.SQLITE3)
    with sqlite3.connect(tmp_path / "bag" / "bag.db3") as database:
        (data,) = database.execute("SELECT data FROM messages WHERE instr(data, x'7374617274696e67')").fetchone()
        damaged = data.replace(b"starting", b"st\xffrting")
        database.execute("UPDATE messages SET data = ? WHERE data = ?", (damaged, data))
    with pytest.raises(InputError, match="fopid_msgs/msg/ExperimentPhase cannot be read"):
        read_bag(tmp_path / "bag")
