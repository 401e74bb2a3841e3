"""Plant simulator, controller and tuner in real time.

``ros2 launch fopid_ros loop.launch.py process:="2/(s+1)^3"``
"""

from fopid_ros.launching.actions import (
    PROCESS,
    alone,
    argument,
    common_arguments,
    given,
    launch_description,
    managed_node,
)
from fopid_ros.launching.loop import loop_parameters


def start(context):
    """The three nodes, when no other loop is on their topics."""
    parameters = loop_parameters(given(context, "process"), given(context, "params_file"))
    alone(context)
    return [managed_node(context, name, own) for name, own in parameters.items()]


def generate_launch_description():
    """Start the three nodes of a loop."""
    file = "parameter file for all nodes; empty: of P1 ... P4 their own, else a PI that is proved stable"
    return launch_description(
        start,
        argument("process", "", f"{PROCESS}; empty: what params_file says, P1 without one"),
        argument("params_file", "", file),
        *common_arguments(),
    )
