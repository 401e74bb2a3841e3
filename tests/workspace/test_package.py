"""What describes the packages agrees with what is in them."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree as ET

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
