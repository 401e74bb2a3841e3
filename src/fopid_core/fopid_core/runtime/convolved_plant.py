"""The plant as it runs, whatever its orders and delays: its exact step response, convolved with the held input."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fopid_core.errors import InputError, UnboundedResponseError, UnknownResponseError
from fopid_core.model.arrays import Floats
from fopid_core.model.delay_free import DelayFree
from fopid_core.model.delayed import Delayed
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.method_of_steps import Steps
from fopid_core.model.process import Process
from fopid_core.model.quasipolynomial import QuasiPolynomial, Term
from fopid_core.model.step_transforms import StepTransforms
from fopid_core.runtime.old_moves import PLACES, OldMoves, interpolation
from fopid_core.runtime.plant import Plant, PlantSettings

FIRST, MOST = 1 << 12, 1 << 17
"""Samples that are remembered one by one: at first, doubled while older ones cannot be told together, and at most."""
_FEWER = (1, 8, 64)
"""Of a process that is unstable the response is known for so many times fewer samples only: it runs as long as that."""
WORST = 1e-6
"""Largest error of a step response, relative to its size, that is simulated with."""
_SMOOTH = 1e-8
"""Of the size of a step response: how well the moves of long ago act together, or how little it still moves."""
_BEFORE = 1e-9
"""Of a sample time."""
_MOST_ELEMENTS = 100_000
"""In all echoes together."""


class ConvolvedPlant:
    """``measurement = plant.step(control, disturbance)`` as of `Plant`, for a process that need not be rational.

    Between two samples the input is held, so the output is the sum of all its moves, each times the process's step
    response since then: exact but for the error of that response (``accuracy``). Moves of long ago act together
    (`OldMoves`), so that it may run for as long as one likes.

    Parameters
    ----------
    settings : PlantSettings
        ``delay_model`` is left aside: a delay is exact.

    Attributes
    ----------
    accuracy : float
        Largest error of the step response worked out so far, relative to its size.
    ends_by : float
        When a process that is unstable will run no further, since its response has grown beyond all numbers [s].

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
        self.accuracy, self.ends_by = 0.0, math.inf
        longest = _transforms(settings.process.without_delay()).longest_delay
        self._delays = settings.process.delay + 2.0 * longest
        self._steps = self._begun()
        self._begun_with = self._steps.size
        self.reset()

    def _begun(self) -> Floats:
        """The response at first, as far as it is known."""
        for fewer in _FEWER[:-1]:
            try:
                return self._response(np.arange(1.0, 2 * FIRST // fewer + 1))
            except UnboundedResponseError:
                self.ends_by = 2 * FIRST // fewer * self.settings.sample_time
        return self._response(np.arange(1.0, 2 * FIRST // _FEWER[-1] + 1))

    def _response(self, ages: Floats) -> Floats:
        """The response to a unit step so many samples ago; rising."""
        process, h = self.settings.process, self.settings.sample_time
        time = np.asarray(h * ages - process.delay, dtype=np.float64)
        late = time > 0.0
        found = np.zeros(ages.size)
        if late.any():
            values, error = self._answered(time[late])
            found[late] = values
            accuracy = float(np.max(error) / max(float(np.max(np.abs(values))), 1e-300))
            self.accuracy = max(self.accuracy, accuracy)
            if not accuracy <= WORST or not np.isfinite(values).all():
                raise InputError(f"process {process}: its step response is known to {accuracy:.2g} only")
        return found

    def _answered(self, time: Floats) -> tuple[Floats, Floats]:
        try:
            return _answer(self.settings.process, time, self.settings.sample_time)
        except UnknownResponseError as error:
            h = self.settings.sample_time
            told = f"process {self.settings.process}: within {time[-1]:g} s of a step of its input {error.reason}"
            raise type(error)(
                told, f"one whose response is known over {time[-1] / h:.0f} samples of sample_time = {h:g} s"
            ) from error

    def growth(self, count: int) -> Floats:
        """By how much the response to a unit step of the input grows in each of so many samples."""
        return self.gain_factor * np.diff(self._steps_until(count)[:count], prepend=0.0)

    def _steps_until(self, count: int) -> Floats:
        """The response to a unit step at so many samples at least."""
        if self._steps.size < count:
            self._steps = self._response(np.arange(1.0, count + 1))
        return self._steps

    def reset(self) -> None:
        """Back to rest at the initial output; the noise starts anew."""
        process, begun = self.settings.process, self.settings.initial_output
        gain = process.steady_state_gain
        if begun and (gain == 0.0 or (math.isinf(gain) and process.numerator.sum_of_order(0.0) == 0.0)):
            raise InputError(f"initial_output = {begun}; allowed: 0, since this process has no other point of rest")
        self._held = begun / gain if begun and math.isfinite(gain) else 0.0
        self._moves, self._count, self._before = np.zeros(self._begun_with), 0, 0
        self._input = 0.0
        self._old: OldMoves | None = None
        self._coming: Floats | None = None
        self._noise = np.random.default_rng(self.settings.seed)
        self.output = begun
        self.measurement = self._measure()

    def step(self, control: float, disturbance: float = 0.0) -> float:
        """Hold ``control + disturbance`` for one sample time; return the measurement after it.

        Raises
        ------
        InputError
            If an input is not finite, or if its response still winds after ``MOST`` samples.
        """
        if not math.isfinite(control + disturbance):
            raise InputError(f"control = {control}, disturbance = {disturbance}; allowed: finite numbers")
        if self._count == self._moves.size:
            self._make_room()
        before, self._input = self._input, self.gain_factor * (control + disturbance) - self._held
        self._moves[self._count] = self._input - before
        self._count += 1
        n = self._count
        old = 0.0 if self._coming is None else self._coming[n - 1 - self._coming.size]
        self.output = self.settings.initial_output + float(self._moves[:n] @ self._steps[n - 1 :: -1] + old)
        self.measurement = self._measure()
        return self.measurement

    def _make_room(self) -> None:
        """Tell the older half of the moves together, or remember twice as many one by one."""
        half = self._moves.size // 2
        if self._old is None:
            later = self._later(half)
            if later is None:
                self._remember(4 * half)
                return
            self._old = OldMoves(half, later)
        self._old.add(self._moves[:half])
        self._moves[:half] = self._moves[half:]
        self._count, self._before = half, self._before + half
        self._coming = self._old.coming(self._before + half)

    def _remember(self, count: int) -> None:
        if count > 2 * MOST:
            raise InputError(
                f"process {self.settings.process}: its step response still winds after {MOST} samples; allowed: a "
                f"sample time longer than {self.settings.sample_time:g} s"
            )
        self._moves = np.append(self._moves, np.zeros(count - self._moves.size))
        self._steps_until(count)

    def _later(self, age: int) -> Callable[[Floats], Floats] | None:
        """The response from an age [samples] on, if it rests by then or is smooth, and no delay is still to come."""
        if age * self.settings.sample_time < self._delays:
            return None
        seen = self._steps[age - 1 : 2 * age]
        close = _SMOOTH * float(np.max(np.abs(seen)))
        if np.max(np.abs(seen - seen[-1])) <= close:
            return lambda ages: np.full(ages.size, seen[-1])
        nodes = self._response(age + 0.5 * age * (PLACES[::-1] + 1.0))[::-1]
        told = interpolation(np.linspace(-1.0, 1.0, seen.size)) @ nodes
        return self._response if np.max(np.abs(told - seen)) <= close else None

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


def _transforms(process: Process) -> StepTransforms:
    """Of the answer to a unit step, with the sign of an error."""
    return StepTransforms.of(Loop(process, Fopid(0.0)), "load")


def _answer(process: Process, time: Floats, sample_time: float) -> tuple[Floats, Floats]:
    """The response to a unit step, its own delay left aside, and the estimated error; at rising instants.

    Where a delay makes it jump at an instant, the sample there is from before, as that of `Plant` is.
    """
    process, close = process.without_delay(), _BEFORE * sample_time
    if any(term.delay for term in process.denominator.terms):
        echoed, seen = _echoed(process, float(time[-1])), np.maximum(time - close, 0.5 * time[0])
        return -echoed.at(seen)[0], echoed.error_at(seen)[0]
    values, errors = np.zeros((2, time.size))
    for delay, part in _parts(process):
        late = time > delay + close
        if late.any():
            since = time[late] - delay
            one = DelayFree.of(_transforms(part), float(since[-1]), float(since[0]))
            values[late] -= one.at(since)[0]
            errors[late] += one.error_at(since)[0]
    return values, errors


def _echoed(process: Process, horizon: float) -> Delayed | Steps:
    """The response of a process that answers itself after a delay, whose echoes may be as sudden as the step was."""
    transforms = _transforms(process)
    try:
        return Delayed.of(transforms, horizon)
    except UnboundedResponseError:
        raise
    except UnknownResponseError:
        if process.denominator.degree < 1.0:  # nothing but echoes
            lag = QuasiPolynomial.of([Term(1.0, 0.0, 1.0), Term(0.0, 0.0, 1.0)])
            transforms = _transforms(Process(process.numerator * lag, process.denominator * lag))
        steps = Steps.of(transforms, horizon, _MOST_ELEMENTS)
        if steps is None:
            raise
        return steps


def _parts(process: Process) -> list[tuple[float, Process]]:
    """The processes without delay, each with what it is delayed by, of which one is the sum."""
    terms: dict[float, list[Term]] = {}
    for term in process.numerator.terms:
        terms.setdefault(term.delay, []).append(replace(term, delay=0.0))
    return [(delay, Process(QuasiPolynomial.of(part), process.denominator)) for delay, part in sorted(terms.items())]
