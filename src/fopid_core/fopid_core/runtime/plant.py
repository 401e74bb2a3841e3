"""The plant as it runs: any proper rational process with delay, discretised exactly for a held input."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import matrix_balance

from fopid_core.errors import InputError
from fopid_core.model.process import Process

DelayModel = Literal["pade", "exact"]
Matrix = NDArray[np.float64]

TOLD_FROM = 1e-4
"""An accuracy of a plant, beside a step's response, from which on it is told."""
MAX_DELAY_SAMPLES = 10_000_000
_SERIES_TERMS = 16
"""Of exp(M) where the norm of M is 1/2 at most: the next is 1e-18 of the first."""
_DELAYS_SEEN, _MOST_SEEN = 4.0, 4000
"""For so many delays, in so many samples at most, what Pade's differs by from a true one is looked at."""


@dataclass(frozen=True)
class PlantSettings:
    """What the plant simulator needs to know.

    Attributes
    ----------
    process : Process
        For `Plant` rational, with or without one delay; for `ConvolvedPlant` of any orders, with delays inside.
    sample_time : float
        Time between ticks [s]; the input is held in between.
    delay_model : {"pade", "exact"}
        Whether the delay is Pade's all-pass of order ``pade_order`` or a true delay of any length.
    pade_order : int
        1 to 10; the paper takes 3.
    noise_std : float
        Standard deviation of the white noise on the measurement.
    seed : int
        Of the noise: the same seed gives the same noise.
    gain_factor : float
        Factor on the process's input; may be changed while the plant runs.
    initial_output : float
        The output at the start, at rest.
    """

    process: Process
    sample_time: float = 0.01
    delay_model: DelayModel = "pade"
    pade_order: int = 3
    noise_std: float = 0.0
    seed: int = 0
    gain_factor: float = 1.0
    initial_output: float = 0.0

    def __post_init__(self) -> None:
        if not 1e-6 <= self.sample_time <= 1e6:
            raise InputError(f"sample_time = {self.sample_time}; allowed: 1e-06 to 1e+06 [s]")
        if self.delay_model not in get_args(DelayModel):
            raise InputError(f"delay_model = {self.delay_model!r}; allowed: {', '.join(get_args(DelayModel))}")
        if not 1 <= self.pade_order <= 10:
            raise InputError(f"pade_order = {self.pade_order}; allowed: 1 to 10")
        if self.process.delay / self.sample_time > MAX_DELAY_SAMPLES:
            raise InputError(f"delay of {self.process.delay:g} s; allowed: {MAX_DELAY_SAMPLES:,} samples at most")
        if not 0.0 <= self.noise_std < math.inf:
            raise InputError(f"noise_std = {self.noise_std}; allowed: 0 or more, finite")
        if self.seed < 0:
            raise InputError(f"seed = {self.seed}; allowed: 0 or more")
        for name in ("gain_factor", "initial_output"):
            if not math.isfinite(getattr(self, name)):
                raise InputError(f"{name} = {getattr(self, name)}; allowed: a finite number")


@dataclass(frozen=True)
class StateSpace:
    """x' = A x + B u, y = C x + D u, one input and one output."""

    a: Matrix
    b: Matrix
    c: Matrix
    d: float

    def then(self, after: StateSpace) -> StateSpace:
        """Series connection: this one first."""
        n, m = len(self.b), len(after.b)
        a = np.block([[self.a, np.zeros((n, m))], [np.outer(after.b, self.c), after.a]])
        return StateSpace(a, np.concatenate([self.b, after.b * self.d]),
                          np.concatenate([after.d * self.c, after.c]), after.d * self.d)  # fmt: skip


def state_space(numerator: Matrix, denominator: Matrix) -> StateSpace:
    """Balanced controllable canonical form of a proper rational function (highest power first)."""
    lead = denominator[0]
    den = denominator[1:] / lead
    order = len(den)
    num = np.concatenate([np.zeros(order + 1 - len(numerator)), numerator]) / lead
    d = float(num[0])
    a = np.vstack([-den, np.eye(order)[: order - 1]]) if order else np.zeros((0, 0))
    b = np.eye(order)[:, 0] if order else np.zeros(0)
    c: Matrix = num[1:] - d * den
    if not order:
        return StateSpace(a, b, c, d)
    a, scaling = (np.asarray(matrix, dtype=np.float64) for matrix in matrix_balance(a, permute=False))
    b = np.asarray(np.linalg.solve(scaling, b), dtype=np.float64)
    return StateSpace(a, b, c @ scaling, d)


