"""What time-domain tuning minimises and which bounds it keeps."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from fopid_core.design.specification import NUMBERS, VARIABLES
from fopid_core.design.time.objectives import Objective
from fopid_core.model.process import Process

Input = Literal["setpoint", "load", "both"]


@dataclass(frozen=True)
class TimeSpecification:
    """What is minimised, and under which bounds.

    Attributes
    ----------
    objective : Objective
    horizon : float
        Time over which the response counts [s].
    ms_max, u_max, noise_max : float
        Bounds on max |S|, on the control's peak after a unit setpoint step, and on max |C F S| up to the Nyquist
        frequency of the controller; infinite for none.
    sample_time : float
        Tick of the controller as it will run [s].
    fixed : mapping
        Variables that keep a value.
    bounds : mapping
        (low, high) of variables, in place of the default box.
    mt_max : float
        Bound on max |T|.
    input : {"setpoint", "load", "both"}
        The unit step whose response counts; a load adds to the control. For both, the load is the one that would move
        the measurement by 1 at rest.
    load_weight : float
        Of the load's index against the setpoint's, for both.
    filter_order : int
        Of the filter of the measurement, whose time is then chosen; 0 for none.
    two_degrees : bool
        Whether the weights of the setpoint are chosen.
    noise_density, noise_rms_max : float
        Two-sided power spectral density of white noise of the measurement [unit^2/Hz], the variance of a sample times
        the sample time, and the bound on the root mean square of the control that it makes, up to the Nyquist
        frequency.
    rate_max : float
        Bound on the control's moves per second after a unit setpoint step, the first tick included.
    load_left_max : float
        Bound on what a load has left in the end, see ``load_tail``.
    sampled : Process, optional
        The process without the hold of its control: ``ms_max`` is kept as the loop runs, sampled, as well.
    fastest : float
        About the crossover that the bounds let a loop have [rad/s]; infinite where the process alone says how fast.
    """

    objective: Objective
    horizon: float
    ms_max: float = math.inf
    u_max: float = math.inf
    noise_max: float = math.inf
    sample_time: float = 0.01
    fixed: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    mt_max: float = math.inf
    input: Input = "setpoint"
    load_weight: float = 1.0
    filter_order: int = 0
    two_degrees: bool = False
    noise_density: float = 0.0
    noise_rms_max: float = math.inf
    rate_max: float = math.inf
    load_left_max: float = math.inf
    sampled: Process | None = None
    fastest: float = math.inf

    @property
    def variables(self) -> tuple[str, ...]:
        """What is chosen: the five numbers alone when nothing else may differ from nothing."""
        named = {*self.fixed, *self.bounds} - {*NUMBERS}
        return VARIABLES if self.filter_order or self.two_degrees or named else NUMBERS

    @property
    def bounds_noise_rms(self) -> bool:
        """Whether the control that noise makes is bounded."""
        return self.noise_density > 0.0 and math.isfinite(self.noise_rms_max)
