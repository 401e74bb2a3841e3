"""Time-domain tuning as an optimisation problem: the cost of many controllers, and what is left to their bounds."""

from __future__ import annotations

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

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

LARGEST_GAIN = 500.0
"""Of the paper's box, section 4.1; here in units of the process's gain and time, and from 0 on."""
BANDS = 12
"""A largest value counts as one for each of so many bands: each is smooth in the gains where their maximum is not."""
PROPER = 0.05
"""How far mu stays below the process's relative degree: at it the loop gain does not vanish at high frequency."""
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
    """

    def __init__(
        self,
        process: Process,
        specification: TimeSpecification,
        points: int | None = None,
        density: int = 20,
        watch_control: bool = False,
    ) -> None:
        self.process, self.specification = process, specification
        self.density, self.watch_control = density, watch_control
        self.speed, self.gain = natural_crossover(process, PHASE_MARGIN), process_gain(process)
        self.points = points or enough_points(specification.horizon * self.speed)
        self.evaluations = 0
        self._grid = ResponseGrid(process, specification.horizon, self.points, self.speed)
        self._weights = specification.objective.time_weights(self._grid.time)
        self._w = self.speed * np.logspace(-2.5, 2.5, density * BANDS)
        self._log_w, self._p = np.log(self._w), process(1j * self._w)
        nyquist = max(math.pi / specification.sample_time, self.speed)
        noise_w = np.geomspace(0.1 * self.speed, nyquist, 60)
        self._log_noise_w, self._noise_p = np.log(noise_w), process(1j * noise_w)
        size = abs(self.gain)
        self.scale = np.array([1.0 / size, self.speed / size, 1.0 / (size * self.speed), 1.0, 1.0])
        self.box = self._box()

    def _box(self) -> Real:
        """Lowest and highest of each number, shape (5, 2)."""
        highest = math.copysign(LARGEST_GAIN, self.gain) * self.scale[:3]
        largest_mu = min(2.0, max(self.process.relative_degree - PROPER, PROPER))
        gains = np.sort(np.stack([0.0 * highest, highest], axis=1), axis=1)
        box = np.concatenate([gains, [[PROPER, 2.0], [PROPER, largest_mu]]])
        for name, bounds in self.specification.bounds.items():
            box[NUMBERS.index(name)] = bounds
        for name, value in self.specification.fixed.items():
            box[NUMBERS.index(name)] = value
        return box

    @property
    def free(self) -> NDArray[np.intp]:
        """Positions of the numbers that may change."""
        return np.flatnonzero(self.box[:, 0] < self.box[:, 1])

    def changed(self, **changes: int | bool) -> TimeProblem:
        """The same problem on other grids."""
        kept = {"points": self.points, "density": self.density, "watch_control": self.watch_control}
        return TimeProblem(self.process, self.specification, **(kept | changes))  # type: ignore[arg-type]

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

    def final_error(self, gains: Real) -> float:
        """What is left of the error of one controller at the horizon."""
        return float(self._grid.errors(gains[None])[0, -1])

    def ms(self, gains: Real) -> Real:
        """Largest |S|, shape (n,)."""
        return np.asarray(1.0 / np.abs(1.0 + self._p * _controller(gains, self._log_w)).min(axis=1))

    def noise_gain(self, gains: Real) -> Real:
        """Largest |C S| up to the Nyquist frequency, shape (n,)."""
        controller = _controller(gains, self._log_noise_w)
        return np.asarray(np.abs(controller / (1.0 + controller * self._noise_p)).max(axis=1))

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
            columns += list(np.log(bounds.ms_max * _least_in_bands(np.abs(1.0 + loop))).T)
        if math.isfinite(bounds.u_max):
            columns.append(1.0 - np.abs(first_control(gains, bounds.sample_time)) / bounds.u_max)
            if self.watch_control:
                columns += list(1.0 + _least_in_bands(-np.abs(self._controls(gains))).T / bounds.u_max)
        if math.isfinite(bounds.noise_max):
            columns.append(1.0 - self.noise_gain(gains) / bounds.noise_max)
        return np.stack(columns, axis=1) if columns else np.ones((len(gains), 1))


def enough_points(turns: float) -> int:
    """A power of two of time steps for a horizon of so many radians of the natural crossover."""
    return 1 << math.ceil(math.log2(max(8.0 * turns, 256.0)))


def _controller(gains: Real, log_w: Real) -> Complex:
    """C(j w) for rows of gains, shape (n, frequencies)."""
    kp, ki, kd, lam, mu = gains.T[..., None]
    integral = ki * np.exp(-0.5j * math.pi * lam) * np.exp(-lam * log_w)
    return np.asarray(kp + integral + kd * np.exp(0.5j * math.pi * mu) * np.exp(mu * log_w))


def _least_in_bands(values: Real) -> Real:
    """The least value in each of the bands along the second axis, shape (n, BANDS)."""
    edges = np.linspace(0, values.shape[1], BANDS, endpoint=False).astype(int)
    return np.asarray(np.minimum.reduceat(values, edges, axis=1))
