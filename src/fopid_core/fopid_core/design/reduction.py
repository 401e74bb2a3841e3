"""Model reduction in the H2 norm, eqs. (8) to (11) of the paper.

All four templates are one model, K e^(-L s) / (T s^alpha + b s^beta + 1), with some of its numbers held.
The H2 norm of the difference is an integral over frequency; on quadrature nodes it and its exact gradient are cheap,
and a quasi-Newton method minimises it from a fixed list of starts, so the answer depends on the process only. (Least
squares would be the natural method, but its curvature with respect to L has the integral of w^2 |Pr|^2 in it, which is
infinite for a first-order model.)
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import quad_vec
from scipy.optimize import minimize

from fopid_core.design.specification import Clock, one_of
from fopid_core.errors import InputError
from fopid_core.model.process import Process
from fopid_core.model.stability import process_stability
from fopid_core.model.templates import TEMPLATES

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

GOOD_ENOUGH = 1.10
"""A simpler template is preferred when its error is at most this many times the smallest one."""
NEGLIGIBLE = 1e-4
"""Or when its error is this share of the process's own H2 norm."""


@dataclass(frozen=True)
class ReducedModel:
    """A process in one of the templates.

    Attributes
    ----------
    template : str
        ``foptd``, ``soptd``, ``nioptd1`` or ``nioptd2``.
    parameters : mapping
        The template's parameters by name.
    process : Process
    h2_error : float
        H2 norm of the difference, eq. (11).
    relative_error : float
        The same as a share of the process's own H2 norm.
    elapsed : float
        [s]
    """

    template: str
    parameters: Mapping[str, float]
    process: Process
    h2_error: float
    relative_error: float
    elapsed: float


@dataclass(frozen=True)
class Preference:
    """Which of several reduced models to use, and why."""

    model: ReducedModel
    reason: str


# The numbers of the one model, in order: K, log T, b, alpha, beta, L.
_K, _LOG_T, _B, _ALPHA, _BETA, _L = range(6)
_FREE = {
    "foptd": (_K, _LOG_T, _L),
    "nioptd1": (_K, _LOG_T, _ALPHA, _L),
    "soptd": (_K, _LOG_T, _B, _L),
    "nioptd2": (_K, _LOG_T, _B, _ALPHA, _BETA, _L),
}
_LOW = np.array([-np.inf, -16.0, -np.inf, 0.55, 0.05, 0.0])  # an order of 1/2 or less has no H2 norm
_HIGH = np.array([np.inf, 16.0, np.inf, 4.0, 3.0, np.inf])

_ONE_LAG = [
    (log_t, 0.0, alpha, 0.5, delay)
    for log_t in (-1.2, 0.0, 1.0)
    for alpha in (0.8, 1.0, 1.3, 1.8)
    for delay in (0.0, 0.05, 0.4, 1.0, 2.5)
]
_TWO_LAGS = [
    (-2.0 * math.log(speed), 2.0 * damping / speed, 2.0, 1.0, delay)
    for speed in (0.6, 1.0, 2.0)
    for damping in (0.05, 0.3, 0.8, 1.5)
    for delay in (0.0, 0.1, 0.4, 1.5)
]
"""Starts (log T, b, alpha, beta, L), in units of the process's own time scale."""
_POLISHED = 3  # how many of the starts are followed to the end


def reduce(process: Process, template: str, keep_gain: bool = False, clock: Clock = time.perf_counter) -> ReducedModel:
    """The model of a template that is nearest to a process in the H2 norm, eq. (11).

    Parameters
    ----------
    process : Process
        Stable and strictly proper, so that its H2 norm is finite; of any order, with any delay.
    template : str
        ``foptd``, ``soptd``, ``nioptd1`` or ``nioptd2``.
    keep_gain : bool
        Whether the model shall have the process's own steady-state gain; the H2 optimum gives some of it away.
    clock : callable
        Gives the time [s].

    Raises
    ------
    InputError
        If the process has no H2 norm, with the reason.

    Examples
    --------
    >>> from fopid_core.model.process import read_process
    >>> model = reduce(read_process("P1"), "soptd")
    >>> round(model.h2_error, 4)
    0.0204
    """
    begun = clock()
    one_of("template", template, tuple(_FREE))
    _check(process, keep_gain)
    fit = _Fit.of(process, keep_gain)
    numbers = fit.best(template)
    parameters = _parameters(template, fit.unscaled(numbers))
    error = fit.error(numbers) * fit.norm
    return ReducedModel(
        template, parameters, TEMPLATES[template].process(parameters), error, error / fit.norm, clock() - begun
    )


