"""A tank that drains by the square root of its level: a plant of one's own, as a node."""

import contextlib
import math

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from fopid_msgs.msg import ScalarStamped

PERIOD = 0.05  # [s]


class Tank(Node):
    """Takes the inflow from ``control``, publishes the level as ``measurement``."""

    def __init__(self) -> None:
        super().__init__("tank")
        self.level = 1.0  # [m]
        self.inflow = 1.0
        self.publisher = self.create_publisher(ScalarStamped, "measurement", 1)
        self.create_subscription(ScalarStamped, "control", self.on_control, 1)
        self.create_timer(PERIOD, self.on_timer)

    def on_control(self, message: ScalarStamped) -> None:
        """Take the newest control; a pump cannot suck."""
        self.inflow = min(max(message.value, 0.0), 3.0)

    def on_timer(self) -> None:
        """Drain, fill, tell the level with the time it was read at."""
        self.level = max(self.level + PERIOD * (self.inflow - math.sqrt(self.level)), 0.0)
        message = ScalarStamped(value=self.level)
        message.header.stamp = self.get_clock().now().to_msg()
        self.publisher.publish(message)


if __name__ == "__main__":
    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(Tank())
