"""A plant as a node of its own: ``python examples/plants/node.py level_tank [SEED] [--ros-args ...]``.

It has its own clock and no message but ``std_msgs/Float64``: it publishes ``sensor``, hears ``actuator`` and ``load``.
With the parameter ``speed`` it is that much faster than real time, and publishes ``/clock``.
"""

from __future__ import annotations

import argparse
import sys
import time

import rclpy
from builtin_interfaces.msg import Time
from foreign_plants.gallery import DRAWN, GALLERY, known_plants
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.utilities import remove_ros_args
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64


class ForeignPlant(Node):
    """Publishes a reading at each sample time of its exhibit."""

    def __init__(self, name: str, seed: int) -> None:
        super().__init__("foreign_plant")
        exhibit = GALLERY[name]
        self._plant, self._sample_time = exhibit.plant(seed), exhibit.sample_time
        self._control, self._now = self._plant.control_at_rest, 0.0
        self._speed = float(self.declare_parameter("speed", 1.0).value)
        self._readings = self.create_publisher(Float64, "sensor", 10)
        self._clock_publisher = self.create_publisher(Clock, "/clock", 10) if self._speed != 1.0 else None
        self.create_subscription(Float64, "actuator", self._on_control, 10)
        self.create_subscription(Float64, "load", self._on_load, 10)
        self._began = time.monotonic()
        self.create_timer(self._sample_time / self._speed, self._tick)

    def _on_control(self, message: Float64) -> None:
        self._control = message.data

    def _on_load(self, message: Float64) -> None:
        self._plant.load = message.data

    def _tick(self) -> None:
        """A plant does not wait for a late timer: what has passed is made up for."""
        while self._now < (time.monotonic() - self._began) * self._speed:
            self._plant.step(self._control, self._sample_time)
            self._now += self._sample_time
            if self._clock_publisher is not None:
                stamp = Duration(seconds=self._now).to_msg()
                self._clock_publisher.publish(Clock(clock=Time(sec=stamp.sec, nanosec=stamp.nanosec)))
        self._readings.publish(Float64(data=self._plant.measurement))


def main() -> None:
    """Run until stopped."""
    parser = argparse.ArgumentParser(description="A foreign plant as a node.")
    parser.add_argument(
        "plant", metavar="PLANT", help=f"one of {', '.join(known_plants())}, or {DRAWN}0, {DRAWN}1, ..."
    )
    parser.add_argument("seed", nargs="?", type=int, default=0, help="of the sensor's noise")
    given = parser.parse_args(remove_ros_args(sys.argv)[1:])
    if given.plant not in known_plants() and not given.plant.removeprefix(DRAWN).isdigit():
        parser.error(f"plant {given.plant!r}; allowed: {', '.join(known_plants())}, or {DRAWN} and a number")
    rclpy.init(args=sys.argv)
    try:
        rclpy.spin(ForeignPlant(given.plant, given.seed))
    except (KeyboardInterrupt, ExternalShutdownException):
        return


if __name__ == "__main__":
    main()
