"""A publisher of another type than a node listens for is told of, in place of a mere "waiting"."""

from __future__ import annotations

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Float32

from ..conftest import Graph
from ..controller.fed import NAME, Diagnosed


@pytest.mark.slow
def test_the_controller_says_which_type_comes_and_which_it_listens_for(graph: Graph) -> None:
    graph.node.create_publisher(Float32, "measurement", 1)
    controller = Diagnosed(graph, {"kp": 1.0})
    controller.diagnosed(DiagnosticStatus.WARN, "waiting for setpoint and measurement")
    controller.diagnosed(
        DiagnosticStatus.WARN,
        f"measurement comes from {graph.node.get_fully_qualified_name()} as std_msgs/msg/Float32 and is not heard; "
        "allowed: fopid_msgs/msg/ScalarStamped, or measurement.type = std_msgs/msg/Float32",
    )
    assert NAME in controller.status.name
