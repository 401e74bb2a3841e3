"""Time-domain tuning as an optimisation problem: the cost of many controllers, and what is left to their bounds."""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fopid_core.design.control_peak import first_control
from fopid_core.design.defaults import PHASE_MARGIN, natural_crossover, process_gain
from fopid_core.design.specification import NUMBERS
from fopid_core.design.time.objectives import LoopResponses, Objective
from fopid_core.design.time.search_response import ResponseGrid
from fopid_core.model.process import Process
from fopid_core.model.winding import right_half_plane_zeros

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

LARGEST_GAIN = 500.0
"""Of the paper's box, section 4.1; here in units of the process's gain and time, and from 0 on."""
BANDS = 12
"""A largest value counts as one for each of so many bands: each is smooth in the gains where their maximum is not."""
LEAST_ORDER = 0.05
"""Of an integral and of a derivative."""
SAFE = 3e-5
"""Share of a bound that is kept clear of in a search, for what its grids do not show."""
SAFE_CONTROL = 1e-3
"""The same for the control signal, which the grid of instants shows less exactly."""
AROUND = np.array([-0.4, -0.2, -0.1, -0.05, 0.0, 0.05, 0.1, 0.2, 0.4])
"""Where a peak is looked at, in units of its width."""
NOISE_BANDS = 6
EDGE = 1e-6
"""How near to an end of its range a number counts as being there, in units of its scale."""
STEP = 1e-6
"""Relative change of a number from which slopes are taken."""
SMOOTHED = 4
"""First instants at which the control signal of a search is not to be believed."""


@dataclass(frozen=True)
class TimeSpecification:
    """What is minimised, and under which bounds.

    Attributes
    ----------
    objective : Objective
    horizon : float
        Time over which the response counts [s].
    ms_max, u_max, noise_max : float
        Bounds on max |S|, on the control's peak after a unit setpoint step, and on max |C S| up to the Nyquist
        frequency of the controller; infinite for none.
    sample_time : float
        Tick of the controller as it will run [s].
    fixed : mapping
        Numbers of the controller that keep a value.
    bounds : mapping
        (low, high) of numbers, in place of the default box.
    """

    objective: Objective
    horizon: float
    ms_max: float = math.inf
    u_max: float = math.inf
    noise_max: float = math.inf
    sample_time: float = 0.01
    fixed: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Linearised:
    """Signals and bounds at one point and their slopes along its f free numbers, in units of the problem's scale.

    Attributes
    ----------
    cost : float
    signals : ndarray, shape (m,)
    signal_slopes : ndarray, shape (f, m)
    absolute, square : ndarray, shape (m,)
        Weights of the signals' absolute values and squares in the cost.
    slack : ndarray, shape (bounds,)
    slack_slopes : ndarray, shape (bounds, f)
    """

    cost: float
    signals: Real
    signal_slopes: Real
    absolute: Real
    square: Real
    slack: Real
    slack_slopes: Real


