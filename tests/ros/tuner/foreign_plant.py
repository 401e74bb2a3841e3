"""A plant that knows nothing of this package, a plain node with plain messages: ``foreign_plant.py KIND [steps]``.

All are about ten times as fast as what process engineers meet, so that tests do not last. With ``steps`` the plant owns
``/clock`` and waits for the answer to each of its samples: however busy the machine is, its time is not disturbed.
"""

from __future__ import annotations

import math
import sys
import time
from collections import deque

import numpy as np
import rclpy
from rclpy._rclpy_pybind11 import RCLError
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Temperature
from std_msgs.msg import Float64

TICK = 0.01
SUBSTEPS = 5
SPEED, ASK_AGAIN = 2.0, 0.2


class Foreign(Node):
    """A plant with a ``sensor``, that follows ``actuator``."""

    def __init__(self, kind: str, seed: int = 1) -> None:
        super().__init__("foreign_plant")
        self._step = getattr(self, f"_{kind}")
        self._state = np.array([1.0, 0.0, 0.0]) if kind == "tank" else np.zeros(3)
        self._actuator = 0.5 if kind == "tank" else 0.0
        self._noise = np.random.default_rng(seed)
        self._past: deque[float] = deque([0.0] * 250, maxlen=250)
        self._drift = 0.0
        self.create_subscription(Float64, "drift", self._drifted, 1)

    def _drifted(self, message: Float64) -> None:
        self._drift = message.data

    def _go_on(self) -> None:
        """One substep."""
        self._past.append(self._actuator)
        self._state = self._state + TICK / SUBSTEPS * np.array(self._step(self._state, self._actuator))

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

    def _drifting(self, x: np.ndarray, _: float) -> tuple[float, float, float]:
        """Second order and a delay; told so, its gain doubles and its delay grows by half."""
        back = round(0.06 * (1.0 + 0.5 * self._drift) / (TICK / SUBSTEPS))
        return (x[1] - x[0]) / 0.3, ((1.0 + self._drift) * self._past[-back] - x[1]) / 0.1, 0.0

    def _reversed(self, x: np.ndarray, u: float) -> tuple[float, float, float]:
        """Cooling: more control, less measurement."""
        return (-1.5 * x[1] - x[0]) / 0.4, (u - x[1]) / 0.1, 0.0

    def _stuck(self, _x: np.ndarray, _u: float) -> tuple[float, float, float]:
        """An actuator that does not move."""
        return 0.0, 0.0, 0.0


class RealTime(Foreign):
    """Publishes bare numbers at 100 Hz."""

    def __init__(self, kind: str) -> None:
        super().__init__(kind)
        self._time = time.monotonic()
        self._publisher = self.create_publisher(Float64, "sensor", 10)
        self.create_subscription(Float64, "actuator", self._heard, 10)
        self.create_timer(TICK, self._tick)

    def _heard(self, message: Float64) -> None:
        self._actuator = message.data

    def _tick(self) -> None:
        # A plant does not wait for a late timer: what has passed is made up for.
        while self._time < time.monotonic():
            self._time += TICK / SUBSTEPS
            self._go_on()
        self._publisher.publish(Float64(data=float(self._sensor())))


class InSteps(Foreign):
    """Publishes stamped samples and the time, twice as fast as real time at most, each after the answer to the last."""

    def __init__(self, kind: str) -> None:
        super().__init__(kind)
        self._now = self._asked = 0.0
        self._sample = Temperature(temperature=float(self._sensor()))
        self._answered = True
        self._publisher = self.create_publisher(Temperature, "sensor", 10)
        self._clock_publisher = self.create_publisher(Clock, "/clock", 10)
        self.create_subscription(Temperature, "actuator", self._heard, 10)
        self.create_timer(TICK / SPEED, self._tick)

    def _heard(self, message: Temperature) -> None:
        if message.header.stamp == self._sample.header.stamp:
            self._actuator, self._answered = message.temperature, True

    def _tick(self) -> None:
        if self._answered:
            for _ in range(SUBSTEPS):
                self._go_on()
            self._now += TICK
            stamp = Duration(seconds=self._now).to_msg()
            self._sample = Temperature(temperature=float(self._sensor()))
            self._sample.header.stamp.sec, self._sample.header.stamp.nanosec = stamp.sec, stamp.nanosec
            self._clock_publisher.publish(Clock(clock=self._sample.header.stamp))
            self._answered = False
        elif time.monotonic() < self._asked + ASK_AGAIN:
            return
        self._asked = time.monotonic()
        self._publisher.publish(self._sample)


def main() -> None:
    kind, *steps = sys.argv[1:]
    rclpy.init()
    try:
        rclpy.spin((InSteps if steps else RealTime)(kind))
    except (KeyboardInterrupt, ExternalShutdownException, RCLError):
        return


if __name__ == "__main__":
    main()