def pade_delay(delay: float, order: int) -> StateSpace:
    """Pade's all-pass approximation of exp(-delay s) of equal orders above and below."""
    k = np.arange(order, -1, -1)
    size = [math.comb(order, i) * math.factorial(2 * order - i) / math.factorial(2 * order) for i in k]
    denominator = np.array(size) * delay ** k.astype(float)
    return state_space(denominator * (-1.0) ** k, denominator)


class Plant:
    """The running plant: ``measurement = plant.step(control, disturbance)``.

    The output at sample k is read before the input of sample k acts, so a process that answers at once
    shows the input held until then.

    Parameters
    ----------
    settings : PlantSettings

    Examples
    --------
    >>> plant = Plant(PlantSettings(Process.parse("1/(s+1)"), sample_time=0.5))
    >>> plant.measurement
    0.0
    >>> bool(np.isclose(plant.step(1.0), 1.0 - np.exp(-0.5), rtol=1e-12))
    True
    """

    def __init__(self, settings: PlantSettings) -> None:
        self._settings = settings
        self.gain_factor = settings.gain_factor
        numerator, denominator, delay = settings.process.polynomials()
        system = state_space(numerator, denominator)
        if delay and settings.delay_model == "pade":
            system, delay = pade_delay(delay, settings.pade_order).then(system), 0.0
        self._discretise(system, delay)
        self.reset()

    @property
    def settings(self) -> PlantSettings:
        """The settings in force, apart from ``gain_factor``, which is an attribute of its own."""
        return self._settings

    @cached_property
    def accuracy(self) -> float:
        """Largest error of the response to a step of the input, relative to its size: what Pade makes of a delay.

        Without one it is exact but for rounding, and this is 0. Of the two sizes the larger counts: the true response
        may be over between two samples.
        """
        process, settings = self._settings.process, self._settings
        if not process.delay or settings.delay_model == "exact":
            return 0.0
        seen = _DELAYS_SEEN * process.delay
        quiet = PlantSettings(process, max(settings.sample_time, seen / _MOST_SEEN), pade_order=settings.pade_order)
        samples = math.ceil(seen / quiet.sample_time)
        approximate, exact = (
            np.array([plant.step(1.0) for _ in range(samples)])
            for plant in (Plant(quiet), Plant(replace(quiet, delay_model="exact")))
        )
        size = max(np.abs(exact).max(), np.abs(approximate).max(), 1e-300)
        return float(np.abs(approximate - exact).max() / size)

    def _discretise(self, system: StateSpace, delay: float) -> None:
        """Exact for a held input: a delay of d samples and a fraction splits each step in two."""
        h = self._settings.sample_time
        whole = math.floor(delay / h + 1e-9)
        fraction = max(0.0, delay - whole * h)
        if fraction < 1e-9 * h:
            fraction = 0.0
        late_a, late_b = _held_input(system, h - fraction)
        _, early_b = _held_input(system, fraction)
        self._a, _ = _held_input(system, h)
        self._b_early = late_a @ early_b  # of the input that is still arriving
        self._b_late = late_b
        self._c, self._d = system.c, system.d
        self._whole = whole
        self._x = np.zeros(len(system.b))

    def reset(self) -> None:
        """Back to rest at the initial output; the noise starts anew."""
        at_rest, held = self._rest(self._settings.initial_output)
        self._x = at_rest
        self._line = [held] * (self._whole + 2)  # ring of inputs: the newest at the cursor
        self._cursor = 0
        self._noise = np.random.default_rng(self._settings.seed)
        self.output = self._settings.initial_output
        self.measurement = self._measure()

    def _rest(self, output: float) -> tuple[Matrix, float]:
        """State and held input of the equilibrium with this output (the smallest such input)."""
        n = len(self._x)
        if output == 0.0:
            return np.zeros(n), 0.0
        b = self._b_early + self._b_late
        system = np.block([[np.eye(n) - self._a, -b[:, np.newaxis]], [self._c[np.newaxis, :], np.array([[self._d]])]])
        target = np.append(np.zeros(n), output)
        solution = np.linalg.lstsq(system, target, rcond=None)[0]
        if not np.allclose(system @ solution, target, atol=1e-6 * abs(output)):
            raise InputError(f"initial_output = {output}; allowed: 0, since this process has no other point of rest")
        return solution[:n], float(solution[n])

    def step(self, control: float, disturbance: float = 0.0) -> float:
        """Hold ``control + disturbance`` for one sample time; return the measurement after it.

        Raises
        ------
        InputError
            If an input is not finite, or the output would not be; the plant is then as it was before the call.
        """
        if not math.isfinite(control + disturbance):
            raise InputError(f"control = {control}, disturbance = {disturbance}; allowed: finite numbers")
        line, cursor = self._line, (self._cursor + 1) % len(self._line)
        line[cursor] = self.gain_factor * (control + disturbance)
        late, early = line[cursor - self._whole], line[cursor - self._whole - 1]
        with np.errstate(over="ignore", invalid="ignore"):
            state = self._a @ self._x + self._b_early * early + self._b_late * late
            output = float(self._c @ state) + self._d * late
        if not math.isfinite(output):
            told = f"process {self._settings.process}: its output has grown beyond all numbers"
            raise InputError(f"{told}; allowed: a control that holds it")
        self._cursor, self._x, self.output = cursor, state, output
        self.measurement = self._measure()
        return self.measurement

    def growth(self, count: int) -> Matrix:
        """By how much the response to a unit step of the input grows in each of so many samples.

        Examples
        --------
        >>> plant = Plant(PlantSettings(Process.parse("1/(s+1)*exp(-0.5s)"), sample_time=0.5, delay_model="exact"))
        >>> plant.growth(3).round(6)  # nothing, then 1 - exp(-0.5) of what is left each time
        array([0.      , 0.393469, 0.238651])
        """
        size = max(count - self._whole, 0)
        states, power = np.stack([self._b_late, self._b_early], axis=1)[:, :, np.newaxis], self._a
        while states.shape[2] < size:  # A^k b for twice as many k at a time
            states = np.concatenate([states, np.einsum("ij,jkl->ikl", power, states)], axis=2)
            power = power @ power
        late, early = np.einsum("i,ijk->jk", self._c, states)[:, :size]
        grown = np.zeros(count)
        grown[self._whole :] = late
        grown[self._whole + 1 :] += early[: max(size - 1, 0)]
        if size:
            grown[self._whole] += self._d
        return self.gain_factor * grown

    def _measure(self) -> float:
        if self._settings.noise_std == 0.0:
            return self.output
        return self.output + self._settings.noise_std * float(self._noise.standard_normal())


def _held_input(system: StateSpace, duration: float) -> tuple[Matrix, Matrix]:
    """State transition and effect of a constant unit input over ``duration``, by one matrix exponential."""
    n = len(system.b)
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n] = system.a, system.b
    grown = _grown(block * duration)
    return grown[:n, :n] + np.eye(n), grown[:n, n]


def _grown(exponent: Matrix) -> Matrix:
    """exp(M) - 1: its power series for M / 2^k, then doubled k times.

    `scipy.linalg.expm` squares exp(M / 2^k), in which little is left of a pole that is 2^k times slower than the
    fastest: with time constants fifteen decades apart a step's response was off by 7e-3. Without the 1 nothing is lost.
    """
    norm = float(np.abs(exponent).sum(axis=1).max())
    doublings = math.ceil(math.log2(max(norm, 1.0))) + 1
    short = exponent / 2.0**doublings
    grown = term = short
    for k in range(2, _SERIES_TERMS):
        term = term @ short / k
        grown = grown + term
    for _ in range(doublings):
        grown = 2.0 * grown + grown @ grown
    return grown
