"""The launch files: what they start, and how they end when something is wrong.

ROS 2's packages ``launch`` and ``launch_ros`` are not on PyPI. Where they are missing, stand-ins record what the files
ask of them, and the tests that launch for real are skipped.
"""

from __future__ import annotations

import importlib.util
import runpy
import subprocess
import sys
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from fopid_core.errors import InputError
from fopid_ros.common import rivals

from ..conftest import Graph

ROOT = Path(__file__).parents[3]
FOLDER = ROOT / "src/fopid_ros/launch"
NODES = ["plant_simulator", "fopid_controller", "fopid_tuner"]
REAL = importlib.util.find_spec("launch_ros") is not None
needs_launch = pytest.mark.skipif(not REAL, reason="ROS 2's package launch_ros is not installed")


class Recorded:
    """Stands for any class of launch and launch_ros: keeps what it was made with."""

    given: dict[str, str]

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self.args, self.kwargs = args, kwargs

    def perform(self, _: Any) -> str:
        return self.given.get(self.args[0], "")


@pytest.fixture
def given(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[dict[str, str]]:
    """Arguments of a launch whose packages do nothing, on a graph without other loops."""
    names = {
        "launch": ["LaunchDescription"],
        "launch.actions": ["DeclareLaunchArgument", "OpaqueFunction", "RegisterEventHandler", "Shutdown"],
        "launch.event_handlers": ["OnProcessExit"], "launch.substitutions": ["LaunchConfiguration"],
        "launch_ros": [], "launch_ros.actions": ["LifecycleNode", "Node"],
    }  # fmt: skip
    values = {"log_level": "info", "use_sim_time": "false", "autostart": "true"}
    for module, classes in names.items():
        made = types.ModuleType(module)
        for name in classes:
            setattr(made, name, type(name, (Recorded,), {"given": values}))
        monkeypatch.setitem(sys.modules, module, made)
    monkeypatch.delitem(sys.modules, "fopid_ros.launching.actions", raising=False)
    monkeypatch.setattr("fopid_ros.common.rivals.refuse_running_loop", lambda *_: None)
    monkeypatch.chdir(tmp_path)
    yield values
    sys.modules.pop("fopid_ros.launching.actions", None)


def started(file: str) -> tuple[list[Any], list[Any]]:
    """Declared arguments of a launch file, and the nodes it starts."""
    (entities,) = runpy.run_path(str(FOLDER / file))["generate_launch_description"]().args
    declared = [one for one in entities if type(one).__name__ == "DeclareLaunchArgument"]
    return declared, entities[-1].kwargs["function"](None)


@pytest.mark.parametrize(
    ("file", "executables"),
    [
        ("loop.launch.py", NODES),
        ("demo.launch.py", [*NODES, "experiment"]),
        ("controller.launch.py", ["fopid_controller", "fopid_tuner"]),
        ("joints.launch.py", ["fopid_controller", "fopid_tuner"]),
        ("cascade.launch.py", ["plant_simulator", "plant_simulator", "fopid_controller", "fopid_controller"]),
    ],
)
def test_launch_files_start_executables_that_exist_and_describe_their_arguments(
    given: dict[str, str], tmp_path: Path, file: str, executables: list[str]
) -> None:
    given |= {"process": "2/(s+1)^3", "params_file": "", "namespace": "hall"}
    if file.startswith(("controller", "cascade")):
        given["params_file"] = str(ROOT / "config/P1.yaml")
    if file.startswith("joints"):
        given |= {"params_file": str(ROOT / "config/arm.yaml"), "dof": "wrist"}
    declared, nodes = started(file)
    assert [node.kwargs["executable"] for node in nodes] == executables
    assert {node.kwargs["namespace"].split("/")[file.startswith("cascade")] for node in nodes} == {"hall"}
    assert all(argument.kwargs["description"] for argument in declared)
    assert {"namespace", "log_level"} < {argument.args[0] for argument in declared}
    assert set(executables) <= set(runpy_executables())


def runpy_executables() -> list[str]:
    return [line.split('"')[1] for line in (ROOT / "src/fopid_ros/setup.py").read_text().splitlines()
            if line.startswith('    "') and '": "' in line]  # fmt: skip


def test_bad_input_is_one_line_before_anything_is_started(given: dict[str, str]) -> None:
    given["process"] = "1/(s+x)"
    for file in ("loop.launch.py", "demo.launch.py"):
        with pytest.raises(Exception, match="character 6") as failed:
            started(file)
        assert "\n" not in str(failed.value)


def test_a_loop_that_runs_is_found_before_anything_is_started(graph: Graph, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE"):
        monkeypatch.setenv(name, graph.environment[name])
    monkeypatch.setattr(rivals, "LOOK_TIME", 0.1)
    rivals.refuse_running_loop()
    graph.start("plant_simulator", {}, "-r", "__node:=oven", "-r", "__ns:=/hall")
    graph.until(lambda: graph.node.count_publishers("/hall/measurement"), "the plant")
    rivals.refuse_running_loop()
    monkeypatch.setattr(rivals, "LOOK_TIME", 30.0)
    with pytest.raises(InputError, match=rf"domain {graph.domain} is in use: 'measurement' is published by /hall/oven"):
        rivals.refuse_running_loop(["-r", "__ns:=/hall"])


def launch(graph: Graph, file: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """``ros2 launch fopid_ros file arguments``, without the command."""
    code = (
        "import sys; from launch import LaunchService; from launch.actions import IncludeLaunchDescription as Include\n"
        "from launch.launch_description_sources import AnyLaunchDescriptionSource as Source\n"
        "service = LaunchService(argv=sys.argv[2:])\n"
        "given = [tuple(one.split(':=', 1)) for one in sys.argv[2:]]\n"
        "service.include_launch_description(Include(Source(sys.argv[1]), launch_arguments=given))\n"
        "sys.exit(service.run())\n"
    )
    command = [sys.executable, "-c", code, str(FOLDER / file), *arguments]
    return subprocess.run(command, env=graph.environment, stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT, text=True, timeout=250, check=False)  # fmt: skip


@needs_launch
@pytest.mark.parametrize("file", ["loop.launch.py", "controller.launch.py"])
def test_a_node_with_bad_input_ends_the_launch(graph: Graph, tmp_path: Path, file: str) -> None:
    bad = tmp_path / "bad.yaml"
    bad.write_text("/**/fopid_controller:\n  ros__parameters:\n    kp: 1.0\n    lam: 5.0\n")
    ended = launch(graph, file, f"params_file:={bad}")
    assert ended.returncode == 1
    assert "error: lam = 5.0; allowed: 0 to 2" in ended.stdout
    assert "fopid_controller-" in ended.stdout
    assert "ended with exit code 2: its message stands above" in ended.stdout


@needs_launch
def test_a_loop_that_runs_ends_the_launch_of_another(graph: Graph) -> None:
    graph.start("plant_simulator", {})
    graph.until(lambda: graph.node.count_publishers("/measurement"), "the plant")
    for file in ("demo.launch.py", "loop.launch.py"):
        ended = launch(graph, file)
        assert ended.returncode == 1
        assert "is in use: 'measurement' is published by /plant_simulator" in ended.stdout
        assert "process started" not in ended.stdout
