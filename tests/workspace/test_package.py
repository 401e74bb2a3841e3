"""What describes the packages agrees with what is in them."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("fopid_core", "fopid_msgs", "fopid_ros")


def test_the_three_packages_have_one_version() -> None:
    versions = {ET.parse(ROOT / "src" / name / "package.xml").findtext("version") for name in PACKAGES}
    assert len(versions) == 1
    assert f"\nversion: {versions.pop()}\n" in (ROOT / "CITATION.cff").read_text()


@pytest.mark.parametrize("name", PACKAGES)
def test_each_package_says_what_quality_it_claims_and_what_is_missing(name: str) -> None:
    said = (ROOT / "src" / name / "QUALITY_DECLARATION.md").read_text()
    assert "**quality level 4**" in said
    assert "missing for level 3" in said


def test_every_message_is_built() -> None:
    folder = ROOT / "src" / "fopid_msgs"
    listed = set(re.findall(r"^\s+((?:msg|srv|action)/\w+\.\w+)$", (folder / "CMakeLists.txt").read_text(), re.M))
    there = {
        f"{path.parent.name}/{path.name}" for kind in ("msg", "srv", "action") for path in folder.glob(f"{kind}/*")
    }
    assert listed == there