def reduce_all(process: Process, keep_gain: bool = False, clock: Clock = time.perf_counter) -> tuple[ReducedModel, ...]:
    """The nearest models of all four templates."""
    return tuple(reduce(process, template, keep_gain, clock) for template in _FREE)


def preferred(models: tuple[ReducedModel, ...]) -> Preference:
    """The simplest model whose error is about as small as the smallest.

    Examples
    --------
    >>> from fopid_core.model.process import read_process
    >>> preferred(reduce_all(read_process("1/(2s+1)*exp(-s)"))).model.template
    'foptd'
    """
    least = min(model.h2_error for model in models)
    good = [m for m in models if m.h2_error <= GOOD_ENOUGH * least or m.relative_error <= NEGLIGIBLE]
    choice = min(good, key=lambda model: (len(model.parameters), model.h2_error))
    others = ", ".join(f"{m.template} {m.h2_error:.3g}" for m in models if m is not choice)
    reason = f"fewest parameters with an H2 error near the smallest: {choice.h2_error:.3g} ({others})"
    return Preference(choice, reason)


def _check(process: Process, keep_gain: bool) -> None:
    verdict = process_stability(process)
    if not verdict.stable:
        raise InputError(
            f"process {process} is not stable ({verdict.reason}), so its H2 norm is infinite; allowed: a stable process"
        )
    if process.relative_degree <= 0.5:
        raise InputError(
            f"process {process} has relative degree {process.relative_degree:g}, so its H2 norm is infinite; "
            "allowed: above 1/2"
        )
    if keep_gain and process.steady_state_gain == 0.0:
        raise InputError(f"process {process} has no steady-state gain to keep; allowed: a gain other than 0")


def _parameters(template: str, numbers: Real) -> dict[str, float]:
    """The one model's numbers under the template's names."""
    gain, log_t, b, alpha, beta, delay = (float(number) for number in numbers)
    t = math.exp(log_t)
    if template in ("foptd", "nioptd1"):
        values = {"K": gain, "T": t, "alpha": alpha, "L": delay}
    else:
        values = {"K": gain / t, "a1": b / t, "a0": 1.0 / t, "alpha": alpha, "beta": beta, "L": delay}
    return {name: values[name] for name in TEMPLATES[template].parameters}


