"""What the running loop shows beside its process, for a tuning on request: sample time, limits, noise."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from fopid_core.errors import InputError
from fopid_ros.tuner.controller_client import ControllerClient
from fopid_ros.tuner.learning.history import History

if TYPE_CHECKING:
    from fopid_core.design.recorded_tuning import RecordedBounds
    from fopid_core.design.specification import TuningRequest, TuningResult

BY_NOISE = ("noise_density", "noise_rms_max", "filter_order")
"""Fields of a request by which a time-domain design is kept quiet."""


@dataclass(frozen=True)
class Heard:
    """What bounds a design for the running loop.

    Attributes
    ----------
    bounds : RecordedBounds or None
        None where nothing was heard.
    told : str
        Where they are from, or why there are none, for a person; empty where no loop runs.
    """

    bounds: RecordedBounds | None = None
    told: str = ""

    def bounded(self, wanted: TuningRequest) -> TuningRequest:
        """The request with sample time and limits of the loop, where nobody has said others."""
        if self.bounds is None:
            return wanted
        own = {name: value for name, value in self.bounds.options(wanted.method).items() if name not in BY_NOISE}
        return replace(wanted, **{name: value for name, value in own.items()
                                  if name == "sample_time" or getattr(wanted, name) is None})  # fmt: skip

    def excess(self, wanted: TuningRequest, result: TuningResult) -> float:
        """By how much noise moves the control under a design, as a share of what is allowed; 0 if not known."""
        from fopid_core.design.recorded_tuning import control_noise

        if self.bounds is None:
            return 0.0
        return control_noise(wanted.process, result, self.bounds) / self.bounds.control_from_noise

    def quieter(self, wanted: TuningRequest, excess: float) -> TuningRequest | None:
        """A request that keeps the control quiet by a filter; None where somebody has said what decides that."""
        from fopid_core.design.recorded_tuning import CLEAR

        if wanted.noise_rms_max is not None:  # by as much less as sampling adds to it
            return replace(wanted, noise_rms_max=CLEAR * wanted.noise_rms_max / excess)
        if self.bounds is None or wanted.method != "time" or wanted.noise_max is not None or wanted.filter_order:
            return None
        own = self.bounds.options(wanted.method)
        return replace(wanted, **{name: own[name] for name in BY_NOISE})

    def told_with(self, excess: float) -> str:
        """What is said of a design."""
        if self.bounds is None or not excess:
            return self.told
        most = self.bounds.control_from_noise
        return f"{self.told}; noise moves the control by {excess * most:.3g}, {most:.3g} is allowed"


def hear(history: History, controller: ControllerClient, wanted: TuningRequest) -> Heard:
    """What the loop shows that the tuner listens to, and its controller says of itself."""
    from fopid_core.design.identification.noise import sensor_noise
    from fopid_core.design.recorded_tuning import recorded_bounds

    if math.isnan(history.newest("control")):
        return Heard()
    try:
        sample_time, low, high, rate = controller.get("sample_time", "control_min", "control_max", "control_rate_max")
        record = replace(history.record(), control_min=low, control_max=high, control_rate_max=rate)
    except InputError as error:
        return Heard(told=f"nothing is taken from the loop: {error}")
    bounds = recorded_bounds(record, wanted.process, sensor_noise(record), sample_time)
    return Heard(bounds, f"from the loop: {bounds.told}")
