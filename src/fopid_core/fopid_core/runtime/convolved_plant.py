"""The plant as it runs, whatever its orders and delays: its exact step response, convolved with the held input."""

from __future__ import annotations

import math

import numpy as np

from fopid_core.errors import InputError
from fopid_core.model.arrays import Floats
from fopid_core.model.delay_free import DelayFree
from fopid_core.model.delayed import Delayed
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process
from fopid_core.model.step_transforms import StepTransforms
from fopid_core.runtime.plant import Plant, PlantSettings

FIRST, MOST = 1 << 12, 1 << 18
"""Samples of the step response that are worked out at first, twice as many whenever they are used up, and at most."""
WORST = 1e-6
"""Largest error of a step response, relative to its size, that is simulated with."""
_BEFORE = 1e-9
"""Of a sample time."""


class ConvolvedPlant:
    """``measurement = plant.step(control, disturbance)`` as of `Plant`, for a process that need not be rational.

    Between two samples the input is held, so the output is the sum of all its steps, each times the process's step
    response since then: exact but for the error of that response (``accuracy``). Work grows with the samples made.

    Parameters
    ----------
    settings : PlantSettings
        ``delay_model`` is left aside: a delay is exact.

    Attributes
    ----------
    accuracy : float
        Largest error of the step response worked out so far, relative to its size.

    Raises
    ------
    InputError
        If its response is not known well enough.

    Examples
    --------
    >>> plant = ConvolvedPlant(PlantSettings(Process.parse("1/s^0.5"), sample_time=1.0))
    >>> round(plant.step(1.0), 6), round(2.0 / math.sqrt(math.pi), 6)  # 2 sqrt(t / pi)
    (1.128379, 1.128379)
    """

    def __init__(self, settings: PlantSettings) -> None:
        self.settings, self.gain_factor = settings, settings.gain_factor
        self.accuracy = 0.0
        self._added = self._response(FIRST)
        self.reset()

    def _response(self, count: int) -> Floats:
        """By how much the response to a unit step grows in each of so many samples."""
        process, h = self.settings.process, self.settings.sample_time
        time = np.asarray(h * np.arange(1, count + 1) - process.delay, dtype=np.float64)
        late = time > 0.0
        found = np.zeros(count + 1)
        if late.any():
            signals, seen = _answer(process.without_delay(), time[late], h)
            values, error = -signals.at(seen)[0], signals.error_at(seen)[0]
            found[1:][late] = values
            self.accuracy = float(np.max(error) / max(float(np.max(np.abs(values))), 1e-300))
            if not self.accuracy <= WORST or not np.isfinite(values).all():
                raise InputError(f"process {process}: its step response is known to {self.accuracy:.2g} only")
        return np.diff(found)

    def growth(self, count: int) -> Floats:
        """By how much the response to a unit step of the input grows in each of so many samples."""
        if self._added.size < count:
            self._added = self._response(count)
        return self.gain_factor * self._added[:count]

    def reset(self) -> None:
        """Back to rest at the initial output; the noise starts anew."""
        process, begun = self.settings.process, self.settings.initial_output
        gain = process.steady_state_gain
        if begun and (gain == 0.0 or (math.isinf(gain) and process.numerator.sum_of_order(0.0) == 0.0)):
            raise InputError(f"initial_output = {begun}; allowed: 0, since this process has no other point of rest")
        self._held = begun / gain if begun and math.isfinite(gain) else 0.0
        self._inputs, self._count = np.zeros(FIRST), 0
        self._noise = np.random.default_rng(self.settings.seed)
        self.output = begun
        self.measurement = self._measure()

    def step(self, control: float, disturbance: float = 0.0) -> float:
        """Hold ``control + disturbance`` for one sample time; return the measurement after it.

        Raises
        ------
        InputError
            If an input is not finite, or after ``MOST`` samples.
        """
        if not math.isfinite(control + disturbance):
            raise InputError(f"control = {control}, disturbance = {disturbance}; allowed: finite numbers")
        if self._count == self._inputs.size:
            self._grow()
        self._inputs[self._count] = self.gain_factor * (control + disturbance) - self._held
        self._count += 1
        n = self._count
        self.output = self.settings.initial_output + float(self._inputs[:n] @ self._added[n - 1 :: -1])
        self.measurement = self._measure()
        return self.measurement

    def _grow(self) -> None:
        if 2 * self._count > MOST:
            raise InputError(f"more than {MOST} samples of a process that is not rational: allowed with a longer tick")
        self._inputs = np.append(self._inputs, np.zeros(self._count))
        if self._added.size < self._inputs.size:
            self._added = self._response(self._inputs.size)

    def _measure(self) -> float:
        if self.settings.noise_std == 0.0:
            return self.output
        return self.output + self.settings.noise_std * float(self._noise.standard_normal())


AnyPlant = Plant | ConvolvedPlant


def plant_of(settings: PlantSettings) -> AnyPlant:
    """The plant that runs a process: by its state where it has one.

    Examples
    --------
    >>> type(plant_of(PlantSettings(Process.parse("1/(s^1.5+1)")))).__name__
    'ConvolvedPlant'
    """
    return Plant(settings) if settings.process.is_rational else ConvolvedPlant(settings)


def _answer(process: Process, time: Floats, sample_time: float) -> tuple[DelayFree | Delayed, Floats]:
    """The response to a unit step, with the sign of an error, and the instants to read it at.

    Where a delay inside makes it jump at an instant, the sample there is from before, as that of `Plant` is.
    """
    transforms = StepTransforms.of(Loop(process, Fopid(0.0)), "load")
    if not transforms.longest_delay:
        return DelayFree.of(transforms, float(time[-1]), float(time[0])), time
    return Delayed.of(transforms, float(time[-1])), np.maximum(time - _BEFORE * sample_time, 0.5 * time[0])
