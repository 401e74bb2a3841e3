"""The loop as it runs: the exact process behind a hold, the controller with its filter bank at every tick.

The measurement is taken just before the control changes. The process as the controller sees it is then, at
z = exp(j theta), the sum over all frequencies that look alike after sampling (Franklin, Powell and Workman, Digital
Control of Dynamic Systems, ch. 5),

    P(z) = (1 - 1/z) / h  *  sum over m of P(s_m) / s_m,    s_m = j (theta + 2 pi m) / h,

exact for any orders and delay. Stability is decided by the argument principle on 1 + C(z) P(z) outside the unit circle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from graphlib import TopologicalSorter

import numpy as np

from fopid_core.model.adaptive_grid import refine, roots
from fopid_core.model.arrays import Complexes, Floats
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process
from fopid_core.model.two_degrees import NO_FILTER, WHOLE_SETPOINT, MeasurementFilter
from fopid_core.model.winding import right_half_plane_zeros
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.measurement_filter import FilterStep
from fopid_core.runtime.settings import as_designed

_ALIASES = 100  # on either side, where what is left of the sum can be added as an integral
_ALIASES_TURNING = 400  # where a delay turns each of them
_AT_ONCE = 200  # frequencies
_POINTS_PER_DECADE = 24  # of the first grid
_LOWEST = 1e-60  # [rad per tick]
_SETTLED = 0.02  # [rad] from its limit at z = 1, where it is real
_SLOW = 1e-2  # of the slowest pole or zero: there the loop is its own asymptote
_WHOLE = 1e-9  # a delay so near to a whole number of ticks is one
_NOTHING = 1e-300  # of a loop gain
_BORDER = 1e-6  # a distance from -1 that is too close to call
_ROOT = 1e-7  # of ln theta, at a crossover
_WINDING = 0.05  # [turns] by which the count may miss a whole number


@dataclass(frozen=True)
class Running:
    """What the sampled, held loop does.

    Attributes
    ----------
    stable : bool or None
        None where it is not known.
    ms : float
        The largest 1 / abs(1 + L(z)) up to the Nyquist frequency; NaN unless the loop is known to be stable.
    phase_margin, crossover : float
        The smallest in absolute value [rad] and where [rad/s]; infinite and NaN without a crossover.
    gain_margin : float
        The factor nearest to 1 that takes the curve through -1; infinite without.
    reason : str
        Why it is not stable, or not known.
    """

    stable: bool | None
    ms: float = math.nan
    phase_margin: float = math.nan
    crossover: float = math.nan
    gain_margin: float = math.nan
    reason: str = ""


def running(
    process: Process,
    controller: Fopid,
    sample_time: float,
    measurement_filter: MeasurementFilter = NO_FILTER,
    with_margins: bool = True,
) -> Running:
    """Stability, max abs(S) and margins of the loop as it runs.

    Parameters
    ----------
    process : Process
    controller : Fopid
    sample_time : float
        Tick of the controller [s].
    measurement_filter : MeasurementFilter
    with_margins : bool
        Whether phase and gain margin are worked out, too; NaN where they are not.

    Examples
    --------
    >>> ideal, slow = (running(Process.parse("1/(s+1)^3"), Fopid(kp=2.0), h) for h in (1e-3, 1.0))
    >>> round(ideal.ms, 3), round(slow.ms, 3)
    (1.667, 2.514)
    >>> running(Process.parse("1/(s+1)^3"), Fopid(kp=6.0), 1.0).reason
    '2 unstable poles of the sampled loop'
    """
    if process.relative_degree <= 0.0:
        return Running(None, reason="not known: the process answers the control at once")
    return _SampledLoop(process, controller, sample_time, measurement_filter).judge(with_margins)


class _SampledLoop:
    """L at z = exp(j theta), by x = ln theta."""

    def __init__(self, process: Process, gains: Fopid, sample_time: float, slow: MeasurementFilter) -> None:
        self._process, self._gains, self._h = process, gains, sample_time
        self._controller = FopidController(as_designed(gains, sample_time, slow, WHOLE_SETPOINT))

    def __call__(self, x: Floats) -> Complexes:
        theta = np.exp(x)
        return sampled_controller(self._controller, theta) * sampled_process(self._process, self._h, theta)

    @cached_property
    def _order_at_one(self) -> float:
        """The order of L's pole at z = 1."""
        return self._process.integrating_order + float(self._gains.integral_order > 0.0)

    def _regular(self, x: Floats) -> Complexes:
        """1 + L without its pole at z = 1."""
        return (1.0 + self(x)) * (-np.expm1(-1j * np.exp(x))) ** self._order_at_one

    @cached_property
    def _grid(self) -> Floats:
        own = right_half_plane_zeros(self._process.denominator * self._process.numerator).log_frequency
        own = own + math.log(self._h)
        slowest_lag = float(self._controller.settings.active_band.lag_poles()[0])
        first = min(float(own.min(initial=0.0)), math.log(slowest_lag * self._h)) + math.log(_SLOW)
        while first > math.log(_LOWEST) and _off_axis(self._regular(np.array([first]))[0]) > _SETTLED:
            first -= math.log(100.0)
        last = math.log(math.pi)
        even = np.linspace(first, last, int((last - first) / math.log(10.0) * _POINTS_PER_DECADE) + 2)
        turns = self._process.delay / self._h
        fine = np.log(np.linspace(0.0, math.pi, int(4.0 * min(turns, 500.0)) + 2)[1:])
        return np.union1d(even, np.concatenate([own[(own > first) & (own < last)], fine[fine > first]]))

    def judge(self, with_margins: bool) -> Running:
        seen: list[tuple[Floats, Complexes]] = []

        def from_minus_one(x: Floats) -> Complexes:
            seen.append((x, self(x)))
            return 1.0 + seen[-1][1]

        x, distance = refine(from_minus_one, self._grid)
        if not np.isfinite(distance).all():
            return Running(None, reason="not known: a value that is no number")
        unstable = self._unstable_poles(x, distance)
        nearest = float(np.abs(distance).min())
        if unstable is None or nearest < _BORDER:
            return Running(None, reason="not known: too close to the border of stability")
        if unstable:
            poles = f"{unstable} unstable pole{'s' if unstable > 1 else ''} of the sampled loop"
            return Running(False, reason=poles)
        if not with_margins:
            return Running(True, self._ms(x, distance))
        known, values = (np.concatenate(parts) for parts in zip(*seen, strict=True))
        ascending = np.argsort(known)
        x, response = refine(self, known[ascending], values[ascending])
        phase_margin, crossover = self._phase_margin(x, response)
        return Running(True, self._ms(x, 1.0 + response), phase_margin, crossover, self._gain_margin(x, response))

    def _unstable_poles(self, x: Floats, distance: Complexes) -> int | None:
        """Zeros of 1 + L outside the unit circle; None where the count is no number of zeros."""
        open_loop = right_half_plane_zeros(self._process.denominator)
        if not open_loop.decided[0]:
            return None
        values = distance * (-np.expm1(-1j * np.exp(x))) ** self._order_at_one
        begin = values[0] / np.sign(values[0].real)
        turns = (float(np.angle(begin)) + float(np.angle(values[1:] / values[:-1]).sum())) / math.pi
        whole = round(turns)
        unstable = int(open_loop.count[0]) - whole
        return unstable if abs(turns - whole) <= _WINDING and unstable >= 0 else None

    def _ms(self, x: Floats, distance: Complexes) -> float:
        size = np.abs(distance)
        at = int(np.argmin(size))
        left, right = x[max(at - 1, 0)], x[min(at + 1, x.size - 1)]
        for _ in range(3):
            fine = np.linspace(left, right, 33)
            size = np.abs(1.0 + self(fine))
            at = int(np.argmin(size))
            left, right = fine[max(at - 1, 0)], fine[min(at + 1, 32)]
        return float(1.0 / size.min())

    def _phase_margin(self, x: Floats, response: Complexes) -> tuple[float, float]:
        level = np.log(np.maximum(np.abs(response), _NOTHING))
        at = np.flatnonzero(np.sign(level[1:]) != np.sign(level[:-1]))
        crossings = roots(lambda x: np.log(np.abs(self(x))), x[at], x[at + 1], _ROOT)
        if crossings.size == 0:
            return math.inf, math.nan
        angles = np.angle(-self(crossings))
        nearest = int(np.argmin(np.abs(angles)))
        return float(angles[nearest]), float(np.exp(crossings[nearest])) / self._h

    def _gain_margin(self, x: Floats, response: Complexes) -> float:
        crosses = (np.sign(response.imag[1:]) != np.sign(response.imag[:-1])) & (response.real[1:] < 0.0)
        at = np.flatnonzero(crosses)
        real = self(roots(lambda x: self(x).imag, x[at], x[at + 1], _ROOT)).real if at.size else np.empty(0)
        real = np.append(real, response.real[-1])  # at the Nyquist frequency it is real
        factors = -1.0 / real[real < 0.0]
        return float(factors[np.argmin(np.abs(np.log(factors)))]) if factors.size else math.inf


