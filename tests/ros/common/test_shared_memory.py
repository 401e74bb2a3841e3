"""What killed processes leave in shared memory is removed by the next node that starts; what is in use stays."""

from __future__ import annotations

import fcntl
import os
import signal
from pathlib import Path

import psutil
import pytest

from fopid_msgs.msg import ScalarStamped
from fopid_ros.common.middleware import TRANSPORTS
from fopid_ros.common.shared_memory import FOLDER, YOUNGEST, remove_abandoned_segments

from ..conftest import Graph


def aged(*paths: Path) -> None:
    """Let files be older than what is not judged."""
    for path in paths:
        before = path.stat().st_mtime - 2 * YOUNGEST
        os.utime(path, (before, before))


def make(folder: Path, name: str) -> list[Path]:
    """A segment and its lock file, as Fast DDS names them."""
    files = [folder / name, folder / f"{name}_el"]
    for file in files:
        file.write_bytes(b"")
    aged(*files)
    return files


def test_only_an_old_segment_that_nobody_locks_goes(tmp_path: Path) -> None:
    gone = make(tmp_path, "fastrtps_0123456789abcdef")
    held = make(tmp_path, "fastrtps_00000000000000aa")
    young = make(tmp_path, "fastrtps_00000000000000bb")
    os.utime(young[0])
    others = [*make(tmp_path, "fastrtps_port7411"), *make(tmp_path, "other_0123456789abcdef"),
              *make(tmp_path, "fastrtps_0123456789abcdefff")]  # fmt: skip
    alone = tmp_path / "fastrtps_00000000000000cc"  # without a lock file: who owns it cannot be told
    alone.touch()
    aged(alone)
    with held[1].open() as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert remove_abandoned_segments(tmp_path) == 1
        assert set(tmp_path.iterdir()) == {*held, *young, *others, alone}
    assert gone[0] not in tmp_path.iterdir()
    assert remove_abandoned_segments(tmp_path) == 1  # its owner has ended since
    assert remove_abandoned_segments(tmp_path / "missing") == 0


def test_links_and_what_is_no_file_are_not_followed(tmp_path: Path) -> None:
    target = tmp_path / "precious"
    target.write_text("kept")
    aged(target)
    segment, lock = make(tmp_path, "fastrtps_0123456789abcdef")
    segment.unlink()
    segment.symlink_to(target)
    assert remove_abandoned_segments(tmp_path) == 0
    os.mkfifo(tmp_path / "fastrtps_00000000000000aa")
    os.mkfifo(tmp_path / "fastrtps_00000000000000aa_el")
    aged(tmp_path / "fastrtps_00000000000000aa", tmp_path / "fastrtps_00000000000000aa_el")
    assert remove_abandoned_segments(tmp_path) == 0
    assert target.read_text() == "kept"
    assert lock.exists()


def segments_of(pid: int) -> set[Path]:
    """The segments that a process has mapped and locked itself."""
    mapped = {Path(line.split()[-1]) for line in Path(f"/proc/{pid}/maps").read_text().splitlines()
              if "/dev/shm/fastrtps_" in line and "port" not in line}  # fmt: skip
    opened = {file.readlink() for file in Path(f"/proc/{pid}/fd").iterdir() if file.is_symlink()}
    return {segment for segment in mapped if segment.with_name(f"{segment.name}_el") in opened}


def test_a_node_that_starts_removes_what_a_killed_one_has_left_and_nothing_else(
    graph: Graph, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(graph.environment, TRANSPORTS, "DEFAULT")  # with shared memory
    controls = graph.listen(ScalarStamped, "control")
    killed = graph.start("fopid_controller", {"kp": 1.0})
    graph.until(lambda: controls, "the controller")
    left = segments_of(killed.pid)
    ours = segments_of(os.getpid())
    assert left
    assert ours
    assert not left & ours
    os.kill(killed.pid, signal.SIGKILL)
    killed.wait(10)
    assert all(segment.exists() for segment in left)
    aged(*left, *(FOLDER / f"{segment.name}_el" for segment in left), *ours)
    again = graph.start("fopid_controller", {"kp": 1.0})
    graph.until(lambda: "controlling" in again.log.read_text(), "the next controller")
    assert not any(segment.exists() or segment.with_name(f"{segment.name}_el").exists() for segment in left)
    assert all(segment.exists() for segment in ours | segments_of(again.pid))


@pytest.mark.parametrize("reach", ["LOCALHOST", "OFF"])
@pytest.mark.parametrize(("transports", "shared"), [(None, False), ("DEFAULT", True)])
def test_a_node_keeps_out_of_shared_memory_where_nobody_says_otherwise(
    graph: Graph, monkeypatch: pytest.MonkeyPatch, reach: str, transports: str | None, shared: bool
) -> None:
    """There one that is killed may stop its neighbours for good."""
    monkeypatch.setitem(graph.environment, "ROS_AUTOMATIC_DISCOVERY_RANGE", reach)
    if transports is not None:
        monkeypatch.setitem(graph.environment, TRANSPORTS, transports)
    controls = graph.listen(ScalarStamped, "control")
    node = graph.start("fopid_controller", {"kp": 1.0})
    graph.until(lambda: controls if reach == "LOCALHOST" else "controlling" in node.log.read_text(), "the controller")
    assert bool(segments_of(node.pid)) == shared


@pytest.mark.parametrize("executable", ["plant_simulator", "fopid_tuner"])
def test_so_do_the_others(graph: Graph, executable: str) -> None:
    node = graph.start(executable, {"process": "P1"})
    graph.until(lambda: executable in graph.node.get_node_names(), "the node")
    assert not segments_of(node.pid)


def test_of_localhost_nothing_but_this_machine_is_heard(graph: Graph) -> None:
    """Out of shared memory, too, it listens at the loopback interface alone."""
    controls = graph.listen(ScalarStamped, "control")
    node = graph.start("fopid_controller", {"kp": 1.0})
    graph.until(lambda: controls, "the controller")
    ports = [each.laddr for each in psutil.net_connections("udp") if each.pid == node.pid]
    assert {address.ip for address in ports if address.port >= 7400} <= {"127.0.0.1"}
    assert ports