@dataclass(frozen=True)
class _Fit:
    """A process on quadrature nodes, without its own delay, in units of its own time and gain.

    Units: of frequency ``unit``, where |P|^2 w is largest, and of gain ``scale``; then its H2 norm is 1.

    The delay is taken out because what oscillates along the frequency axis is then only the difference of the
    delays of process and model, which is small where the process's gain is not.
    """

    s: Complex
    log_s: Complex
    weighted: Complex
    weight: Real
    delay: float
    unit: float
    scale: float
    gain: float | None
    norm: float

    @staticmethod
    def of(process: Process, keep_gain: bool) -> _Fit:
        body = process.without_delay()
        w, weight = _nodes(body)
        values = body(1j * w)
        energy = weight * np.abs(values) ** 2
        norm = math.sqrt(energy.sum())
        unit = float(w[np.argmax(w * np.abs(values) ** 2)])
        scale = norm / math.sqrt(unit)
        gain = process.steady_state_gain / scale if keep_gain else None
        s: Complex = np.asarray(1j * w / unit)
        root: Real = np.sqrt(weight / unit)
        return _Fit(s, np.log(s), root * values / scale, root, process.delay * unit, unit, scale, gain, norm)

    def model(self, numbers: Real) -> Complex:
        """The model's values with unit gain, weighted."""
        _, log_t, b, alpha, beta, delay = numbers
        denominator = np.exp(log_t + alpha * self.log_s) + b * np.exp(beta * self.log_s) + 1.0
        return np.asarray(self.weight * np.exp((self.delay - delay) * self.s) / denominator)

    def error(self, numbers: Real) -> float:
        """H2 norm of the difference, as a share of the process's own."""
        return float(np.linalg.norm(numbers[_K] * self.model(numbers) - self.weighted))

    def difference_and_slopes(self, numbers: Real) -> tuple[Complex, Complex]:
        """The weighted difference, shape (nodes,), and its derivatives, shape (6, nodes)."""
        gain, log_t, b, alpha, beta, delay = numbers
        first, second = np.exp(log_t + alpha * self.log_s), np.exp(beta * self.log_s)
        denominator = first + b * second + 1.0
        unit = self.weight * np.exp((self.delay - delay) * self.s) / denominator
        common = -gain * unit / denominator
        slopes = [unit, common * first, common * second, common * first * self.log_s]
        slopes += [common * b * second * self.log_s, -gain * unit * self.s]
        return gain * unit - self.weighted, np.stack(slopes)

    def with_best_gain(self, numbers: Real) -> Real:
        """The same with the gain that fits best, or the one to be kept."""
        unit = self.model(numbers)
        fitted = float(np.vdot(unit, self.weighted).real / np.vdot(unit, unit).real)
        return np.concatenate([[fitted if self.gain is None else self.gain], numbers[1:]])

    def unscaled(self, numbers: Real) -> Real:
        """The numbers in seconds."""
        gain, log_t, b, alpha, beta, delay = numbers
        log_unit = math.log(self.unit)
        return np.array(
            [gain * self.scale, log_t - alpha * log_unit, b * self.unit**-beta, alpha, beta, delay / self.unit]
        )

    def best(self, template: str) -> Real:
        """The nearest model: every start looked at, the best few followed to the end."""
        starts = self._starts(template)
        starts.sort(key=self.error)
        found = [self._follow(start, _FREE[template]) for start in starts[:_POLISHED]]
        # A process that falls off slowly makes every other delay look bad: the error has a cusp at its own.
        undelayed = next(start for start in starts if start[_L] == self.delay)
        found.append(self._follow(undelayed, _FREE[template][:-1]))
        return min((model for model in found if self._is_stable(model, template)), key=self.error)

    def _starts(self, template: str) -> list[Real]:
        plain = _ONE_LAG if template in ("foptd", "nioptd1") else _TWO_LAGS
        starts = [np.array([1.0, *start[:-1], start[-1] + self.delay]) for start in plain]
        if template == "foptd":
            starts = [start for start in starts if start[_ALPHA] == 1.0]
        if template == "nioptd1":
            starts = [self.best("foptd"), *starts]
        if template == "nioptd2":
            starts = [self.best("soptd"), self.best("nioptd1"), *starts]
        return [self.with_best_gain(start) for start in starts]

    def _is_stable(self, numbers: Real, template: str) -> bool:
        parameters = _parameters(template, self.unscaled(numbers))
        return process_stability(TEMPLATES[template].process(parameters)).stable

    def _follow(self, start: Real, free_numbers: tuple[int, ...]) -> Real:
        """The minimum of the squared error that a start leads to, over some of the numbers."""
        free = [i for i in free_numbers if i != _K or self.gain is None]

        def whole(x: Real) -> Real:
            numbers = start.copy()
            numbers[free] = x
            return numbers

        def squared_error(x: Real) -> tuple[float, Real]:
            difference, slopes = self.difference_and_slopes(whole(x))
            return float(np.vdot(difference, difference).real), 2.0 * (slopes[free] @ difference.conj()).real

        bounds = list(zip(_LOW[free], _HIGH[free], strict=True))
        solution = minimize(
            squared_error,
            start[free],
            jac=True,
            bounds=bounds,
            method="SLSQP",
            options={"ftol": 1e-14, "maxiter": 300},
        )
        return whole(solution.x)


def _nodes(process: Process) -> tuple[Real, Real]:
    """Frequencies [rad/s] and weights such that sum(weight * |P|^2) is the squared H2 norm, eq. (10)."""

    def density(x: float) -> float:
        w = math.exp(x)
        return abs(complex(process(1j * w))) ** 2 * w

    x = np.linspace(-36.0, 36.0, 289)
    rough = np.abs(process(1j * np.exp(x))) ** 2 * np.exp(x)
    heavy = x[rough > 1e-9 * rough.max()]
    low, high = heavy[0], heavy[-1]
    panels = quad_vec(density, low, high, epsrel=1e-6, points=np.arange(low + 1.0, high, 1.0), full_output=True)[
        2
    ].intervals
    # Models fall off more slowly than the process may: their tails count as well.
    tails = [[high + 2.0 * k, high + 2.0 * k + 2.0] for k in range(4)]
    edges = np.concatenate([panels, tails])
    inner, inner_weight = np.polynomial.legendre.leggauss(12)
    centre, half = edges.mean(axis=1), np.diff(edges, axis=1)[:, 0] / 2.0
    nodes = (centre[:, None] + half[:, None] * inner).ravel()
    weight = (half[:, None] * inner_weight).ravel()
    order = np.argsort(nodes)
    w = np.exp(nodes[order])
    return w, weight[order] * w / math.pi