def _off_axis(value: complex) -> float:
    """Angle to the real axis [rad]."""
    return abs(math.atan2(abs(value.imag), abs(value.real)))


def sampled_process(process: Process, sample_time: float, theta: Floats) -> Complexes:
    """P(z) at z = exp(j theta), 0 < theta <= pi, of a process behind a hold; shape (n,)."""
    parts = np.split(theta, range(_AT_ONCE, theta.size, _AT_ONCE))
    return np.concatenate([_aliases(process, sample_time, part) for part in parts])


def _aliases(process: Process, h: float, theta: Floats) -> Complexes:
    ticks = process.delay / h
    in_phase = abs(ticks - round(ticks)) < _WHOLE
    most = _ALIASES if in_phase else _ALIASES_TURNING
    s = 1j * (theta[:, np.newaxis] + 2.0 * math.pi * np.arange(-most, most + 1)) / h
    total = (process(s) / s).sum(axis=1)
    for end in (most + 0.5, -most - 0.5) if in_phase else ():
        last = 1j * (theta + 2.0 * math.pi * end) / h
        total = total + process(last) / last * np.abs(last) * h / (2.0 * math.pi * process.relative_degree)
    return np.asarray(-np.expm1(-1j * theta) / h * total)


def sampled_controller(controller: FopidController, theta: Floats) -> Complexes:
    """C(z) at z = exp(j theta) from the measurement to the control, its sign turned, limits left out; shape (n,)."""
    gains, matrix, size = controller.settings.gains, controller.operators.matrix, controller.operators.size
    z = np.exp(1j * theta)
    # One signal drives both: the error is what is integrated and what is differentiated.
    a, b = matrix[:size, :size], matrix[:size, -2] + matrix[:size, -1]
    read = np.array([gains.ki, gains.kd]) @ matrix[-2:]
    # Few of the states depend on others and none on itself through others: each in its turn, not a system of them all.
    needs = {i: [j for j in np.flatnonzero(a[i]).tolist() if j != i] for i in range(size)}
    remembered = np.empty((size, theta.size), dtype=np.complex128)
    for i in TopologicalSorter(needs).static_order():
        remembered[i] = (b[i] + a[i, needs[i]] @ remembered[needs[i]]) / (z - a[i, i])
    value = np.asarray(read[:size] @ remembered + gains.kp + read[-2] + read[-1])
    slow = controller.settings.measurement_filter
    if slow.is_idle:
        return value
    return value * FilterStep.of(slow, controller.settings.sample_time).response(z)
