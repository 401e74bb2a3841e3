"""The limit of all linear controllers on a process: what goes into the dual program, and what is known without it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fopid_core.design import defaults
from fopid_core.design.specification import Clock, TuningRequest, one_of, require
from fopid_core.model.arrays import Floats
from fopid_core.model.process import Process
from fopid_core.model.stability import process_stability

INDICES = ("iae", "ise")
INPUTS = ("load", "setpoint")
CELLS = 160
"""Of the horizon; the bound is worked out for half as many as well."""
DOUBT = 2.0
"""How much more a finer grid may bring than its last doubling did."""
TURNS, DELAYS = 5.0, 10.0
"""Default horizon, in radians of the natural crossover, or in delays."""
FADED = 14.0
"""A zero to the right counts where exp(-14) of its term is left at the horizon."""
LONGER = 3.0
"""By how much the horizon is made longer for its sake."""
POINTS, DAMPING, PERIODS = 1 << 17, 30.0, 4.0
"""Of the inverse transform that gives the answer without control."""


@dataclass(frozen=True)
class Limit:
    """What no linear controller goes below.

    Attributes
    ----------
    bound : float
        A lower bound, by weak duality.
    resolution_error : float
        Estimate of how much higher it may become on finer grids; 0 where it is known in closed form, NaN where the
        grids show nothing.
    index, input : str
    ms_max, mt_max, noise_max : float
        What was asked.
    horizon : float
        Up to which the answer counted [s].
    cells : int
        Of the grid; 0 for a closed form.
    solver_time : float
        What the solver took of it [s].
    elapsed : float
        [s]
    """

    bound: float
    resolution_error: float
    index: str
    input: str
    ms_max: float
    mt_max: float
    noise_max: float
    horizon: float
    cells: int
    solver_time: float
    elapsed: float


def limit(
    process: Process,
    index: str = "iae",
    input: str = "load",  # noqa: A002 - the field's word, as in a tuning request
    ms_max: float | None = None,
    mt_max: float | None = None,
    noise_max: float | None = None,
    sample_time: float = 0.01,
    horizon: float | None = None,
    cells: int = CELLS,
    one_degree: bool = False,
    clock: Clock = time.perf_counter,
) -> Limit:
    """The least index that any linear controller can reach.

    Parameters
    ----------
    process : Process
        Stable or integrating.
    index : str
        ``iae`` or ``ise`` of a unit step of
    input : str
        the ``load``, which adds to the control, or the ``setpoint``.
    ms_max, mt_max, noise_max : float, optional
        Bounds on max |S|, 1.6 when not given; on max |T|, none when not given; and on the gain from noise to control up
        to the Nyquist frequency of ``sample_time`` [s], 20 over the process's gain when not given, as in a comparison.
    horizon : float, optional
        Up to which the answer counts [s]; every one gives a bound, chosen from the process when not given.
    cells : int
        Of the grid.
    one_degree : bool
        For a setpoint: that the controller sees nothing but the error. With two degrees of freedom bounds on the loop
        do not bind the answer to the setpoint.

    Raises
    ------
    InputError
        For a process that is unstable, or an argument that is not allowed.

    Examples
    --------
    >>> found = limit(Process.parse("2/(s+1)*exp(-0.5s)"), input="setpoint")
    >>> found.bound, found.resolution_error
    (0.5, 0.0)
    """
    one_of("index", index, INDICES)
    one_of("input", input, INPUTS)
    TuningRequest(process, "time", ms_max=ms_max, mt_max=mt_max, noise_max=noise_max, sample_time=sample_time)
    require(8 <= cells <= 1000, "cells", cells, "8 to 1000")
    poles = process_stability(process).unstable_poles
    require(poles == 0, "process", process, "for this one that is stable or integrating")
    require(horizon is None or process.delay < horizon < math.inf, "horizon", horizon, "longer than the delay, finite")
    begun = clock()
    ms = defaults.MS_MAX if ms_max is None else ms_max
    mt = math.inf if mt_max is None else mt_max
    noise = defaults.U_MAX / abs(defaults.process_gain(process)) if noise_max is None else noise_max
    zeros = right_zeros(process)
    until = horizon or _horizon(process, zeros)
    on_t = min(mt, 1.0 + ms)
    bound = _without_bounds(process, index, input, zeros)
    error = took = 0.0
    used = 0
    if math.isfinite(on_t) and (input == "load" or one_degree):
        from fopid_core.design.limit.dual import Task, lower_bound  # cvxpy takes a second

        load = input == "load"
        task = Task(
            ramp_response(process, until) if load else lambda t: t, process.delay if load else 0.0, process.delay,
            zeros[zeros.real * until >= FADED], ms, _on_t(process, on_t, noise, sample_time), index == "ise",
        )  # fmt: skip
        (fine, took), (coarse, before) = (lower_bound(task, until, count) for count in (cells, max(cells // 2, 8)))
        error = DOUBT * abs(fine - coarse) if fine > 0.0 else math.nan
        took, used = took + before, cells
        bound = max(bound, fine, coarse)
    return Limit(bound, error, index, input, ms, mt, noise, until, used, took, clock() - begun)


def right_zeros(process: Process) -> NDArray[np.complex128]:
    """Zeros to the right, one of each conjugate pair; none for fractional powers, whose zeros are left out of account.

    Examples
    --------
    >>> right_zeros(Process.parse("(1-2s)(s^2-2s+5)/(s+1)^4")).round(6).tolist()
    [(1+2j), (0.5+0j)]
    """
    if not process.is_rational:
        return np.zeros(0, dtype=np.complex128)
    terms = {round(term.order): term.coefficient for term in process.numerator.terms}
    zeros = np.roots([terms.get(power, 0.0) for power in range(max(terms), -1, -1)]).astype(np.complex128)
    return zeros[(zeros.real > 0.0) & (zeros.imag >= 0.0)]


def ramp_response(process: Process, horizon: float) -> Callable[[Floats], Floats]:
    """The answer to a unit ramp of the process without its delay, that is the integral of its step response.

    Examples
    --------
    >>> ramp = ramp_response(Process.parse("1/(s+1)*exp(-2s)"), 5.0)
    >>> bool(abs(ramp(np.array([3.0]))[0] - (2.0 + np.exp(-3.0))) < 1e-6)
    True
    """
    period = PERIODS * horizon
    s = DAMPING / period + 2j * math.pi / period * np.arange(POINTS // 2 + 1)
    instants = period / POINTS * np.arange(POINTS)
    shown = instants <= 1.5 * horizon
    values = np.fft.irfft(process.without_delay()(s) / s**2)[shown] * POINTS / period
    values *= np.exp(DAMPING / period * instants[shown])
    return lambda t: np.interp(t, instants[shown], values)


def _horizon(process: Process, zeros: NDArray[np.complex128]) -> float:
    usual = max(TURNS / defaults.natural_crossover(process, defaults.PHASE_MARGIN), DELAYS * process.delay)
    needed = FADED / zeros.real.min() if zeros.size else 0.0
    return float(max(usual, 1.001 * needed)) if needed <= LONGER * usual else usual


def _on_t(process: Process, everywhere: float, noise: float, sample_time: float) -> Callable[[Floats], Floats]:
    """The bound on abs(T) at frequencies w [rad/s]."""
    nyquist = math.pi / sample_time

    def bound(w: Floats) -> Floats:
        allowed = np.full(w.shape, everywhere)
        seen = (w > 0.0) & (w <= nyquist)
        if math.isfinite(noise):
            allowed[seen] = np.minimum(everywhere, noise * np.abs(process(1j * w[seen])))
        return allowed

    return bound


def _without_bounds(process: Process, index: str, step: str, zeros: NDArray[np.complex128]) -> float:
    """What is known whatever the bounds on the loop are.

    A setpoint step shows the delay, and what zeros to the right make of it; with two degrees of freedom nothing else.
    A load shows for one more delay, until the first control that knows of it arrives.
    """
    if step == "setpoint":
        if index == "ise":
            pairs = np.where(zeros.imag > 0.0, 2.0, 1.0)
            return process.delay + float(2.0 * np.sum(pairs * (1.0 / zeros).real))
        real = zeros.real[zeros.imag == 0.0]
        return process.delay + (1.0 / float(real.min()) if real.size else 0.0)
    if process.delay == 0.0:
        return 0.0
    instants = np.linspace(0.0, process.delay, 4097)
    answer = np.diff(ramp_response(process, process.delay)(instants)) / np.diff(instants)
    return float(np.sum(np.abs(answer) ** (2 if index == "ise" else 1)) * instants[1])
