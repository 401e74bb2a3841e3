"""Every tutorial runs as it is written."""

from __future__ import annotations

from pathlib import Path

import pytest

from ..ros.conftest import own_domain
from .markdown import run

ROOT = Path(__file__).parents[2]
TUTORIALS = ROOT / "docs" / "tutorials"

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder that looks like the root of the tree to a command of a page."""
    for name in ("examples", "config"):
        (tmp_path / name).symlink_to(ROOT / name)
    return tmp_path


def test_student(folder: Path) -> None:
    told = run(TUTORIALS / "student.md", folder)
    assert told.count("success         yes") == 2
    for name in ("first.png", "compared.png", "runs/loop/report.html", "runs/loop/trace.csv"):
        assert (folder / name).stat().st_size > 5000


@pytest.mark.ros
@pytest.mark.long
def test_ros_joint(folder: Path) -> None:
    with own_domain() as domain:
        surroundings = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        told = run(TUTORIALS / "ros_joint.md", folder, surroundings)
    assert "(running)" in told
    (report,) = (folder / "runs").glob("elbow-*/report.html")
    assert report.stat().st_size > 5000


def test_step_test(folder: Path) -> None:
    run(TUTORIALS / "step_test.md", folder)
    page = (folder / "heater.html").read_text()
    assert page.count("<img") == 3
    for words in ("PID", "Standard form", "Series form", "Ti_min"):
        assert words in page
    assert (folder / "fit.png").stat().st_size > 10_000
