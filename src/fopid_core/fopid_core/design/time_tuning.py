"""Time-domain tuning, eqs. (23) to (30): the best index of the step response under bounds.

Every index of the error asks for more gain without end, so bounds belong to the specification: on max |S|, on the peak
of the control of the controller as it runs, and on the gain from measurement noise to control. The optimiser is
sequential quadratic programming from the best of many designs that lie on the bounds already; all of a step's gradient
comes from one batch of responses. An unstable loop never wins: what is handed out was decided by the argument principle
on the process itself.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fopid_core.design.control_peak import first_control
from fopid_core.design.defaults import natural_crossover, process_gain
from fopid_core.design.objectives import Behaviour, Objective
from fopid_core.design.search_response import ResponseGrid
from fopid_core.design.specification import NUMBERS
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process
from fopid_core.model.stability import stable_mask

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

BANDS = 12  # |S| counts as the largest in each of so many bands: each is smooth in the gains where their maximum is not
LARGEST_GAIN = 500.0  # of the paper's box, section 4.1, in units of the process's gain and time
UNSTABLE = 1e3  # relative cost of a loop that is not stable any more
STEP = 1e-6  # relative change of a number from which gradients are taken


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


class TimeProblem:
    """Cost and bounds of many controllers at once, on one grid of instants and one of frequencies.

    Parameters
    ----------
    process : Process
    specification : TimeSpecification
    points : int
        Number of time steps up to the horizon.
    """

    def __init__(self, process: Process, specification: TimeSpecification, points: int) -> None:
        self.process, self.specification, self.points = process, specification, points
        self.speed = natural_crossover(process, math.radians(60.0))
        self.gain = process_gain(process)
        self.grid = ResponseGrid(process, specification.horizon, points, self.speed)
        self.w = self.speed * np.logspace(-2.5, 2.5, 20 * BANDS)
        self._log_w = np.log(self.w)
        self._p = process(1j * self.w)
        nyquist = math.pi / specification.sample_time
        self._noise_w = np.logspace(math.log10(self.speed) - 1.0, math.log10(max(nyquist, self.speed)), 60)
        self.evaluations = 0

    @cached_property
    def box(self) -> Real:
        """Lowest and highest of each number, shape (5, 2)."""
        highest = LARGEST_GAIN / self.gain * np.array([1.0, self.speed, 1.0 / self.speed])
        order = min(2.0, max(self.process.relative_degree - 0.05, 0.05))
        box = np.array([*np.sort(np.stack([0.0 * highest, highest], axis=1)), [0.05, 2.0], [0.05, order]])
        for name, bounds in self.specification.bounds.items():
            box[NUMBERS.index(name)] = bounds
        for name, value in self.specification.fixed.items():
            box[NUMBERS.index(name)] = value
        return box

    @cached_property
    def scale(self) -> Real:
        """Units in which the numbers are of order one, shape (5,)."""
        k = abs(self.gain)
        return np.array([1.0 / k, self.speed / k, 1.0 / (k * self.speed), 1.0, 1.0])

    def controller(self, gains: Real, s: Complex | Real) -> Complex:
        """C(j w) for rows of gains at frequencies, shape (n, frequencies)."""
        kp, ki, kd, lam, mu = gains.T[..., None]
        integral = ki * np.exp(-0.5j * math.pi * lam) * np.exp(-lam * np.log(s))
        return kp + integral + kd * np.exp(0.5j * math.pi * mu) * np.exp(mu * np.log(s))

    def cost_and_slack(self, gains: Real) -> tuple[Real, Real]:
        """Cost (n,) and what is left to each bound (n, bounds), relative; negative where it is broken."""
        self.evaluations += len(gains)
        loop = self._p * self.controller(gains, self.w)
        behaviour = Behaviour(self.grid.time, self.grid.errors(gains), self._controls(gains), self.w, loop)
        return self.specification.objective.cost(behaviour), self._slack(gains, loop)

    def linearise(self, gains: Real, free, scale) -> Real:
        x = gains[free] / scale
        high = self.box[free, 1] / scale
        h = np.where(x + STEP > high, -STEP, STEP)
        rows = np.repeat(gains[None], len(free) + 1, axis=0)
        rows[1:, free] += np.diag(h * scale)
        self.evaluations += len(rows)
        loop = self._p * self.controller(rows, self.w)
        behaviour = Behaviour(self.grid.time, self.grid.errors(rows), self._controls(rows), self.w, loop)
        residuals, absolute, square = self.specification.objective.parts(behaviour)
        slack = self._slack(rows, loop)
        return Linear(float(np.abs(residuals[0])@absolute+residuals[0]**2@square), residuals[0], (residuals[1:] - residuals[0]) / h[:, None], absolute, square, slack[0], ((slack[1:] - slack[0]) / h[:, None]).T)

    def slack(self, gains: Real) -> Real:
        """What is left to each bound, shape (n, bounds)."""
        return self._slack(gains, self._p * self.controller(gains, self.w))

    def winding(self, gains: Real) -> float:
        """How far 1 + L turns along the grid more than its beginning accounts for [rad]; it jumps where the loop
        becomes unstable."""
        turned = 1.0 + self._p * self.controller(gains[None], self.w)[0]
        turns = float(np.angle(turned[1:] / turned[:-1]).sum())
        return turns - 0.5 * math.pi * (gains[3] + self.process.integrating_order)

    def _controls(self, gains: Real) -> Real | None:
        if not self.specification.objective.needs_control:
            return None
        controls = self.grid.controls(gains)
        controls[:, 0] = first_control(gains, self.specification.sample_time)
        return controls

    def _slack(self, gains: Real, loop: Complex) -> Real:
        specification = self.specification
        columns = []
        if math.isfinite(specification.ms_max):
            s_gain = 1.0 / np.abs(1.0 + loop)
            worst = s_gain.reshape(len(gains), BANDS, -1).max(axis=2)
            columns += list(np.log(specification.ms_max / worst).T)
        if math.isfinite(specification.u_max):
            columns.append(1.0 - np.abs(first_control(gains, specification.sample_time)) / specification.u_max)
        if math.isfinite(specification.noise_max):
            columns.append(1.0 - self._noise_gain(gains) / specification.noise_max)
        return np.stack(columns, axis=1) if columns else np.ones((len(gains), 1))

    def _noise_gain(self, gains: Real) -> Real:
        controller = self.controller(gains, self._noise_w)
        return np.abs(controller / (1.0 + controller * self.process(1j * self._noise_w))).max(axis=1)


@dataclass(frozen=True)
class Linear:
    cost: float
    residual: Real
    jacobian: Real
    absolute: Real
    square: Real
    slack: Real
    slack_slope: Real


def starts(problem: TimeProblem, seed: int, shapes: int = 96, most: int = 6) -> Real:
    """Rows of gains that are stable, lie about on the bounds and have the lowest cost, shape (at most ``most``, 5)."""
    drawn = _on_the_bounds(problem, _shapes(problem, seed, shapes))
    drawn = drawn[stable_mask(problem.process, drawn)]
    if not len(drawn):
        raise InputError(f"process {problem.process}: no stable start found; allowed: give a start")
    cost, slack = problem.cost_and_slack(drawn)
    broken = np.minimum(slack.min(axis=1), 0.0)
    rank = np.lexsort((cost, -np.round(broken, 2)))
    return drawn[rank[:most]]


def _shapes(problem: TimeProblem, seed: int, count: int) -> Real:
    """Controllers of gain 1 at the process's own crossover, with parts and orders drawn at random within the box."""
    rng = np.random.default_rng(seed)
    parts = np.exp(rng.uniform(np.log([0.3, 0.1, 0.03]), np.log([1.0, 1.5, 1.5]), size=(count, 3)))
    orders = rng.uniform([0.7, 0.3], [1.4, 1.7], size=(count, 2))
    orders[: count // 4] = [1.0, 0.95]
    shapes = np.concatenate([parts * problem.scale[:3] * np.sign(problem.gain), orders], axis=1)
    low, high = problem.box.T
    return np.clip(shapes, low, high)


def _on_the_bounds(problem: TimeProblem, shapes: Real) -> Real:
    """Each shape with the largest of many gains at which no bound is broken, else with the least broken."""
    factors = np.geomspace(1e-2, 1e2, 33)
    low, high = problem.box.T
    tried = np.repeat(shapes[:, None], len(factors), axis=1)
    tried[:, :, :3] *= factors[:, None]
    tried = np.clip(tried, low, high)
    worst = problem.slack(tried.reshape(-1, 5)).min(axis=1).reshape(len(shapes), -1)
    fits = worst >= 0.0
    best = np.where(fits.any(axis=1), fits.shape[1] - 1 - fits[:, ::-1].argmax(axis=1), worst.argmax(axis=1))
    return tried[np.arange(len(shapes)), best]


@dataclass(frozen=True)
class Optimum:
    """Where an optimiser ended.

    Attributes
    ----------
    gains : ndarray, shape (5,)
    cost : float
    slack : float
        What is left to the tightest bound, relative; negative when it is broken.
    """

    gains: Real
    cost: float
    slack: float


def descend(problem: TimeProblem, start: Real, iterations: int = 40, verbose=False) -> Optimum:
    """Gauss-Newton with linearised bounds in a trust region, from one start.

    Absolute values are squares divided by themselves: |e| = e^2 / |e| with the denominator of the last step (iteratively
    reweighted least squares), so that the curvature of every index is known and none has to be learnt.
    """
    box = problem.box
    free = np.flatnonzero(box[:, 0] < box[:, 1])
    scale = problem.scale[free]
    low, high = box[free].T / scale
    here = np.clip(start, *box.T)
    radius = 0.3
    point = problem.linearise(here, free, scale)
    winding = problem.winding(here)
    penalty = 10.0
    floor = 0.1
    for it in range(iterations):
        x = here[free] / scale
        weights = point.absolute / np.maximum(np.abs(point.residual), floor * np.abs(point.residual).max()*0.01) + 2*point.square
        weighted = point.jacobian * weights
        hessian = weighted @ point.jacobian.T
        gradient = weighted @ point.residual
        reach = radius * np.maximum(np.abs(x), 0.2)
        step = constrained_step(hessian, gradient, point.slack - 1e-4, point.slack_slope,
                                np.maximum(low - x, -reach), np.minimum(high - x, reach))
        new = here.copy()
        new[free] = np.clip(x + step, low, high) * scale
        nxt = problem.linearise(new, free, scale)
        def merit(p): return p.cost / point.cost + penalty * np.maximum(-p.slack, 0.0).max()
        better = merit(nxt) < merit(point) and abs(problem.winding(new) - winding) < 1.0
        if verbose: print(it, nxt.cost, nxt.slack.min(), better, radius)
        if better:
            gain = merit(point) - merit(nxt)
            here, point = new, nxt
            radius = min(2 * radius, 1.0)
            floor *= 0.5
            if gain < 1e-5 and radius > 0.05: break
        else:
            radius *= 0.3
            if radius < 1e-4: break
    return Optimum(here, point.cost, float(point.slack.min()))


def constrained_step(hessian, gradient, slack, slope, low, high):
    """min d'Hd/2 + g'd subject to slack + slope d >= 0 as far as possible and low <= d <= high."""
    from scipy.optimize import nnls
    n = len(gradient)
    h = hessian + np.eye(n) * (1e-9 * np.trace(hessian) / n+1e-300)
    lower = np.linalg.cholesky(h)
    free = -np.linalg.solve(lower, gradient)
    matrix = np.vstack([slope, np.eye(n), -np.eye(n)])
    g = np.linalg.solve(lower, matrix.T).T
    for share in (1.0, 0.5, 0.1, 0.0):
        need = -np.where(slack < 0, share * slack, slack)
        bound = np.concatenate([need, low, -high]) - g @ free
        norm = np.abs(bound).max() + 1e-300
        e = np.vstack([g.T, bound / norm])
        f = np.zeros(n + 1); f[n] = 1.0
        u, rest = nnls(e, f)
        r = e @ u - f
        if -r[n] > 1e-10:
            z = -r[:n] / r[n] * norm
            return np.linalg.solve(lower.T, z + free)
    return np.zeros(n)
