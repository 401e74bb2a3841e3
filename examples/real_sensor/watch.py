"""Wait until the oven is within 2 degrees of 80 degC."""

import sys

import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Temperature

rclpy.init()
node = Node("watch")
oven = []
node.create_subscription(
    Temperature, "measurement", lambda message: oven.append(message.temperature), qos_profile_sensor_data
)
begun = node.get_clock().now()
while not oven or abs(oven[-1] - 80.0) > 2.0:
    rclpy.spin_once(node, timeout_sec=1.0)
    if (node.get_clock().now() - begun).nanoseconds > 90e9:
        sys.exit(f"the oven is at {oven[-1:]} degC")
print(f"oven {oven[-1]:.1f} degC")