class TimeProblem:
    """Cost and bounds of many controllers at once, on one grid of instants and one of frequencies.

    Parameters
    ----------
    process : Process
    specification : TimeSpecification
    points : int, optional
        Number of time steps up to the horizon; chosen from the process when not given.
    density : int
        Frequencies in each band.
    watch_control : bool
        Whether the whole control signal is bounded, not its first sample only, which nearly always is the largest.
    watched : tuple of float
        Further frequencies that are looked at, as ln w.
    """

    def __init__(
        self,
        process: Process,
        specification: TimeSpecification,
        points: int | None = None,
        density: int = 20,
        watch_control: bool = False,
        watched: tuple[float, ...] = (),
    ) -> None:
        self.process, self.specification = process, specification
        self.density, self.watch_control, self.watched = density, watch_control, watched
        self.speed, self.gain = natural_crossover(process, PHASE_MARGIN), process_gain(process)
        self.points = points or enough_points(specification.horizon * self.speed)
        self.evaluations = 0
        self._grid = ResponseGrid(process, specification.horizon, self.points, self.speed)
        self._weights = specification.objective.time_weights(self._grid.time)
        grid = math.log(self.speed) + math.log(10.0) * np.linspace(-2.5, 2.5, density * BANDS)
        self._log_w = np.union1d(grid, [*_resonances(process, grid), *watched])
        self._w = np.exp(self._log_w)
        self._p = process(1j * self._w)
        nyquist = math.log(max(math.pi / specification.sample_time, self.speed))
        grid = np.linspace(math.log(0.1 * self.speed), nyquist, 60)
        self._log_noise_w = np.union1d(grid, [z for z in watched if z < nyquist])
        self._noise_p = process(1j * np.exp(self._log_noise_w))
        size = abs(self.gain)
        self.scale = np.array([1.0 / size, self.speed / size, 1.0 / (size * self.speed), 1.0, 1.0])
        self.box = self._box()

    def _box(self) -> Real:
        """Lowest and highest of each number, shape (5, 2)."""
        highest = math.copysign(LARGEST_GAIN, self.gain) * self.scale[:3]
        largest_mu = min(2.0, max(self.process.relative_degree, LEAST_ORDER))
        gains = np.sort(np.stack([0.0 * highest, highest], axis=1), axis=1)
        box = np.concatenate([gains, [[LEAST_ORDER, 2.0], [LEAST_ORDER, largest_mu]]])
        for name, bounds in self.specification.bounds.items():
            box[NUMBERS.index(name)] = bounds
        for name, value in self.specification.fixed.items():
            box[NUMBERS.index(name)] = value
        return box

    @property
    def free(self) -> NDArray[np.intp]:
        """Positions of the numbers that may change."""
        return np.flatnonzero(self.box[:, 0] < self.box[:, 1])

    def at_edge(self, gains: Real) -> tuple[str, ...]:
        """Which of the five numbers, if they are free and count, end on the edge of their range, in words."""
        idle = {"lam": gains[1] == 0.0, "mu": gains[2] == 0.0}
        texts = []
        for row in self.free:
            name, (low, high) = NUMBERS[row], self.box[row]
            if min(gains[row] - low, high - gains[row]) <= EDGE * self.scale[row] and not idle.get(name, False):
                texts.append(f"{name} = {gains[row]:.4g} (range {low:.4g} to {high:.4g})")
        return tuple(texts)

    def changed(self, **changes: int | bool | tuple[float, ...]) -> TimeProblem:
        """The same problem on other grids."""
        kept = {name: getattr(self, name) for name in ("points", "density", "watch_control", "watched")}
        return TimeProblem(self.process, self.specification, **(kept | changes))

    def restricted(self, numbers: Mapping[str, float]) -> TimeProblem:
        """The same problem with some of the five numbers kept at a value, or as near to it as the box lets them be."""
        other = copy.copy(self)
        other.box = self.box.copy()
        for name, value in numbers.items():
            row = NUMBERS.index(name)
            other.box[row] = np.clip(value, *self.box[row])
        return other

    def cost_and_slack(self, gains: Real) -> tuple[Real, Real]:
        """Cost (n,) and what is left to each bound (n, bounds), relative; negative where it is broken."""
        responses = self._responses(gains)
        cost = self.specification.objective.cost(responses, self._weights)
        return cost, self._slack(gains, responses.loop)

    def slack(self, gains: Real) -> Real:
        """What is left to each bound, shape (n, bounds)."""
        return self._slack(gains, self._p * _controller(gains, self._log_w))

    def linearised(self, gains: Real) -> Linearised:
        """The problem around one controller, from one batch of responses."""
        free = self.free
        step = np.where(gains[free] + STEP * self.scale[free] > self.box[free, 1], -STEP, STEP)
        rows = np.repeat(gains[None], len(free) + 1, axis=0)
        rows[1:, free] += np.diag(step * self.scale[free])
        responses = self._responses(rows)
        signals, (absolute, square) = responses.signals, self._weights
        slack = self._slack(rows, responses.loop)
        return Linearised(
            cost=float(np.abs(signals[0]) @ absolute + signals[0] ** 2 @ square),
            signals=signals[0],
            signal_slopes=(signals[1:] - signals[0]) / step[:, None],
            absolute=absolute,
            square=square,
            slack=slack[0],
            slack_slopes=((slack[1:] - slack[0]) / step[:, None]).T,
        )

    def winding(self, gains: Real) -> float:
        """How far 1 + L turns along the grid, less what its beginning accounts for [rad].

        Between two controllers one of which is stable and one is not, it jumps by a multiple of pi.
        """
        turned = 1.0 + self._p * _controller(gains[None], self._log_w)[0]
        turns = float(np.angle(turned[1:] / turned[:-1]).sum())
        return turns - 0.5 * math.pi * (float(gains[3]) + self.process.integrating_order)

    def largest_control(self, gains: Real) -> Real:
        """Peak of the control after a unit setpoint step, shape (n,), of the controller as it runs."""
        return np.asarray(np.abs(self._controls(gains)).max(axis=1))

    def later_control_breaks(self, gains: Real) -> bool:
        """Whether the control of one controller comes too near its bound after its first instants."""
        largest = np.abs(self._controls(gains[None])[0, SMOOTHED:]).max()
        return bool(largest > self.specification.u_max * (1.0 - SAFE_CONTROL))

    def final_error(self, gains: Real) -> float:
        """What is left of the error of one controller at the horizon."""
        return float(self._grid.errors(gains[None])[0, -1])

    def ms(self, gains: Real) -> Real:
        """Largest |S|, shape (n,)."""
        loop = self._p * _controller(gains, self._log_w)
        return np.asarray(np.exp(-_least_in_bands(_log_size(1.0 + loop), self._log_w, BANDS).min(axis=1)))

    def noise_gain(self, gains: Real) -> Real:
        """Largest |C S| up to the Nyquist frequency, shape (n,)."""
        return np.asarray(np.exp(-self._noise(gains).min(axis=1)))

    def _noise(self, gains: Real) -> Real:
        """Negative logarithm of the largest |C S| in each of some bands, shape (n, bands)."""
        controller = _controller(gains, self._log_noise_w)
        size = _log_size(1.0 + controller * self._noise_p) - _log_size(controller)
        return _least_in_bands(size, self._log_noise_w, NOISE_BANDS)

    def _responses(self, gains: Real) -> LoopResponses:
        self.evaluations += len(gains)
        loop = self._p * _controller(gains, self._log_w)
        controls = self._controls(gains) if self.specification.objective.needs_control else None
        return LoopResponses(self._grid.time, self._grid.errors(gains), controls, self._w, loop)

    def _controls(self, gains: Real) -> Real:
        controls = self._grid.controls(gains)
        controls[:, 1:SMOOTHED] = controls[:, SMOOTHED : SMOOTHED + 1]
        controls[:, 0] = first_control(gains, self.specification.sample_time)
        return controls

    def _slack(self, gains: Real, loop: Complex) -> Real:
        bounds = self.specification
        columns: list[Real] = []
        if math.isfinite(bounds.ms_max):
            least = _least_in_bands(_log_size(1.0 + loop), self._log_w, BANDS)
            columns += list(math.log(bounds.ms_max) + least.T)
        if math.isfinite(bounds.u_max):
            columns.append(1.0 - np.abs(first_control(gains, bounds.sample_time)) / bounds.u_max)
            if self.watch_control:
                controls = -np.abs(self._controls(gains)[:, SMOOTHED:]) / bounds.u_max
                columns += list(1.0 - SAFE_CONTROL + _least_in_bands(controls, self._grid.time[SMOOTHED:], BANDS).T)
        if math.isfinite(bounds.noise_max):
            columns += list(math.log(bounds.noise_max) + self._noise(gains).T)
        return np.stack(columns, axis=1) - SAFE if columns else np.ones((len(gains), 1))


