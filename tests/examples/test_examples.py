"""Every example runs as its README says."""

from __future__ import annotations

from pathlib import Path

import pytest

from ..docs.markdown import run
from ..ros.conftest import own_domain

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
ELSEWHERE = ("plants", "paper_in_a_page")
"""Examples with tests of their own; the paper's line is one of tests/core/cli/test_verbs.py."""

WITH_ROS = {
    "own_plant": "level",
    "real_sensor": "oven",
    "two_loops": "'oven'",
}
PLAIN = {
    "transfer_function_to_gains": "max |S| = 1.",
    "csv_to_gains": "FOPID IAE",
    "pid_against_fopid": "9/((s+1)(s^2+2s+9))",
    "python_control": "distance from the exact response: 0.0",
    "certificate_for_a_box": "",
    "c_on_a_microcontroller": "after 30 s",
    "notebook": "",
}
"""Folder -> what its lines print."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder that looks like the root of the tree."""
    for name in ("examples", "config"):
        (tmp_path / name).symlink_to(ROOT / name)
    return tmp_path


def test_every_example_has_its_readme_and_those_run_here_are_listed() -> None:
    there = {path.name for path in EXAMPLES.iterdir() if path.is_dir()}
    assert all((EXAMPLES / name / "README.md").exists() for name in there)
    assert {*WITH_ROS, *PLAIN, *ELSEWHERE} <= there
    listed = (EXAMPLES / "README.md").read_text()
    assert all(f"[{name}]({name}/README.md)" in listed for name in (*WITH_ROS, *PLAIN, *ELSEWHERE))


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", sorted(PLAIN))
def test_example(name: str, folder: Path) -> None:
    assert PLAIN[name] in run(EXAMPLES / name / "README.md", folder)


@pytest.mark.slow
@pytest.mark.ros
@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", sorted(WITH_ROS))
def test_example_with_ros(name: str, folder: Path) -> None:
    with own_domain() as domain:
        surroundings = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        assert WITH_ROS[name] in run(EXAMPLES / name / "README.md", folder, surroundings)
