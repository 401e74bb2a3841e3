"""What the textbooks' rules make of a learnt process: what a design has to beat."""

from __future__ import annotations

import math
from collections.abc import Iterator

from fopid_core.design.defaults import gain_sign
from fopid_core.design.robust_verification import UNSEEN
from fopid_core.design.rules import RULES, Foptd, foptd_of, simc_pi
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process
from fopid_core.model.two_degrees import NO_FILTER, MeasurementFilter

RULE_FILTER = 0.1
"""Time of the filter that a rule's derivative is run with, as a share of the derivative time."""
NAMES = ("amigo-pid", "amigo-pi", "simc-pi")
SLOWER = (2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
"""Closed-loop time constants in delays that SIMC, which has that number free, is tried with as well."""
INTEGRATES = 500.0
"""Lag in delays of what stands for a process that integrates; the rules' limit for K / T is reached to 1 %."""


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


def textbook_loops(process: Process, crossover: float) -> Iterator[tuple[Fopid, MeasurementFilter]]:
    """What the rules say for a process, each with the filter its derivative needs."""
    try:
        read = read_lag(process, crossover)
    except InputError:  # the process has no nearest lag
        return
    if read.delay <= 0.0 or read.lag <= 0.0:
        return
    for name in NAMES:
        controller = RULES[name].controller(read)
        if controller is not None:
            yield controller, _filter(controller)
    for slower in SLOWER:
        yield simc_pi(read, slower), NO_FILTER


def _filter(controller: Fopid) -> MeasurementFilter:
    derivative_time = abs(controller.kd / controller.kp) if controller.kp else 0.0
    return MeasurementFilter(1, RULE_FILTER * derivative_time) if derivative_time else NO_FILTER
