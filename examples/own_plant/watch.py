"""Wait until the level is within a tenth of 2 m."""

import sys

import rclpy
from rclpy.node import Node

from fopid_msgs.msg import ScalarStamped

rclpy.init()
node = Node("watch")
levels = []
node.create_subscription(ScalarStamped, "measurement", lambda message: levels.append(message.value), 10)
begun = node.get_clock().now()
while not levels or abs(levels[-1] - 2.0) > 0.1:
    rclpy.spin_once(node, timeout_sec=1.0)
    if (node.get_clock().now() - begun).nanoseconds > 90e9:
        sys.exit(f"the level is {levels[-1:]} m")
print(f"level {levels[-1]:.2f} m")
