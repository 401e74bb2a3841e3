"""package.xml is what its schema says; the linter comes with ROS 2, not from PyPI."""

from pathlib import Path

import pytest


@pytest.mark.linter
@pytest.mark.xmllint
def test_package_xml_follows_its_schema() -> None:
    linter = pytest.importorskip("ament_xmllint.main", reason="ament_xmllint comes with ROS 2")
    assert linter.main(argv=[str(Path(__file__).parents[1])]) == 0
