"""Wait until each loop is within a tenth of its own setpoint."""

import sys
from functools import partial

import rclpy
from rclpy.node import Node

from fopid_msgs.msg import ScalarStamped

SETPOINTS = {"oven": 5.0, "pump": -3.0}

rclpy.init()
node = Node("watch")
newest: dict[str, float] = {}
for loop in SETPOINTS:
    # One argument only: with two, rclpy would pass what it knows of the message as the second.
    take = partial(lambda loop, message: newest.update({loop: message.value}), loop)
    node.create_subscription(ScalarStamped, f"/{loop}/measurement", take, 10)
begun = node.get_clock().now()
while any(abs(newest.get(loop, 1e9) - setpoint) > 0.1 for loop, setpoint in SETPOINTS.items()):
    rclpy.spin_once(node, timeout_sec=1.0)
    if (node.get_clock().now() - begun).nanoseconds > 90e9:
        sys.exit(f"the loops are at {newest}")
print(newest)
