"""What describes the packages agrees with what is in them."""

from __future__ import annotations

import re
import runpy
import sys
import types
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("fopid_core", "fopid_msgs", "fopid_ros")


def test_the_three_packages_have_one_version() -> None:
    versions = {ET.parse(ROOT / "src" / name / "package.xml").findtext("version") for name in PACKAGES}
    assert len(versions) == 1


def test_every_message_is_built() -> None:
    folder = ROOT / "src" / "fopid_msgs"
    listed = set(re.findall(r"^\s+((?:msg|srv|action)/\w+\.\w+)$", (folder / "CMakeLists.txt").read_text(), re.M))
    there = {
        f"{path.parent.name}/{path.name}" for kind in ("msg", "srv", "action") for path in folder.glob(f"{kind}/*")
    }
    assert listed == there


class Recorded:
    """Stands for any class of launch and launch_ros: keeps what it was made with."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self.args, self.kwargs = args, kwargs

    def perform(self, _: Any) -> str:
        return "P4"


@pytest.fixture
def launch_modules(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The launch packages are not on PyPI: names as in ROS 2 Jazzy, behind which nothing happens."""
    names = {
        "launch": ["LaunchDescription"],
        "launch.actions": ["DeclareLaunchArgument", "OpaqueFunction", "Shutdown"],
        "launch.substitutions": ["LaunchConfiguration", "PathJoinSubstitution"],
        "launch_ros": [], "launch_ros.actions": ["Node"], "launch_ros.substitutions": ["FindPackageShare"],
    }  # fmt: skip
    for module, classes in names.items():
        made = types.ModuleType(module)
        for name in classes:
            setattr(made, name, type(name, (Recorded,), {}))
        monkeypatch.setitem(sys.modules, module, made)
    monkeypatch.chdir(tmp_path)


@pytest.mark.usefixtures("launch_modules")
def test_launch_files_start_executables_that_exist() -> None:
    setup = (ROOT / "src/fopid_ros/setup.py").read_text()
    folder = ROOT / "src/fopid_ros/launch"
    (loop,) = runpy.run_path(str(folder / "loop.launch.py"))["generate_launch_description"]().args
    demo = runpy.run_path(str(folder / "demo.launch.py"))
    demo["generate_launch_description"]()
    nodes = [*loop[1:], *demo["start"](None)]
    executables = [node.kwargs["executable"] for node in nodes]
    assert executables == ["plant_simulator", "fopid_controller", "fopid_tuner"] * 2 + ["experiment"]
    for executable in executables:
        assert f'"{executable}"' in setup
    assert Path(nodes[-1].kwargs["arguments"][0]).is_file()
