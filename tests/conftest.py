"""How the tests share the cores when they run in parallel."""

from __future__ import annotations

from pathlib import Path

import pytest

ROS = Path(__file__).parent / "ros"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Keep the tests of a file on one worker, and all that start ROS nodes on one: they share the loopback.

    Discovery and timers may lose against a busy neighbour on the machine: what runs nodes is tried once more when
    it fails, and the summary counts that as a rerun.
    """
    for item in items:
        over_ros = ROS in item.path.parents
        if over_ros:
            item.add_marker(pytest.mark.ros)
            item.add_marker(pytest.mark.flaky(reruns=1))
        item.add_marker(pytest.mark.xdist_group("ros" if over_ros else str(item.path)))
