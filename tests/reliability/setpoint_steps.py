"""Steps of a setpoint for ever: ``setpoint_steps.py LOW HIGH PERIOD``, as plain numbers."""

from __future__ import annotations

import itertools
import sys
import time

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64

if __name__ == "__main__":
    low, high, period = map(float, sys.argv[1:])
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node("steps")
    publisher = node.create_publisher(Float64, "setpoint", 1)
    for value in itertools.cycle((low, high)):
        publisher.publish(Float64(data=value))
        time.sleep(period)
