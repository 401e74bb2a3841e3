"""A simulated plant that is not active stands still, whatever comes."""

from __future__ import annotations

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState

from fopid_msgs.msg import ScalarStamped

from ..conftest import Graph

NAME = "plant_simulator"


def test_a_plant_that_was_shut_down_sends_no_more_measurements(graph: Graph) -> None:
    graph.start(NAME, {"process": "1/(s+1)", "sample_time": 0.02})
    heard = graph.listen(ScalarStamped, "measurement")
    graph.until(lambda: heard, "measurements")
    request = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_ACTIVE_SHUTDOWN))
    assert graph.call(ChangeState, f"{NAME}/change_state", request).success
    graph.spin(0.3)  # what was on its way
    before = len(heard)
    graph.spin(1.0)
    assert len(heard) == before
