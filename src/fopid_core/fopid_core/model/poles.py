"""The poles that decide how a loop rings or grows: zeros of a quasi-polynomial to the right of a path.

A path runs from the real axis to infinity in the upper half-plane. Along it the argument principle counts the zeros to
its right (Vyhlidal and Zitek 2009); Newton's iteration, started where the function is small and kept away from zeros
that are known by deflation (Maehly 1954), finds them. They are believed only when there are as many as were counted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from fopid_core.model.adaptive_grid import refine
from fopid_core.model.arrays import Complexes, Floats
from fopid_core.model.asymptotics import fast_rate, leading_term
from fopid_core.model.quasipolynomial import QuasiPolynomial

EPSILON = float(np.finfo(np.float64).eps)
_STEP = 0.15  # of ln s, between the points of the first grids
_MOST_STEPS = 1500
_TURN_STEP = 0.5  # rad of the longest delay's phase between points
_MOST_TURNS = 100_000
_SMALL_SHARE = 0.1  # of the delayed terms: less than this turns the sum by little
_LARGEST_LOG_FREQUENCY = 600.0
_MOST_ROUNDS = 5
_LARGEST_TURN = 0.6  # rad between neighbours on the path
_SEEDS_EACH = 60
_ITERATIONS = 40
_LARGEST_MOVE = 0.4  # of ln s in one Newton step
_SAME = 1e-9  # relatively closer than this, two zeros are one
_REAL = 1e-11
_ROUNDING = 32.0 * EPSILON
MOST_ZEROS = 300


@dataclass(frozen=True)
class Path:
    """Where the looked-for part of the plane ends: a ray from the origin, then a vertical line.

    Attributes
    ----------
    angle : float
        Of the ray [rad], above pi/2; pi for a line that begins on the negative real axis.
    line : float
        Distance [1/s] of the vertical line to the left of the imaginary axis; infinite for a ray alone.
    """

    angle: float
    line: float = math.inf

    @property
    def last_angle(self) -> float:
        """The direction in which it leaves."""
        return self.angle if math.isinf(self.line) else 0.5 * math.pi

    def points(self, log_height: Floats) -> Complexes:
        """Points of the path in the upper half-plane, rising with ``log_height``."""
        height = np.exp(log_height)
        if math.isinf(self.line):
            return np.asarray(height * np.exp(1j * self.angle))
        if self.angle >= math.pi:
            return np.asarray(-self.line + 1j * height)
        return np.asarray(np.maximum(height / math.tan(self.angle), -self.line) + 1j * height)

    def keeps(self, s: Complexes) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """Whether points of the upper half-plane lie to the right."""
        if math.isinf(self.line):
            return np.asarray(np.angle(s) < self.angle)
        inside = s.real > -self.line
        return np.asarray(inside if self.angle >= math.pi else inside & (np.angle(s) < self.angle))


@dataclass(frozen=True)
class Poles:
    """Zeros of a quasi-polynomial with Im s >= 0 to the right of a path, without those at the origin.

    Attributes
    ----------
    values : ndarray, shape (k,)
    shifts : ndarray, shape (k,)
        By how much rounding of the coefficients moves each [1/s].
    """

    values: Complexes
    shifts: Floats


def scaled_value(function: QuasiPolynomial, s: Complexes) -> tuple[Complexes, Floats]:
    """The function's value over the sum of its terms' sizes, and the logarithm of that sum: nothing overflows.

    Examples
    --------
    >>> value, log_sum = scaled_value(QuasiPolynomial.polynomial([1e200, 1e200]), np.array([1e150 + 0j]))
    >>> float(value[0].real), round(float(log_sum[0]) / math.log(10.0))
    (1.0, 350)
    """
    values, logs, _ = _terms(function, s)
    return values.sum(axis=0), logs


def count_right_of(function: QuasiPolynomial, path: Path) -> tuple[int, float]:
    """How many zeros lie to the right of a path, both halves of the plane together; and how near the path comes to one.

    Returns
    -------
    count : int
        -1 when they cannot be counted: infinitely many, or on the path.
    clearance : float
        The smallest value on the path, over the sum of the terms' sizes.

    Examples
    --------
    >>> count_right_of(QuasiPolynomial.polynomial([1.0, 0.2, 1.0]), Path(0.75 * math.pi))[0]
    2
    """
    function = function.shifted(-function.lowest_order)
    lead = leading_term(function)
    delayed = sum(abs(t.coefficient) * _grown(path, t.delay) for t in function.terms if t.order == lead.order)
    if delayed >= 2.0 * abs(lead.coefficient):  # the undelayed term itself is in the sum
        return -1, 0.0
    if function.terms == (lead,):
        return 0, 1.0
    grid = _grid(function, path)
    if grid is None:
        return -1, 0.0
    starts = _start_sign(function, path)
    if starts == 0.0 or np.abs(scaled_value(function, path.points(grid))[0]).min() < _ROUNDING:
        return -1, 0.0
    z, values = refine(lambda z: scaled_value(function, path.points(z))[0], grid)
    clearance = float(np.abs(values).min())
    if clearance < _ROUNDING:
        return -1, 0.0
    turns = np.angle(values[1:] / values[:-1])
    if np.abs(turns).max() > _LARGEST_TURN:  # still not followed: on the path, or nothing but rounding
        return -1, 0.0
    turned = float(np.angle(values[0] / starts)) + float(np.sum(turns))
    end = complex(path.points(z[-1:])[0])
    ideal = np.sign(lead.coefficient) * np.exp(1j * lead.order * np.angle(end))
    turned += lead.order * (path.last_angle - float(np.angle(end))) - float(np.angle(values[-1] / ideal))
    raw = (lead.order * path.last_angle - turned) / math.pi
    return (round(raw) if abs(raw - round(raw)) < 0.01 else -1), clearance


def poles_right_of(function: QuasiPolynomial, path: Path, count: int) -> Poles | None:
    """The zeros that ``count_right_of`` counted; None when not all of them are found.

    Examples
    --------
    >>> found = poles_right_of(QuasiPolynomial.polynomial([1.0, 0.2, 1.0]), Path(0.75 * math.pi), 2)
    >>> complex(np.round(found.values[0], 4))
    (-0.1+0.995j)
    """
    function = function.shifted(-function.lowest_order)
    found: Complexes = np.empty(0, dtype=np.complex128)
    if not 0 <= count <= MOST_ZEROS:
        return None
    for attempt in range(_MOST_ROUNDS):
        if _number(found) >= count:
            break
        rational = function.has_integer_orders and function.has_one_delay
        seeds = _companion_roots(function) if rational and not attempt else _seeds(function, path, found, attempt)
        found = _merged(found, _newton(function, seeds, found), path)
    if _number(found) != count:
        return None
    values, _, derivative = _terms(function, found)
    size = np.abs(derivative.sum(axis=0))
    wobble = EPSILON * (4.0 + np.abs(np.log(found)) * function.degree) / np.where(size == 0.0, np.nan, size)
    shifts = np.nan_to_num(np.maximum(wobble, np.abs(values.sum(axis=0)) / size) * np.abs(found), nan=np.inf)
    return Poles(found, shifts)


def _terms(function: QuasiPolynomial, s: Complexes) -> tuple[Complexes, Floats, Complexes]:
    """Each term over the sum of sizes, shape (k, m); the sum's logarithm; each term's derivative by ln s."""
    log_s = np.log(s)
    orders, delays = (np.array([getattr(t, name) for t in function.terms]) for name in ("order", "delay"))
    coefficients = np.array([t.coefficient for t in function.terms])
    logs = np.log(np.abs(coefficients))[:, None] + orders[:, None] * log_s
    if delays.any():
        logs = logs - delays[:, None] * s
    largest = logs.real.max(axis=0)
    values = np.sign(coefficients)[:, None] * np.exp(logs - largest)
    total = np.abs(values).sum(axis=0)
    values = values / total
    slopes = orders[:, None] - delays[:, None] * s if delays.any() else orders[:, None]
    return values, largest + np.log(total), values * slopes


def _grown(path: Path, delay: float) -> float:
    return math.exp(min(delay * path.line, 600.0)) if delay else 1.0


def _start_sign(function: QuasiPolynomial, path: Path) -> float:
    if path.angle >= math.pi:
        return float(np.sign(scaled_value(function, np.array([-path.line + 0j]))[0].real[0]))
    return float(np.sign(function.sum_of_order(0.0)))


def _grid(function: QuasiPolynomial, path: Path) -> Floats | None:
    """Heights along the path: below the first and above the last one term outweighs the rest."""
    low, high = _ends(function, path)
    if not -_LARGEST_LOG_FREQUENCY < low < high < _LARGEST_LOG_FREQUENCY:
        return None
    z = np.linspace(low, high, min(math.ceil((high - low) / _STEP), _MOST_STEPS) + 2)
    longest = max(t.delay for t in function.terms)
    if not longest:
        return z
    top = _delay_matters_until(function, path, z)
    if top * longest / _TURN_STEP > _MOST_TURNS:
        return None
    return np.unique(np.concatenate((z, np.log(np.linspace(0.0, top, math.ceil(top * longest / _TURN_STEP) + 1)[1:]))))


def _delay_matters_until(function: QuasiPolynomial, path: Path, z: Floats) -> float:
    """The height of the path above which the delayed terms are small beside the others."""
    sizes = np.abs(_terms(function, path.points(z))[0])
    share = sizes[[t.delay > 0.0 for t in function.terms]].sum(axis=0)
    last = int(np.flatnonzero(share > _SMALL_SHARE).max(initial=-1))
    return float(np.exp(z[min(last + 1, z.size - 1)]))


def _ends(function: QuasiPolynomial, path: Path) -> tuple[float, float]:
    grown = function
    if not math.isinf(path.line):
        terms = (replace(t, coefficient=t.coefficient * _grown(path, t.delay)) for t in function.terms)
        grown = QuasiPolynomial(tuple(terms))
    high = math.log(max(fast_rate(grown), 1e-300)) + 2.0
    constant = abs(function.sum_of_order(0.0))
    low = high - 4.0
    for t in function.terms:
        if t.order > 0.0 and constant:
            low = min(low, (math.log(constant / (8.0 * len(function.terms))) - math.log(abs(t.coefficient))) / t.order)
        elif t.delay and constant:
            low = min(low, math.log(constant / (8.0 * t.delay * abs(t.coefficient))))
    if not math.isinf(path.line):
        low, high = min(low, math.log(path.line) - 5.0), max(high, math.log(path.line) + 3.0)
    return low, high


def _seeds(function: QuasiPolynomial, path: Path, found: Complexes, finer: int) -> Complexes:
    """Where, on paths side by side, what is left of the function is smallest."""
    grid = _grid(function, path)
    if grid is None:
        return np.empty(0, dtype=np.complex128)
    if finer:
        grid = np.sort(
            np.concatenate((grid, *(grid[:-1] + k / (finer + 1.0) * np.diff(grid) for k in range(1, finer + 1))))
        )
    more: list[Complexes]
    rays = [Path(share * 0.5 * math.pi).points(grid) for share in np.linspace(0.0, 1.0, 5 + finer)]
    shares = np.linspace(0.0, 1.0, 4 + finer)[1:]
    if math.isinf(path.line):
        more = [Path(0.5 * math.pi + share * (path.angle - 0.5 * math.pi)).points(grid) for share in shares]
    else:
        more = [Path(path.angle, share * path.line).points(grid) for share in shares]
        more.append(np.asarray(-np.linspace(1e-6, 1.0, grid.size) * path.line, dtype=np.complex128))
    chosen: list[Complexes] = []
    sizes: list[Floats] = []
    paths: list[Complexes] = [*rays, *more]
    for points in paths:
        size = np.log(np.abs(scaled_value(function, points)[0]) + 1e-300)
        for p in found:
            size -= np.log(np.abs(1.0 - p / points) * np.abs(1.0 - p.conjugate() / points) + 1e-300)
            size += np.log1p(np.abs(p / points)) * 2.0
        lowest = np.flatnonzero((size[1:-1] <= size[:-2]) & (size[1:-1] <= size[2:])) + 1
        chosen.append(points[lowest])
        sizes.append(size[lowest])
    seeds = np.concatenate(chosen)
    return np.asarray(seeds[np.argsort(np.concatenate(sizes))[: _SEEDS_EACH * (1 + finer)]])


def _companion_roots(function: QuasiPolynomial) -> Complexes:
    coefficients = function.coefficients()
    if not np.all(np.isfinite(coefficients[1:] / coefficients[0])):
        return np.empty(0, dtype=np.complex128)
    roots = np.roots(coefficients)
    return np.asarray(roots[(roots.imag >= 0.0) & (roots != 0.0)], dtype=np.complex128)


def _newton(function: QuasiPolynomial, s: Complexes, found: Complexes) -> Complexes:
    """Newton's iteration in ln s; where it has come to rest."""
    known = np.concatenate((found, found[found.imag > 0.0].conj()))
    moving = np.array(s, dtype=np.complex128)
    settled: list[Complexes] = []
    for i in range(_ITERATIONS):
        if moving.size == 0:
            break
        values, _, derivative = _terms(function, moving)
        value, slope = values.sum(axis=0), derivative.sum(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            rate = slope / value
            if i < _ITERATIONS - 3:
                rate = rate - (moving[None, :] / (moving[None, :] - known[:, None])).sum(axis=0)
            move = np.where(value == 0.0, 0.0, -1.0 / rate)
        move = np.where(np.isfinite(move), move, 0.0)
        length = np.abs(move)
        move = np.where(length > _LARGEST_MOVE, move * (_LARGEST_MOVE / np.maximum(length, 1e-300)), move)
        moving = moving * np.exp(move)
        moving = np.where(moving.imag < 0.0, moving.conj(), moving)
        done = length < 8.0 * EPSILON
        small = np.abs(value) < 1e-3
        settled.append(moving[done & small])
        moving = moving[~done & np.isfinite(moving)]
    values, _, derivative = _terms(function, moving)
    value, slope = np.abs(values.sum(axis=0)), np.abs(derivative.sum(axis=0))
    near = value < 1e-10 * np.maximum(slope, 1e-3)
    return np.concatenate([*settled, moving[near]])


def _merged(found: Complexes, more: Complexes, path: Path) -> Complexes:
    """New zeros that are not known yet and lie to the right of the path."""
    more = np.where(np.abs(more.imag) < _REAL * np.abs(more), more.real + 0j, more)
    kept = list(found)
    for s in more[path.keeps(more)]:
        if all(abs(s - p) > _SAME * abs(s) for p in kept):
            kept.append(s)
    return np.array(kept, dtype=np.complex128)


def _number(found: Complexes) -> int:
    """How many zeros these are with their conjugates."""
    return int(np.sum(np.where(found.imag > 0.0, 2, 1)))
