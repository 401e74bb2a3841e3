"""A lower bound on an index of all stable loops, by a dual program: any point of it is a proof.

Every linear controller that keeps a stable process stable is C = Q / (1 - P Q) with Q stable (Youla), and the closed
loop depends on T = P Q alone, the transform of tau(t), which is 0 before the process's delay L: S = 1 - T, and what is
integrated is y = g - g' * tau, g being the answer without control. For any phi with abs(phi) <= 1 and any real alpha,
beta with transforms A, B that satisfy

    beta(t) = Psi(t) + alpha(t)  for t >= L,    Psi(t) = integral of phi(x) g(x - t) dx,

the index is, whatever tau,

    integral of abs(y)  >=  integral of phi g  +  alpha(0)  -  Ms norm(A)  -  norm(M B),

norm(A) being the integral of abs(A(j w)) dw / 2 pi, Ms the bound on abs(S), M(w) the one on abs(T): the least of Mt,
1 + Ms and, up to the Nyquist frequency, N abs(P(j w)) where abs(Q) <= N. (Each multiplier times what it bounds; what
is left is the integral of tau times Psi + alpha - beta, which is 0.) An integrating process asks more of Q, which is
left out: what is bounded is then a larger set, and the bound holds all the same. For the integral of y^2 twice the
right side less the integral of phi^2 stands there, and phi is free. A zero z of P to the right adds terms
nu exp(-z t) to beta, for T(z) = 0.

phi is constant in each cell, alpha and beta are cubic splines. Psi is no spline: what it differs by is put into beta,
and its norm is taken off, from an eightfold finer grid and doubled. So the solver's accuracy is of no concern; the one
thing not proved is the quadrature of norms over frequency, on a grid much finer than the solver's.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fopid_core.errors import InputError
from fopid_core.model.arrays import Complexes, Floats

cvxpy: Any = import_module("cvxpy")  # its types tell less than it holds

FINE = 8
"""Points in each cell where Psi is compared with its spline."""
BEFORE = 0.25
"""How far alpha and beta reach back before t = 0, in horizons."""
ALIASES = 60
CIRCLE = 1 << 14
"""Frequencies, from 0 to twice the fastest of the grid, on which norms are taken for the proof."""
TWICE = 2.0


@dataclass(frozen=True)
class Task:
    """What is bounded, in numbers.

    Attributes
    ----------
    answer : callable
        Integral of g from 0 to t, of instants t >= 0, shape (n,); g begins ``lag`` later.
    lag : float
        [s]
    delay : float
        L, before which tau is 0 [s].
    zeros : ndarray of complex
        To the right, of which conjugate pairs have their upper one only.
    ms : float
        Bound on abs(S).
    limit : callable
        M(w), from frequencies w >= 0 [rad/s].
    squared : bool
        Whether the index is of y^2.
    """

    answer: Callable[[Floats], Floats]
    lag: float
    delay: float
    zeros: NDArray[np.complex128]
    ms: float
    limit: Callable[[Floats], Floats]
    squared: bool


def lower_bound(task: Task, horizon: float, cells: int) -> tuple[float, float]:
    """The bound and the processor time that cvxpy's solver took [s].

    Parameters
    ----------
    task : Task
    horizon : float
        Up to which y counts [s]; a longer or shorter one is a bound all the same.
    cells : int
        Up to there.
    """
    first = round(task.delay * cells / horizon)  # one shorter than half a cell counts for none: no less true
    step = task.delay / first if first else horizon / cells
    return _Dual(task, step, max(math.ceil(horizon / step), first + 4), first).solve()


class _Dual:
    """The program on one grid: cells of ``step`` [s], tau from cell ``first`` on."""

    def __init__(self, task: Task, step: float, cells: int, first: int) -> None:
        self._task, self._step, self._cells, self._first = task, step, cells, first
        self._before = max(int(BEFORE * cells), first + 3)
        self._size = self._before + cells
        self._edges = step * np.arange(cells + 1, dtype=np.float64)
        knots = step * np.arange(first - 2, cells + 1, dtype=np.float64)
        self._psi = _spline(self._correlated(knots))
        self._of_zeros = _spline(self._exponentials(knots))
        self._at_zero = np.zeros(self._size)
        self._at_zero[self._before - 1 : self._before + 2] = (1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0)
        self._free = self._before + first - 1

    def _correlated(self, t: Floats) -> Floats:
        """Psi at instants t, of phi in each cell, shape (n, cells)."""
        return np.diff(self._integral(self._edges[None, :] - t[:, None]), axis=1)

    def _integral(self, t: Floats) -> Floats:
        late = t - self._task.lag
        return np.where(late > 0.0, self._task.answer(np.maximum(late, 0.0)), 0.0)

    def _exponentials(self, t: Floats) -> Floats:
        """exp(-z t) as real functions, from the delay on of size 1, shape (n, terms)."""
        columns = []
        for zero in self._task.zeros:
            value = np.exp(-zero * (t - self._task.delay))
            columns += [value.real] if zero.imag == 0.0 else [value.real, value.imag]
        return np.stack(columns, axis=1) if columns else np.zeros((len(t), 0))

    def solve(self) -> tuple[float, float]:
        count = 1 << math.ceil(math.log2(self._size))
        theta = math.pi * (np.arange(count) + 0.5) / count
        transform = np.exp(-1j * np.outer(theta, np.arange(self._size)))
        spread, allowed = self._weights(theta, self._step)
        begins = self._correlated(np.zeros(1))[0]
        # In units in which the index without control, the norms and phi are of size 1, or a solver may give up.
        index, largest = float(np.abs(begins).sum()), float(self._task.limit(np.zeros(1))[0])
        unit = index / (self._cells * self._step) if self._task.squared else 1.0
        phi, alpha = cvxpy.Variable(self._cells), cvxpy.Variable(self._size)
        # Before cvxpy 1.7 no variable may be empty, and there is none for a process without delay, or without zeros.
        early, nu = _variable(self._free), _variable(self._of_zeros.shape[1])
        later = (largest / index * self._psi) @ phi + (largest / self._task.ms) * alpha[self._free :]
        if nu is not None:
            later = later + self._of_zeros @ nu
        beta = later if early is None else cvxpy.hstack([early, later])

        def norm(values: Any, weight: Floats) -> Any:
            parts = cvxpy.vstack([transform.real @ values, transform.imag @ values])
            return cvxpy.sum(cvxpy.multiply(weight / count, cvxpy.norm(parts, 2, axis=0)))

        value = (begins / index) @ phi + (self._at_zero / self._task.ms) @ alpha
        value = value - norm(alpha, spread) - norm(beta, allowed / largest)
        if self._task.squared:
            goal = cvxpy.Maximize(2.0 * value - (self._step * unit / index) * cvxpy.sum_squares(phi))
            problem = cvxpy.Problem(goal)
        else:
            problem = cvxpy.Problem(cvxpy.Maximize(value), [cvxpy.abs(phi) <= 1.0])
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # an inaccurate solution proves what it proves
                problem.solve(solver=cvxpy.CLARABEL)
        except cvxpy.SolverError as error:
            raise InputError(f"cells = {self._cells}: {error}; allowed: others, or another horizon") from None
        if phi.value is None:
            raise InputError(f"cells = {self._cells}: the solver says {problem.status}; allowed: others")
        chosen = unit * phi.value if self._task.squared else np.clip(phi.value, -1.0, 1.0)
        free = unit * index / largest
        at_first, terms = free * _value(early), free * _value(nu)
        proved = self._proved(chosen, unit * index / self._task.ms * alpha.value, at_first, terms)
        return proved, float(problem.solver_stats.solve_time)

    def _proved(self, phi: Floats, alpha: Floats, early: Floats, nu: Floats) -> float:
        """What the multipliers prove, whoever chose them."""
        coefficients = self._psi @ phi + self._of_zeros @ nu
        beta = np.concatenate([early, coefficients + alpha[self._free :]])
        theta = _circle()
        spread, allowed = self._weights(theta, self._step)
        value = float(self._correlated(np.zeros(1))[0] @ phi + self._at_zero @ alpha)
        value -= self._task.ms * float(np.mean(spread * _size(alpha)))
        value -= float(np.mean(allowed * _size(beta)))
        rest = self._rest(phi, nu, coefficients)
        value -= TWICE * float(np.mean(self._weights(theta, self._step / FINE)[1] * _size(rest)))
        if self._task.squared:
            value = 2.0 * value - self._step * float(phi @ phi)
        return max(value, 0.0)

    def _rest(self, phi: Floats, nu: Floats, coefficients: Floats) -> Floats:
        """What Psi and its spline differ by from the delay on, on the finer grid."""
        x = np.arange(FINE * self._first, FINE * self._cells + 1) / FINE
        exact = self._correlated(x * self._step) @ phi + self._exponentials(x * self._step) @ nu
        padded = np.concatenate([coefficients, np.zeros(4)])
        begin = np.floor(x + 1e-9).astype(int)
        for offset in range(-1, 3):
            index = begin + offset - (self._first - 1)
            exact = exact - _basis(x - begin - offset) * padded[np.clip(index, 0, len(padded) - 1)]
        return np.asarray(exact)

    def _weights(self, theta: Floats, step: float) -> tuple[Floats, Floats]:
        """Of a spline's norm on the circle: 1 and M, seen through all frequencies that look alike on the grid."""
        spread, allowed = np.zeros_like(theta), np.zeros_like(theta)
        for turn in range(-ALIASES, ALIASES + 1):
            x = theta + 2.0 * math.pi * turn
            part = np.sinc(x / (2.0 * math.pi)) ** 4
            spread += part
            allowed += part * self._task.limit(np.abs(x) / step)
        return spread, allowed


def _spline(values: Floats) -> Floats:
    """Coefficients of a cubic spline that is right to fourth order, from values one knot longer at either end."""
    return np.asarray((8.0 * values[1:-1] - values[:-2] - values[2:]) / 6.0)


def _basis(x: Floats) -> Floats:
    x = np.abs(x)
    return np.where(x < 1.0, 2.0 / 3.0 - x**2 + x**3 / 2.0, np.maximum(2.0 - x, 0.0) ** 3 / 6.0)


def _circle() -> Floats:
    return np.asarray(2.0 * math.pi / CIRCLE * (np.arange(CIRCLE // 2) + 0.5))


def _size(coefficients: Floats) -> Floats:
    """Absolute values of a trigonometric polynomial on the circle."""
    turned: Complexes = coefficients * np.exp(-1j * math.pi / CIRCLE * np.arange(len(coefficients)))
    return np.asarray(np.abs(np.fft.fft(turned, CIRCLE)[: CIRCLE // 2]))


def _variable(size: int) -> Any:
    """Numbers that the solver chooses; None for no numbers."""
    return cvxpy.Variable(size) if size else None


def _value(variable: Any) -> Floats:
    return np.zeros(0) if variable is None else np.asarray(variable.value)
