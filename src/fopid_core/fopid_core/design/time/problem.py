"""Time-domain tuning as an optimisation problem: the cost of many controllers, and what is left to their bounds."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fopid_core.design.defaults import PHASE_MARGIN, U_MAX, natural_crossover, process_gain
from fopid_core.design.load_tail import LoadTail, slowest_crossover
from fopid_core.design.specification import NUMBERS
from fopid_core.design.time.bands import SMALLEST, least_in_bands, log_size, smooth_places
from fopid_core.design.time.control_bounds import ControlBounds
from fopid_core.design.time.objectives import LoopResponses
from fopid_core.design.time.sampled_bound import SampledBound
from fopid_core.design.time.search_response import ResponseGrid, Variables
from fopid_core.design.time.specification import TimeSpecification
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process
from fopid_core.model.stability import stable_mask
from fopid_core.model.two_degrees import MeasurementFilter, SetpointWeights
from fopid_core.model.winding import right_half_plane_zeros

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

LARGEST_GAIN = 500.0
"""Of the paper's box, section 4.1; here in units of the process's gain and time, and from 0 on."""
FAR_BELOW = 0.1
"""A process whose gain falls to such a share of its own before a controller would act is measured by that there."""
BANDS = 12
"""A largest value counts as one for each of so many bands: each is smooth in the gains where their maximum is not."""
LEAST_ORDER = 0.05
"""Of an integral and of a derivative."""
FILTER_TIMES = (1e-2, 3.0)
"""Of the filter of the measurement, in units of the process's time."""
LEAST_TICKS = 0.2
"""The shortest filter, in ticks: of what it holds one tick leaves exp(-5); shorter ones run alike."""
FILTER_SCALE = 0.1
"""What a filter's time is measured in, in these units."""
SAFE = 3e-5
"""Share of a bound that is kept clear of in a search, for what its grids do not show."""
NOISE_BANDS = 6
NOISE_GRID = {False: (0.1, 60), True: (3e-3, 160)}
"""Lowest frequency, in units of the natural crossover, and points; an integral also counts a slow loop's resonance."""
EDGE = 1e-6
"""How near to an end of its range a number counts as being there, in units of its scale."""
STEP = 1e-6
"""Relative change of a number from which slopes are taken."""
SAFE_RMS = 1e-3
"""The same for an integral over the grid of frequencies."""


