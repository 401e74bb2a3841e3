"""Parameters are written so that a start reads them again, and so that nothing is ever half written."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import rclpy
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rclpy.context import Context
from rclpy.node import Node

from fopid_ros.common.parameter_file import write_parameter_file

VALUES = st.one_of(
    st.booleans(), st.integers(-(2**63), 2**63 - 1),
    st.floats(allow_nan=False, allow_subnormal=False),  # rcl takes what is below 1e-307 for texts
    st.text(st.characters(codec="utf-8", exclude_categories=("C", "Z")), min_size=1, max_size=20),
    st.sampled_from(["", "true", "1.0", "1e5", ".inf", "null", "~", "a: b", "- x", "'", '"', "#", "on", "0x1f"]),
)  # fmt: skip


def read_by_ros(path: Path, node: str, namespace: str) -> dict[str, object]:
    """Parameters as rcl reads them for a node that starts with this file."""
    context = Context()
    rclpy.init(args=["--ros-args", "--params-file", str(path)], context=context)
    try:
        started = Node(node, namespace=namespace, context=context, automatically_declare_parameters_from_overrides=True,
                       enable_rosout=False, start_parameter_services=False)  # fmt: skip
        read = {name: parameter.value for name, parameter in started.get_parameters_by_prefix("").items()}
        started.destroy_node()
    finally:
        rclpy.shutdown(context=context)
    return {
        name: value for name, value in read.items() if name not in ("use_sim_time", "start_type_description_service")
    }


@settings(derandomize=True, deadline=None, max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.dictionaries(st.from_regex(r"[a-z]{1,6}(\.[a-z_]{1,6})?", fullmatch=True), VALUES, min_size=1, max_size=8))
def test_what_is_written_is_what_a_start_reads(tmp_path: Path, values: dict[str, object]) -> None:
    prefixes = {name.split(".")[0] for name in values if "." in name}
    values = {name: value for name, value in values.items() if name not in prefixes}
    path = tmp_path / "gains.yaml"
    write_parameter_file(path, "/hall/controller", values)
    read = read_by_ros(path, "controller", "/hall")
    assert read == values
    assert {name: type(value) for name, value in read.items()} == {name: type(value) for name, value in values.items()}


@pytest.mark.parametrize("text", ["1e5", "0E0", "-3e-7", "0o7", "1_0", ".5", "yes", "NaN", "12:30", "2020-01-01"])
def test_a_text_that_looks_like_something_else_stays_a_text(tmp_path: Path, text: str) -> None:
    write_parameter_file(tmp_path / "gains.yaml", "/controller", {"gains_file": text})
    assert read_by_ros(tmp_path / "gains.yaml", "controller", "/") == {"gains_file": text}


def test_infinite_limits_and_names_with_slashes_are_kept(tmp_path: Path) -> None:
    values = {"control_max": math.inf, "control_min": -math.inf, "qos_overrides./control.publisher.depth": 3}
    write_parameter_file(tmp_path / "gains.yaml", "/controller", values)
    assert read_by_ros(tmp_path / "gains.yaml", "controller", "/") == values


def test_the_file_behind_a_link_is_replaced_and_nothing_else_is_left(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    link = tmp_path / "gains.yaml"
    link.symlink_to(tmp_path / "real" / "gains.yaml")
    for kp in (1.0, 2.0):
        write_parameter_file(link, "/controller", {"kp": kp})
    assert link.is_symlink()
    assert [path.name for path in (tmp_path / "real").iterdir()] == ["gains.yaml"]
    assert yaml.safe_load(link.read_text())["/controller"]["ros__parameters"] == {"kp": 2.0}


def test_what_cannot_be_written_leaves_what_was_there(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="No such file"):
        write_parameter_file(tmp_path / "missing" / "gains.yaml", "/controller", {"kp": 1.0})
    taken = tmp_path / "gains.yaml"
    taken.mkdir()
    with pytest.raises(OSError, match="directory"):
        write_parameter_file(taken, "/controller", {"kp": 1.0})
    assert [path.name for path in tmp_path.iterdir()] == ["gains.yaml"]


def test_only_files_are_replaced(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for path in (pipe, Path("/"), tmp_path):
        with pytest.raises(OSError, match="not a file"):
            write_parameter_file(path, "/controller", {"kp": 1.0})
    assert pipe.is_fifo()
    assert [path.name for path in tmp_path.iterdir()] == ["pipe"]


def test_a_full_disk_leaves_the_old_file(tmp_path: Path) -> None:
    # A limit on the size of files stands for the disk's.
    path = tmp_path / "gains.yaml"
    write_parameter_file(path, "/controller", {"kp": 1.0})
    old = path.read_text()
    code = (
        "import resource, signal, sys; from pathlib import Path\n"
        "from fopid_ros.common.parameter_file import write_parameter_file\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN); resource.setrlimit(resource.RLIMIT_FSIZE, (64, 64))\n"
        "write_parameter_file(Path(sys.argv[1]), '/controller', {f'p{k}': k for k in range(100)})\n"
    )
    ended = subprocess.run([sys.executable, "-c", code, path], capture_output=True, text=True, check=False)
    assert "OSError: [Errno 27]" in ended.stderr
    assert path.read_text() == old
    assert [entry.name for entry in tmp_path.iterdir()] == ["gains.yaml"]


WRITER = """
import sys
from pathlib import Path
from fopid_ros.common.parameter_file import write_parameter_file
count = 0
while True:
    count += 1
    write_parameter_file(Path(sys.argv[1]), "/controller", {f"p{k}": count for k in range(2000)})
    if count == 1:
        print("begun", flush=True)
"""


def test_whoever_is_killed_while_writing_leaves_a_whole_file(tmp_path: Path) -> None:
    path = tmp_path / "gains.yaml"
    for lived in (0.01, 0.03, 0.05, 0.08):
        writer = subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, text=True)
        assert writer.stdout is not None
        assert writer.stdout.readline() == "begun\n"
        with pytest.raises(subprocess.TimeoutExpired):
            writer.wait(lived)
        os.kill(writer.pid, signal.SIGKILL)
        writer.wait()
        writer.stdout.close()
        values = yaml.load(path.read_text(), yaml.CSafeLoader)["/controller"]["ros__parameters"]
        assert len(values) == 2000
        assert len(set(values.values())) == 1
