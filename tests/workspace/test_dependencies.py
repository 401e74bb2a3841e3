"""What package.xml and setup.py ask for exists, and is what the sources import."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from fopid_core.cli.extras import EXTRA

ROOT = Path(__file__).parents[2]
PACKAGES = ("fopid_core", "fopid_msgs", "fopid_ros")
KEYS = {
    line for line in Path(__file__).with_name("rosdep_keys.txt").read_text().splitlines() if not line.startswith("#")
}
# Where module and key do not have the same name.
KEY_OF = {"lark": "python3-lark-parser", "yaml": "python3-yaml"}
# What ROS 2 itself depends on wherever there is an rclpy or an action.
ALWAYS = {"builtin_interfaces", "action_msgs", "ament_index_python"}
OPTIONAL = set(EXTRA) - {"yaml", "matplotlib"}
TOLD_BY_ONE_LINE = {"rich", "tornado", *OPTIONAL, "matplotlib", "click"}


def manifest(package: str) -> ET.Element:
    return ET.parse(ROOT / "src" / package / "package.xml").getroot()


def depends(package: str) -> set[str]:
    return {str(item.text) for item in manifest(package) if item.tag.endswith("depend")}


def imports(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (name.name.partition(".")[0] for name in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield str(node.module).partition(".")[0]


@pytest.mark.parametrize("package", PACKAGES)
def test_rosdep_knows_every_key(package: str) -> None:
    unknown = depends(package) - KEYS - set(PACKAGES)
    assert not unknown, "look it up in rosdistro, then add it to rosdep_keys.txt"


@pytest.mark.parametrize("package", ["fopid_core", "fopid_ros"])
def test_every_import_of_a_package_is_in_its_package_xml_or_an_extra(package: str) -> None:
    files = [*(ROOT / "src" / package / package).rglob("*.py"), *(ROOT / "src" / package / "launch").glob("*.py")]
    assert files
    found = {name: path for path in files for name in imports(path)}
    own = {package, "__future__", *sys.stdlib_module_names, "compression", *ALWAYS, *OPTIONAL}
    asked = depends(package)
    lacking = {
        name: str(path.relative_to(ROOT))
        for name, path in found.items()
        if name not in own and name not in asked and KEY_OF.get(name, f"python3-{name}") not in asked
    }
    assert not lacking


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_is_whole_by_itself(package: str) -> None:
    folder = ROOT / "src" / package
    assert [path for path in folder.rglob("*") if path.is_symlink()] == []
    assert (folder / "LICENSE").read_text() == (ROOT / "LICENSE").read_text()
    assert f"Changelog for package {package}" in (folder / "CHANGELOG.rst").read_text()
    root = manifest(package)
    assert {item.get("type") for item in root.iter("url")} == {"website", "bugtracker", "repository"}
    assert re.fullmatch(r"[\w.]+@[\w.]+", str(root.find("maintainer").get("email")))  # type: ignore[union-attr]


@pytest.mark.slow
@pytest.mark.parametrize("package", ["fopid_core", "fopid_ros"])
def test_the_source_distribution_holds_every_file_of_the_package(package: str, tmp_path: Path) -> None:
    import tarfile

    command = [sys.executable, "setup.py", "-q", "egg_info", "-e", str(tmp_path), "sdist", "-d", str(tmp_path)]
    subprocess.run(command, cwd=ROOT / "src" / package, check=True, capture_output=True)
    (archive,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(archive) as made:
        held = {name.partition("/")[2] for name in made.getnames()}
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT / "src" / package, check=True, capture_output=True, text=True)
    assert set(listed.stdout.split()) - held == set()


BLOCKED = """
import importlib.abc, json, sys
class Blocker(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in blocked:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
blocked = set(json.loads(sys.argv[1]))
sys.meta_path.insert(0, Blocker())
"""


@pytest.mark.parametrize(
    ("module", "with_", "more"),
    [
        ("controller.node", "numpy, yaml, rclpy", {"scipy", "lark"}),
        ("plant.node", "what apt brings", set()),
        ("tuner.node", "what apt brings", set()),
    ],
)
def test_a_robots_nodes_start_with_little(module: str, with_: str, more: set[str]) -> None:
    blocked = json.dumps(sorted(TOLD_BY_ONE_LINE | more))
    code = f"{BLOCKED}\nimport fopid_ros.{module}\n"
    done = subprocess.run([sys.executable, "-c", code, blocked], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