@dataclass(frozen=True)
class Linearised:
    """Signals and bounds at one point and their slopes along its f free variables, in units of the problem's scale.

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


@dataclass(frozen=True)
class Sizes:
    """Logarithms of sizes of n loops over both grids of frequencies, that of the loop and behind it that of the noise.

    With L = P C F nothing is divided by the filter: S = (1 / F) / (1 / F + P C) and C F S = C / (1 / F + P C).

    Attributes
    ----------
    difference : ndarray, shape (n, both)
        Of 1 / F + P C.
    controller : ndarray, shape (n, both)
        Of C.
    inverse_filter : ndarray, shape (n, frequencies) or (1,)
        Of 1 / F, for the loop alone.
    """

    difference: Real
    controller: Real
    inverse_filter: Real


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
    bands : int
        Of max |S| and max |T|: the more, the fewer have two peaks of the same height, which have no one slope.
    watch_control : bool
        Whether the whole control signal is bounded, not its first sample only, which nearly always is the largest.
    watched : tuple of float
        Further frequencies that are looked at, as ln w.
    drawn_in : tuple of float
        Shares of the bounds on the control's size and on its moves that are kept clear of besides, for what the grid
        of instants does not show.
    """

    def __init__(
        self,
        process: Process,
        specification: TimeSpecification,
        points: int | None = None,
        density: int = 20,
        watch_control: bool = False,
        watched: tuple[float, ...] = (),
        bands: int = BANDS,
        drawn_in: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self.process, self.specification = process, specification
        self.density, self.watch_control, self.watched, self.drawn_in = density, watch_control, watched, drawn_in
        self.bands = bands
        self.speed = min(natural_crossover(process, PHASE_MARGIN), specification.fastest)
        steady = process_gain(process)
        self.gain, self._load_step = _gain_at_work(process, steady, self.speed, specification.u_max), 1.0 / abs(steady)
        self.points = points or enough_points(specification.horizon * self.speed)
        self.evaluations = 0
        self.variables = specification.variables
        self._grid = ResponseGrid(process, specification.horizon, self.points, self.speed, specification.filter_order)
        parts = [self.load_weight if source == "load" else 1.0 for source in self.sources]
        self._weights = specification.objective.time_weights(self._grid.time, parts)
        grid = math.log(self.speed) + math.log(10.0) * np.linspace(-2.5, 2.5, density * bands)
        self._log_w = np.union1d(grid, [*_resonances(process, grid), *watched])
        self._w = np.exp(self._log_w)
        self._places = smooth_places(self._log_w, process.delay)
        self._p = process(1j * self._w)
        nyquist = math.log(max(math.pi / specification.sample_time, self.speed))
        lowest, count = NOISE_GRID[specification.bounds_noise_rms]
        count *= 2 if bands > BANDS else 1
        grid = np.linspace(math.log(lowest * self.speed), nyquist, count)
        self._log_noise_w = np.union1d(grid, [z for z in watched if z < nyquist])
        self._noise_places = smooth_places(self._log_noise_w, process.delay)
        self._both_log_w = np.concatenate([self._log_w, self._log_noise_w])
        self._both_s = 1j * np.exp(self._both_log_w)
        self._both_p = process(self._both_s)
        self._log_p = log_size(self._p)
        self._load_tail = LoadTail(process, slowest_crossover(process, specification.horizon, specification.u_max))
        size, time = abs(self.gain), 1.0 / self.speed
        scale = [1.0 / size, self.speed / size, time / size, 1.0, 1.0, FILTER_SCALE * time, 1.0, 1.0]
        self.scale = np.array(scale[: len(self.variables)])
        self.box = self._box()
        self._control = ControlBounds(self._grid, specification, process.delay, drawn_in)
        self._sampled = specification.sampled and SampledBound(
            specification.sampled, specification.sample_time, specification.filter_order
        )

    @property
    def sources(self) -> tuple[str, ...]:
        """Where the steps come in whose responses count."""
        source = self.specification.input
        return ("setpoint", "load") if source == "both" else (source,)

    @property
    def load_weight(self) -> float:
        """Of the load's index; its step is scaled apart."""
        return self.specification.load_weight if self.specification.input == "both" else 1.0

    def _box(self) -> Real:
        """Lowest and highest of each variable, shape (5, 2) or (8, 2)."""
        asked, names = self.specification, self.variables
        highest = math.copysign(LARGEST_GAIN, self.gain) * self.scale[:3]
        degree = self.process.relative_degree + asked.filter_order
        gains = np.sort(np.stack([0.0 * highest, highest], axis=1), axis=1)
        orders = [[LEAST_ORDER, 2.0], [LEAST_ORDER, min(2.0, max(degree, LEAST_ORDER))]]
        shortest, longest = np.array(FILTER_TIMES) / self.speed
        shortest = min(max(shortest, LEAST_TICKS * asked.sample_time), longest)
        slow = [shortest, longest] if asked.filter_order else [0.0, 0.0]
        weights = [0.0 if asked.two_degrees else 1.0, 1.0]
        box = np.concatenate([gains, orders, [slow, weights, weights]])[: len(names)]
        for name, bounds in asked.bounds.items():
            box[names.index(name)] = bounds
        for name, value in asked.fixed.items():
            box[names.index(name)] = value
        return box

    @property
    def free(self) -> NDArray[np.intp]:
        """Positions of the variables that may change."""
        return np.flatnonzero(self.box[:, 0] < self.box[:, 1])

    def row(self, gains: tuple[float, ...]) -> Real:
        """Variables from a controller's five numbers, the others in the middle of their range, shape (1, variables)."""
        rest = np.exp(np.log(np.maximum(self.box[5:], 1e-300)).mean(axis=1)) if len(self.variables) > 5 else []
        return np.asarray(np.clip([[*gains, *rest]], *self.box.T))

    def loop(self, row: Real) -> Loop:
        """The loop that a row of variables stands for."""
        numbers = row.tolist()
        controller = Fopid(*numbers[:5])
        if len(numbers) == 5:
            return Loop(self.process, controller)
        slow = MeasurementFilter(self.specification.filter_order, numbers[5])
        return Loop(self.process, controller, slow, SetpointWeights(*numbers[6:]))

    def stable(self, rows: Real) -> NDArray[np.bool_]:
        """Which rows give a stable loop for certain, shape (n,)."""
        if not len(rows):
            return np.zeros(0, dtype=bool)
        times = rows[:, 5] if len(self.variables) > 5 else 0.0
        stable = stable_mask(self.process, rows[:, :5], times, self.specification.filter_order)
        return stable & self._sampled.stable(rows) if self._sampled else stable

    def at_edge(self, gains: Real) -> tuple[str, ...]:
        """Which of the five numbers, if they are free and count, end on the edge of their range, in words."""
        idle = {"lam": gains[1] == 0.0, "mu": gains[2] == 0.0}
        texts = []
        for row in self.free[self.free < len(NUMBERS)]:
            name, (low, high) = NUMBERS[row], self.box[row]
            if min(gains[row] - low, high - gains[row]) <= EDGE * self.scale[row] and not idle.get(name, False):
                texts.append(f"{name} = {gains[row]:.4g} (range {low:.4g} to {high:.4g})")
        return tuple(texts)

    def changed(self, **changes: Any) -> TimeProblem:
        """The same problem on other grids."""
        kept = ("points", "density", "watch_control", "watched", "bands", "drawn_in")
        return TimeProblem(self.process, self.specification, **({name: getattr(self, name) for name in kept} | changes))

    def restricted(self, numbers: Mapping[str, float]) -> TimeProblem:
        """The same problem with some variables kept at a value, or as near to it as the box lets them be."""
        other = copy.copy(self)
        other.box = self.box.copy()
        for name, value in numbers.items():
            row = self.variables.index(name)
            other.box[row] = np.clip(value, *self.box[row])
        return other

    def cost_and_slack(self, gains: Real) -> tuple[Real, Real]:
        """Cost (n,) and what is left to each bound (n, bounds), relative; negative where it is broken."""
        return self.cost(gains), self.slack(gains)

    def cost(self, gains: Real) -> Real:
        """Cost alone, shape (n,)."""
        return self.specification.objective.cost(self._responses(gains), self._weights)

    def slack(self, gains: Real) -> Real:
        """What is left to each bound, shape (n, bounds)."""
        bounds, blocks = self.specification, []
        sizes = self._sizes(gains)
        if math.isfinite(bounds.ms_max):
            blocks.append(math.log(bounds.ms_max) + self._sensitivity(sizes))
            blocks += [self._sampled.slack(gains, bounds.ms_max)] if self._sampled else []
        if math.isfinite(bounds.mt_max):
            blocks.append(math.log(bounds.mt_max) + self._complementary(sizes))
        if math.isfinite(bounds.u_max):
            blocks += self._control.size_slack(gains, self.watch_control)
        if math.isfinite(bounds.noise_max) or bounds.bounds_noise_rms:
            blocks += self._noise_slack(self._noise(sizes))
        if math.isfinite(bounds.rate_max):
            blocks += self._control.move_slack(gains)
        if math.isfinite(bounds.load_left_max):
            left = np.maximum(self._load_tail.left(gains[:, : len(NUMBERS)]), SMALLEST)
            blocks.append(np.log(bounds.load_left_max / left)[:, None])
        return np.concatenate(blocks, axis=1) - SAFE if blocks else np.ones((len(gains), 1))

    def linearised(self, gains: Real) -> Linearised:
        """The problem around one controller, from one batch of responses."""
        free = self.free
        step = np.where(gains[free] + STEP * self.scale[free] > self.box[free, 1], -STEP, STEP)
        rows = np.repeat(gains[None], len(free) + 1, axis=0)
        rows[1:, free] += np.diag(step * self.scale[free])
        responses = self._responses(rows)
        signals, (absolute, square) = responses.signals, self._weights
        slack = self.slack(rows)
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
        turned = 1.0 + self._loop(gains[None])[0]
        turns = float(np.angle(turned[1:] / turned[:-1]).sum())
        return turns - 0.5 * math.pi * (float(gains[3]) + self.process.integrating_order)

    def largest_control(self, gains: Real) -> Real:
        """Peak of the control after a unit setpoint step, shape (n,), of the controller as it runs."""
        return self._control.largest(gains)

    def later_control_breaks(self, gains: Real) -> bool:
        """Whether the control of one controller comes too near its bound after its first instants."""
        return self._control.later_breaks(gains)

    def final_error(self, gains: Real) -> float:
        """The largest share of a step's error that is left at the horizon, of one controller."""
        errors = self._errors(gains[None])[:, 0]
        return float(np.max(np.abs(errors[:, -1]) / np.maximum(np.abs(errors).max(axis=1), SMALLEST)))

    def ms(self, gains: Real) -> Real:
        """Largest |S|, shape (n,)."""
        return np.asarray(np.exp(-self._sensitivity(self._sizes(gains)).min(axis=1)))

    def mt(self, gains: Real) -> Real:
        """Largest |T|, shape (n,)."""
        return np.asarray(np.exp(-self._complementary(self._sizes(gains)).min(axis=1)))

    def noise_gain(self, gains: Real) -> Real:
        """Largest |C F S| up to the Nyquist frequency, shape (n,)."""
        noise = self._noise(self._sizes(gains))
        return np.asarray(np.exp(-least_in_bands(noise, self._noise_places, NOISE_BANDS).min(axis=1)))

    def _loop(self, gains: Real) -> Complex:
        """L(j w), shape (n, frequencies)."""
        return self._p * self._variables(gains).feedback(self._log_w)

    def _variables(self, gains: Real) -> Variables:
        return Variables(gains, self.specification.filter_order)

    def _sizes(self, gains: Real) -> Sizes:
        v = self._variables(gains)
        controller = v.controller(self._both_log_w)
        if not v.has_filter:
            return Sizes(log_size(1.0 + self._both_p * controller), log_size(controller), np.zeros(1))
        slow = v.inverse_filter(self._both_s)
        return Sizes(
            log_size(slow + self._both_p * controller), log_size(controller), log_size(slow[:, : len(self._w)])
        )

    def _sensitivity(self, sizes: Sizes) -> Real:
        """Negative logarithm of the largest |S| in each band, shape (n, bands)."""
        return least_in_bands(sizes.difference[:, : len(self._w)] - sizes.inverse_filter, self._places, self.bands)

    def _complementary(self, sizes: Sizes) -> Real:
        """The same of |T|."""
        here = slice(len(self._w))
        inverse = sizes.difference[:, here] - sizes.controller[:, here] - self._log_p
        return least_in_bands(inverse, self._places, self.bands)

    def _noise(self, sizes: Sizes) -> Real:
        """Negative logarithm of |C F S|, shape (n, frequencies)."""
        return sizes.difference[:, len(self._w) :] - sizes.controller[:, len(self._w) :]

    def _noise_rms(self, noise: Real) -> Real:
        """Logarithm of the root mean square of the control that the noise makes, shape (n,)."""
        w = np.exp(self._log_noise_w)
        power = np.exp(-2.0 * noise)
        whole = 0.5 * np.sum((power[:, 1:] + power[:, :-1]) * np.diff(w), axis=1) + power[:, 0] * w[0]
        power = self.specification.noise_density / math.pi * np.maximum(whole, 1e-300)  # no gains, no control
        return np.asarray(0.5 * np.log(power))

    def _errors(self, gains: Real) -> Real:
        """Of each step that counts, shape (steps, n, instants); beside a setpoint, the load's step is 1 / gain."""
        size = self._load_step if self.specification.input == "both" else 1.0
        grid = self._grid
        parts = grid.parts(gains)
        return np.stack(
            [
                grid.errors(gains, parts) if source == "setpoint" else size * grid.load_errors(gains, parts)
                for source in self.sources
            ]
        )

    def _responses(self, gains: Real) -> LoopResponses:
        self.evaluations += len(gains)
        controls = self._control.running(gains) if self.specification.objective.needs_control else None
        errors = np.concatenate([*self._errors(gains)], axis=1)
        loop = None if self.specification.objective.is_integral else self._loop(gains)
        return LoopResponses(self._grid.time, errors, controls, self._w, loop)

    def _noise_slack(self, noise: Real) -> list[Real]:
        bounds, blocks = self.specification, []
        if math.isfinite(bounds.noise_max):
            least = least_in_bands(noise, self._noise_places, NOISE_BANDS)
            blocks.append(math.log(bounds.noise_max) + least)
        if bounds.bounds_noise_rms:
            blocks.append(math.log(bounds.noise_rms_max) - SAFE_RMS - self._noise_rms(noise)[:, None])
        return blocks


def enough_points(turns: float) -> int:
    """A power of two of time steps for a horizon of so many radians of the natural crossover."""
    return 1 << math.ceil(math.log2(max(8.0 * turns, 256.0)))


def _resonances(process: Process, grid: Real) -> Real:
    """The points ln w, closer together than the grid, that show the poles of a process near the axis."""
    z = right_half_plane_zeros(process.denominator).log_frequency
    close = np.flatnonzero(np.diff(z) < 0.5 * (grid[1] - grid[0]))
    fine: Real = z[np.union1d(close, close + 1)]
    inside: Real = fine[(fine > grid[0]) & (fine < grid[-1])]
    return inside


def _gain_at_work(process: Process, steady: float, speed: float, u_max: float) -> float:
    """What gains are measured against: the process's gain, or far less where it works, if the control has the room.

    A near-integrator's steady-state gain tells nothing of the gains it needs, and a record may not even show it.
    """
    at_work = max(abs(complex(process(1j * speed))), U_MAX / u_max)
    return math.copysign(at_work, steady) if at_work < FAR_BELOW * abs(steady) else steady
