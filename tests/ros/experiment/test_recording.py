"""Without rosbags an experiment is recorded by `ros2 bag record`, and without that one it runs all the same."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from fopid_core.cli.extras import EXTRA
from fopid_ros.experiment.recording import BAG_PACKAGES

from ..conftest import BIN, Graph

STEP = """
process: 1/(s+1)
name: step
gains: {kp: 1.0, ki: 1.0}
phases:
- {name: step, duration: 2.0, setpoint: 1.0}
"""

EXPERIMENT = """
import importlib.abc, sys
class Blocker(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {"rosbags", "mcap", "zstandard", "apsw", "backports"}:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Blocker())
from fopid_ros.experiment.command import main
sys.exit(main(sys.argv[1:]))
"""

# Listens like rosbag2, to reliable topics that somebody publishes, and notes what it was told and what it heard.
RECORDER = f"""#!{sys.executable}
import json, signal, sys
from importlib import import_module
from pathlib import Path
import rclpy
from rclpy.qos import QoSProfile
arguments = sys.argv[1:]
folder = Path(arguments[arguments.index("-o") + 1])
topics = arguments[arguments.index("--topics") + 1 :]
folder.mkdir()
heard, subscribed, ended = {{}}, {{}}, []
rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
signal.signal(signal.SIGINT, lambda *_: ended.append("SIGINT"))
node = rclpy.create_node("rosbag2_recorder")
while not ended:
    for name, types in node.get_topic_names_and_types():
        if name in topics and name not in subscribed and node.count_publishers(name):
            note = lambda _, name=name: heard.update({{name: heard.get(name, 0) + 1}})
            package, _, kind = types[0].split("/")
            kind = getattr(import_module(package + ".msg"), kind)
            subscribed[name] = node.create_subscription(kind, name, note, QoSProfile(depth=10_000))
    rclpy.spin_once(node, timeout_sec=0.02)
for _ in range(500):  # what waits in its queues
    rclpy.spin_once(node, timeout_sec=0.001)
Path(sys.argv[0]).with_name("noted.json").write_text(json.dumps([arguments, heard, ended]))
"""


def experiment(graph: Graph, folder: Path, path: str) -> subprocess.CompletedProcess[str]:
    lockstep = {"trigger": "lockstep", "sample_time": 0.05}
    graph.start("plant_simulator", {**lockstep, "process": "1/(s+1)", "advance_until": 0.0}, "-r", "__ns:=/a")
    graph.start("fopid_controller", {**lockstep, "kp": 1.0, "ki": 1.0, "use_sim_time": True}, "-r", "__ns:=/a")
    (folder / "step.yaml").write_text(STEP)
    command = [sys.executable, "-c", EXPERIMENT, folder / "step.yaml", "--out", folder / "run"]
    return subprocess.run([*command, "--ros-args", "-r", "__ns:=/a"], env={**graph.environment, "PATH": path},
                          capture_output=True, text=True, timeout=250, check=False)  # fmt: skip


def test_what_may_be_missing_is_what_the_extra_brings() -> None:
    assert {module for module, extra in EXTRA.items() if extra == "bags"} == BAG_PACKAGES


@pytest.mark.slow
def test_without_rosbags_ros2_bag_record_hears_every_sample(graph: Graph, tmp_path: Path) -> None:
    (tmp_path / "bin").mkdir()
    program = tmp_path / "bin" / "ros2"
    program.write_text(RECORDER)
    program.chmod(0o755)
    ended = experiment(graph, tmp_path, f"{program.parent}:{os.environ['PATH']}")
    assert ended.returncode == 0, ended.stderr + (tmp_path / "run" / "recording.log").read_text()
    assert ended.stderr.count("recording with `ros2 bag record`, because the Python package rosbags is not") == 1
    assert ended.stderr.count("no report, since the Python package") == 1
    assert "Traceback" not in ended.stderr
    arguments, heard, how = json.loads((program.parent / "noted.json").read_text())
    run = tmp_path / "run"
    assert arguments[:6] == ["bag", "record", "-s", "mcap", "-o", str(run / "bag")]
    assert arguments[6:8] == ["--qos-profile-overrides-path", str(run / "recording_qos.yaml")]
    assert {"/a/setpoint", "/a/measurement", "/a/control", "/a/fopid_controller/state"} <= set(arguments[9:])
    assert how == ["SIGINT"]
    assert min(heard[f"/a/{name}"] for name in ("measurement", "control", "fopid_controller/state")) >= 40


@pytest.mark.slow
@pytest.mark.parametrize("ros2", ["absent", "fails"])
def test_without_any_recorder_the_run_goes_on_and_says_so(graph: Graph, tmp_path: Path, ros2: str) -> None:
    path = os.pathsep.join(str(folder) for folder in (tmp_path, BIN) if not (folder / "ros2").exists())
    if ros2 == "fails":
        (tmp_path / "ros2").write_text("#!/bin/sh\necho invalid choice: bag\nexit 2\n")
        (tmp_path / "ros2").chmod(0o755)
        path = f"{tmp_path}:{path}"
    ended = experiment(graph, tmp_path, path)
    assert ended.returncode == 2
    told = [line for line in ended.stderr.splitlines() if line.startswith("warning")]
    expected = {"absent": "nothing is recorded", "fails": "`ros2 bag record` ended with code 2 before the experiment"}
    assert [expected[ros2] in line for line in told] == [True]
    assert "Traceback" not in ended.stderr
    assert "error" not in ended.stderr
    assert "2 of 2 s" in ended.stderr  # it ran to its end