def enough_points(turns: float) -> int:
    """A power of two of time steps for a horizon of so many radians of the natural crossover."""
    return 1 << math.ceil(math.log2(max(8.0 * turns, 256.0)))


def _controller(gains: Real, log_w: Real) -> Complex:
    """C(j w) for rows of gains, shape (n, frequencies)."""
    kp, ki, kd, lam, mu = gains.T[..., None]
    integral = ki * np.exp(-0.5j * math.pi * lam) * np.exp(-lam * log_w)
    return np.asarray(kp + integral + kd * np.exp(0.5j * math.pi * mu) * np.exp(mu * log_w))


def _log_size(values: Complex) -> Real:
    with np.errstate(divide="ignore"):
        return np.asarray(0.5 * np.log(values.real**2 + values.imag**2))


def _least_in_bands(values: Real, position: Real, bands: int) -> Real:
    """The least value in each of some bands along the second axis, between points by a parabola, shape (n, bands)."""
    edges = np.linspace(0, values.shape[1], bands + 1).astype(int)
    columns = [first + values[:, first:last].argmin(axis=1) for first, last in itertools.pairwise(edges.tolist())]
    least = np.stack(columns, axis=1)
    rows, at = np.arange(len(values))[:, None], np.clip(least, 1, values.shape[1] - 2)
    before, here, after = values[rows, at - 1], values[rows, at], values[rows, at + 1]
    left, right = position[at] - position[at - 1], position[at + 1] - position[at]
    fall, rise = (before - here) / left, (after - here) / right
    bend = (fall + rise) / (left + right)
    slope = (rise * left - fall * right) / (left + right)
    with np.errstate(divide="ignore", invalid="ignore"):
        bottom = here - 0.25 * slope**2 / bend
    lowest = (at == least) & (fall >= 0.0) & (rise >= 0.0) & np.isfinite(bottom)
    return np.asarray(np.where(lowest, bottom, values[rows, least]))


def around(peak: float, width: float) -> tuple[float, ...]:
    """Where to look at a peak of so much width, as ln w."""
    return tuple((peak + width * AROUND).tolist())


def _resonances(process: Process, grid: Real) -> Real:
    """The points ln w, closer together than the grid, that show the poles of a process near the axis."""
    z = right_half_plane_zeros(process.denominator).log_frequency
    close = np.flatnonzero(np.diff(z) < 0.5 * (grid[1] - grid[0]))
    fine: Real = z[np.union1d(close, close + 1)]
    inside: Real = fine[(fine > grid[0]) & (fine < grid[-1])]
    return inside
