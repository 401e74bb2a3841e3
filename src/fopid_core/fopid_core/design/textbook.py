"""What the textbooks' rules make of a learnt process: what a design has to beat."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from fopid_core.design.defaults import gain_sign
from fopid_core.design.robust_verification import UNSEEN
from fopid_core.design.rules import RULES, Foptd, foptd_of, simc_pi
from fopid_core.errors import InputError
from fopid_core.model.arrays import Floats
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process
from fopid_core.model.two_degrees import NO_FILTER, MeasurementFilter

RULE_FILTER = 0.1
"""Time of the filter that a rule's derivative is run with, as a share of the derivative time."""
NAMES = ("amigo-pid", "amigo-pi", "simc-pi")
SLOWER = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
"""Closed-loop time constants in delays that SIMC, which has that number free, is tried with."""
INTEGRATES = 500.0
"""Lag in delays of what stands for a process that integrates; the rules' limit for K / T is reached to 1 %."""
LOWEST, HIGHEST, PLACES = 0.1, 1.5, 15
"""Where two lags are read: from and up to so many crossovers, at so many frequencies."""
LAST_TURN = 0.5
"""Share of the second lag that is a delay of SIMC's PID at least (the half rule): where there is less, no end is to
its gain."""


class TwoLags(NamedTuple):
    """gain exp(-delay s) / ((slow s + 1) (fast s + 1)); times in seconds."""

    gain: float
    slow: float
    fast: float
    delay: float


def read_lag(process: Process, crossover: float) -> Foptd:
    """The lag and the delay that the rules read, near the crossover [rad/s] where the steady state is not seen there.

    A process that integrates there is k exp(-L s) / s of the same gain and phase; its steady-state gain rests on
    nothing that a controller meets.

    Examples
    --------
    >>> read = read_lag(Process.parse("1e6/(1e6s+1)*exp(-2s)"), 0.2)
    >>> round(read.gain / read.lag, 3), round(read.delay, 3)
    (1.0, 2.0)
    """
    value = complex(process(1j * crossover))
    if abs(process.steady_state_gain) < UNSEEN * abs(value):
        return foptd_of(process)
    sign = gain_sign(process)
    lag = -math.remainder(math.atan2(sign * value.imag, sign * value.real) + 0.5 * math.pi, math.tau)
    delay = lag / crossover
    return Foptd(sign * abs(value) * crossover * INTEGRATES * delay, INTEGRATES * delay, delay)


def read_two_lags(process: Process, crossover: float) -> TwoLags:
    """The two lags and the delay nearest to a process about the crossover [rad/s], in shares of its size.

    Examples
    --------
    >>> read = read_two_lags(Process.parse("3/((20s+1)(4s+1))*exp(-s)"), 0.2)
    >>> [round(number, 3) for number in read]
    [3.0, 20.0, 4.0, 1.0]
    """
    s = 1j * crossover * np.geomspace(LOWEST, HIGHEST, PLACES)
    seen, sign = process(s), gain_sign(process)

    def read(x: Floats) -> TwoLags:
        slope, slow, fast, delay = np.exp(x).tolist()
        return TwoLags(sign * slope * slow, max(slow, fast), min(slow, fast), delay)

    def residual(x: Floats) -> Floats:
        gain, slow, fast, delay = read(x)
        off = gain * np.exp(-delay * s) / ((slow * s + 1.0) * (fast * s + 1.0)) / seen - 1.0
        return np.concatenate([off.real, off.imag])

    slope, time = float(np.abs(seen[0] * s[0])), 1.0 / crossover
    low = np.log([1e-3 * slope, 0.05 * time, 1e-3 * time, 1e-3 * time])
    high = np.log([1e3 * slope, 1e3 * time, 30.0 * time, 30.0 * time])
    starts = [np.log([slope, a * time, b * time, 0.3 * time]) for a in (30.0, 3.0) for b in (0.3, 1.5)]
    return read(min((least_squares(residual, x, bounds=(low, high)) for x in starts), key=lambda found: found.cost).x)


def simc_pid(read: TwoLags, slower: float = 1.0) -> tuple[Fopid, MeasurementFilter]:
    """PID with a closed-loop time constant of so many delays, and the filter its derivative is run with.

    References
    ----------
    Skogestad, J. Process Control 13 (2003) 291-309: the series form of its table 1, told as the parallel one.

    Examples
    --------
    >>> simc_pid(TwoLags(2.0, 10.0, 4.0, 2.5))[0].gains[:3]  # series 1, ti 10, td 4
    (1.4, 0.1, 4.0)
    """
    delay = max(read.delay, LAST_TURN * read.fast)
    speed = (1.0 + slower) * delay
    series, ti = read.slow / (read.gain * speed), min(read.slow, 4.0 * speed)
    gains = Fopid(series * (1.0 + read.fast / ti), series / ti, series * read.fast)
    return gains, MeasurementFilter(1, RULE_FILTER * read.fast)


def textbook_loops(process: Process, crossover: float) -> Iterator[tuple[Fopid, MeasurementFilter]]:
    """What the rules say for a process, each with the filter its derivative needs."""
    try:
        one = read_lag(process, crossover)
    except InputError:  # the process has no nearest lag
        return
    if one.delay <= 0.0 or one.lag <= 0.0:
        return
    for name in ("amigo-pid", "amigo-pi"):
        controller = RULES[name].controller(one)
        if controller is not None:
            yield controller, _filter(controller)
    two = read_two_lags(process, crossover)
    for slower in SLOWER:
        yield simc_pi(one, slower), NO_FILTER
        yield simc_pid(two, slower)


def _filter(controller: Fopid) -> MeasurementFilter:
    derivative_time = abs(controller.kd / controller.kp) if controller.kp else 0.0
    return MeasurementFilter(1, RULE_FILTER * derivative_time) if derivative_time else NO_FILTER
