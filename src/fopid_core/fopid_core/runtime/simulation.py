"""Controller and plant in lockstep without ROS: the reference for the trace of the ROS loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fopid_core.drawing import draw_over_time
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.convolved_plant import AnyPlant

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Signal = Callable[[int], float]
"""A signal by the number of the sample."""

Action = Callable[[FopidController, AnyPlant], None]
"""What is done to the loop between two samples."""


@dataclass(frozen=True)
class Trace:
    """The loop's signals at samples 0 ... n-1; each array has shape (n,)."""

    time: NDArray[np.float64]
    setpoint: NDArray[np.float64]
    measurement: NDArray[np.float64]
    control: NDArray[np.float64]

    def plot(self, figure: Figure | None = None, label: str = "", title: str = "") -> Figure:
        """Setpoint and measurement, and the control, over time, into a figure of another trace where one is given."""
        wanted = {"setpoint": (self.time, self.setpoint)} if figure is None else {}
        rows = [
            ("measurement", {**wanted, label or "measurement": (self.time, self.measurement)}),
            ("control", {label: (self.time, self.control)}),
        ]
        return draw_over_time(rows, figure, title, steps=True)

    def __repr__(self) -> str:
        return f"<Trace: {self.time.size} samples to {self.time[-1]:g} s>"


def simulate(
    controller: FopidController,
    plant: AnyPlant,
    samples: int,
    setpoint: Signal,
    disturbance: Signal = lambda _: 0.0,
    actions: Mapping[int, Action] | None = None,
) -> Trace:
    """Run y_k -> u_k -> y_(k+1) for a number of samples.

    Parameters
    ----------
    controller, plant
        As they are; they are left as they are at the end.
    samples : int
        How many ticks.
    setpoint, disturbance : callable
        Value at sample k.
    actions : mapping, optional
        Sample number -> what to do just before the tick of that sample, for instance new gains.

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> from fopid_core.model.process import Process
    >>> from fopid_core.runtime.controller import ControllerSettings
    >>> from fopid_core.runtime.plant import Plant, PlantSettings
    >>> controller = FopidController(ControllerSettings(Fopid(kp=1.0, ki=1.0)))
    >>> plant = Plant(PlantSettings(Process.parse("1/(s+1)")))
    >>> bool(abs(simulate(controller, plant, 1000, lambda _: 1.0).measurement[-1] - 1.0) < 0.01)
    True
    """
    h = plant.settings.sample_time
    rows = np.empty((samples, 4))
    for k in range(samples):
        if actions and k in actions:
            actions[k](controller, plant)
        wanted, measured = setpoint(k), plant.measurement
        control = controller.step(wanted, measured)
        rows[k] = (k * h, wanted, measured, control)
        plant.step(control, disturbance(k))
    return Trace(*rows.T.copy())
