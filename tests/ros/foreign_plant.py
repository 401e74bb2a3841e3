"""A plant that knows nothing of this package: a plain node with plain messages, run as ``foreign_plant.py KIND``.

All are about ten times as fast as what process engineers meet, so that tests do not last.
"""

from __future__ import annotations

import math
import sys
import time
from collections import deque

import numpy as np
import rclpy
from rclpy._rclpy_pybind11 import RCLError
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import Float64

TICK = 0.01
SUBSTEPS = 5


class Foreign(Node):
    """Publishes ``sensor`` at 100 Hz, follows ``actuator``."""

    def __init__(self, kind: str, seed: int = 1) -> None:
        super().__init__("foreign_plant")
        self._step = getattr(self, f"_{kind}")
        self._state = np.array([1.0, 0.0, 0.0]) if kind == "tank" else np.zeros(3)
        self._actuator = 0.5 if kind == "tank" else 0.0
        self._noise = np.random.default_rng(seed)
        self._past: deque[float] = deque([0.0] * 250, maxlen=250)
        self._publisher = self.create_publisher(Float64, "sensor", 10)
        self.create_subscription(Float64, "actuator", self._heard, 10)
        self._time = time.monotonic()
        self.create_timer(TICK, self._tick)

    def _heard(self, message: Float64) -> None:
        self._actuator = message.data

    def _tick(self) -> None:
        # A plant does not wait for a late timer: what has passed is made up for.
        while self._time < time.monotonic():
            self._time += TICK / SUBSTEPS
            self._past.append(self._actuator)
            self._state = self._state + TICK / SUBSTEPS * np.array(self._step(self._state, self._actuator))
        self._publisher.publish(Float64(data=float(self._sensor())))

    def _sensor(self) -> float:
        if self._step == self._quantised:
            return round(self._state[0] / 0.01) * 0.01
        return self._state[0] + 0.002 * self._noise.standard_normal()

    def _tank(self, x: np.ndarray, u: float) -> tuple[float, float, float]:
        """Level of a tank with outflow by gravity behind a valve: the gain depends on the level."""
        return (x[1] - 0.5 * math.sqrt(max(x[0], 0.0))) / 0.5, (max(u, 0.0) - x[1]) / 0.05, 0.0

    def _saturating(self, x: np.ndarray, u: float) -> tuple[float, float, float]:
        """Second order behind an actuator that gives no more than 1.5 either way."""
        return (x[1] - x[0]) / 0.4, (min(max(u, -1.5), 1.5) - x[1]) / 0.1, 0.0

    def _quantised(self, x: np.ndarray, u: float) -> tuple[float, float, float]:
        """Second order, measured in steps of 0.01."""
        return (2.0 * x[1] - x[0]) / 0.3, (u - x[1]) / 0.1, 0.0

    def _dead_band(self, x: np.ndarray, u: float) -> tuple[float, float, float]:
        """First order behind an actuator that does not feel the first 0.05."""
        felt = math.copysign(max(abs(u) - 0.05, 0.0), u)
        return (x[1] - x[0]) / 0.3, (felt - x[1]) / 0.08, 0.0

    def _integrating(self, x: np.ndarray, u: float) -> tuple[float, float, float]:
        """A motor's position."""
        return x[1], (u - x[1]) / 0.1, 0.0

    def _oscillating(self, x: np.ndarray, u: float) -> tuple[float, float, float]:
        """A pendulum in the plane: damping 0.08 at 6 rad/s."""
        return x[1], 36.0 * (u - x[0]) - 0.96 * x[1], 0.0

    def _delayed(self, x: np.ndarray, _: float) -> tuple[float, float, float]:
        """A delay of 0.5 s, ten times the lag."""
        return (self._past[0] - x[0]) / 0.05, 0.0, 0.0

    def _reversed(self, x: np.ndarray, u: float) -> tuple[float, float, float]:
        """Cooling: more control, less measurement."""
        return (-1.5 * x[1] - x[0]) / 0.4, (u - x[1]) / 0.1, 0.0

    def _stuck(self, _x: np.ndarray, _u: float) -> tuple[float, float, float]:
        """An actuator that does not move."""
        return 0.0, 0.0, 0.0


def main() -> None:
    rclpy.init()
    try:
        rclpy.spin(Foreign(sys.argv[1]))
    except (KeyboardInterrupt, ExternalShutdownException, RCLError):
        return


if __name__ == "__main__":
    main()
