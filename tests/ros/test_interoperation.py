"""The files that put a controller in the place of another make's."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from fopid_ros.controller.parameters import SPECS

from .conftest import Graph

CONFIG = Path(__file__).parents[2] / "config"


def remappings() -> list[str]:
    """What the line in the file's own comment gives."""
    lines = (CONFIG / "pid_controller.remap").read_text().splitlines()
    return [word for line in lines if not line.startswith("#") for word in line.split()]


@pytest.mark.slow
def test_the_remap_file_gives_the_topics_of_pid_controller(graph: Graph) -> None:
    graph.start("fopid_controller", {}, *remappings())
    for topic in ("/pid_controller/reference", "/pid_controller/measured_state"):
        graph.until(lambda topic=topic: graph.node.count_subscribers(topic), topic)
    assert not graph.node.count_subscribers("/setpoint")


def test_the_parameter_file_names_parameters_that_exist_and_the_messages_of_pid_controller() -> None:
    ((_, node),) = yaml.safe_load((CONFIG / "pid_controller.yaml").read_text()).items()
    given = node["ros__parameters"]
    assert set(given) <= {spec.name for spec in SPECS}
    assert given["setpoint.type"] == given["measurement.type"] == "control_msgs/msg/MultiDOFCommand"
