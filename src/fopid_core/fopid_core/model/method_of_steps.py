"""Step responses of loops of whole orders with one delay: the method of steps.

From one multiple of the delay to the next such a loop is a linear differential equation whose input, what comes back,
is known already (Bellman and Cooke 1963). It is solved by collocation at Radau's nodes on elements
that grow geometrically from each multiple of the delay, where layers of every time constant may begin: neither many
delays, nor lags far apart, nor poles that lie together make it harder.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from fopid_core.errors import UnboundedResponseError
from fopid_core.model.arrays import Complexes, Floats
from fopid_core.model.poles import EPSILON
from fopid_core.model.quasipolynomial import QuasiPolynomial
from fopid_core.model.step_transforms import StepTransforms

MOST_ELEMENTS = 12_000
"""In all delays together."""

_MANY_TURNS = 300
_DEGREES = (13, 18)
_FIRST_LENGTH = 0.3  # of the fastest time constant
_RATIO = 3.0  # from one element to the next
_LONGEST_ANGLE = 2.5  # rad that the fastest motion still alive turns in one element
_DEAD = 40.0  # time constants
_SHARES = np.arange(1, 25) / 24.0  # of an element, where it is sampled: a multiple of four
_TOGETHER = 64.0 * EPSILON  # relatively
_PERTURBED = 4.0 * EPSILON  # of each coefficient, in the second solution
_SAFETY = 5.0  # of what the second solution differs by
_ROUNDING = 1e-12
_LARGEST = 1e260
_BLOCK = 1 << 15


@dataclass(frozen=True)
class Equations:
    """``x' = a x + b_back v(t - d) + b_now + b_then``, ``v = c x + d_back v(t - d) + d_now + d_then``, for k signals v.

    What is called *then* holds from the first delay on. The ideal derivative of a step is an impulse in v, which comes
    back with every delay.

    Attributes
    ----------
    a : ndarray, shape (n, n)
    c : ndarray, shape (n,)
    b_back : ndarray, shape (n,)
    d_back : float
    b_now, b_then : ndarray, shape (n, k)
    d_now, d_then, impulse_now, impulse_then : ndarray, shape (k,)
    """

    a: Floats
    c: Floats
    b_back: Floats
    d_back: float
    b_now: Floats
    b_then: Floats
    d_now: Floats
    d_then: Floats
    impulse_now: Floats
    impulse_then: Floats

    @staticmethod
    def of(transforms: StepTransforms, delay: float, perturbed: float = 0.0) -> Equations:
        """The observer's form, balanced; each coefficient off by a share of itself, one up, the next down."""
        from scipy.linalg import matrix_balance

        under = transforms.characteristic
        degree = int(under.degree)
        monic = _coefficients(under, 0.0, degree, perturbed)
        lead, monic = monic[0], monic / monic[0]
        a = np.eye(degree, k=1)
        a[:, 0] -= monic[1:]
        balanced, (scale, _) = matrix_balance(a, permute=False, separate=True)

        def divided(function: QuasiPolynomial, at: float) -> tuple[Floats, float, float]:
            """Into input, direct and impulse weights."""
            over = _coefficients(function, at, degree + 1, perturbed) / lead
            impulse = float(over[0])
            over = over[1:] - impulse * np.append(monic[1:], 0.0)
            direct = float(over[0])
            return (over[1:] - direct * monic[1:]) / scale, direct, impulse

        b_back, d_back, _ = divided(-under, delay)
        now, then = ([divided(n, at) for n in transforms.numerators] for at in (0.0, delay))
        c = np.zeros(degree)
        c[0] = scale[0]
        return Equations(
            np.asarray(balanced), c, b_back, d_back,
            np.stack([b for b, _, _ in now], axis=1), np.stack([b for b, _, _ in then], axis=1),
            np.array([d for _, d, _ in now]), np.array([d for _, d, _ in then]),
            np.array([i for _, _, i in now]), np.array([i for _, _, i in then]),
        )  # fmt: skip

    def echo_rate(self, turns: int) -> float:
        """Rate k r [1/s] of neutral loops: echo k is ``(1 + r / s)^k``, which oscillates at ``sqrt(k r / t)``."""
        size = abs(self.d_back)
        if not size:
            return 0.0
        alive = turns if size >= 1.0 else min(turns, _DEAD / -math.log(size))
        return float(abs(self.c @ self.b_back) / size * alive)


@dataclass(frozen=True)
class Steps:
    """Error and control of a loop with one delay after a unit step, at any instant up to the horizon.

    Attributes
    ----------
    delay, horizon : float
        [s]
    edges : ndarray, shape (m + 1,)
        Of the elements, from 0 to the delay [s].
    values : ndarray, shape (delays, m, nodes, 2)
    doubts : ndarray, shape (delays, 2)
        The estimated largest error from one multiple of the delay to the next.
    """

    delay: float
    horizon: float
    edges: Floats
    values: Floats
    doubts: Floats

    @staticmethod
    def of(transforms: StepTransforms, horizon: float, most: int = MOST_ELEMENTS) -> Steps | None:
        """Up to the horizon; None for loops of another kind, or where it would take more than ``most`` elements.

        Raises
        ------
        UnknownResponseError
            If the loop grows beyond all numbers.
        """
        if not _suits(transforms):
            return None
        delay = transforms.longest_delay
        equations = Equations.of(transforms, delay)
        turns = int(min(horizon / delay * (1.0 + EPSILON), most)) + 1
        if turns > _MANY_TURNS and not equations.d_back:  # the inversion is many times quicker, and exact enough
            return None
        rates = np.linalg.eigvals(equations.a).astype(np.complex128)
        edges = _edges(rates, equations.echo_rate(turns), delay, most // turns)
        if edges is None:
            return None
        other = Equations.of(transforms, delay, _PERTURBED)
        with np.errstate(all="ignore"):
            coarse = _solved(other, edges, turns, _DEGREES[0])
            fine = _solved(equations, edges, turns, _DEGREES[1])
            if not np.all(np.abs(fine) < _LARGEST) or not np.all(np.abs(coarse) < _LARGEST):
                raise UnboundedResponseError(
                    "what is unstable grows beyond all numbers until then", "a shorter one", horizon
                )
        across = _interpolation(_nodes(_DEGREES[0]), _nodes(_DEGREES[1]))
        gap = np.abs(np.einsum("ij,tejk->teik", across, coarse) - fine).max(axis=(1, 2))
        size = np.maximum.accumulate(np.abs(fine).max(axis=(1, 2)), axis=0)
        return Steps(delay, horizon, edges, fine, _SAFETY * gap + _ROUNDING * np.maximum(size, 1.0))

    def at(self, time: Floats) -> Floats:
        """Error and control, shape (2, n); where they jump, the values after the jump."""
        nodes = _nodes(_DEGREES[1])
        out = np.empty((2, time.size))
        for start in range(0, time.size, _BLOCK):
            part = slice(start, start + _BLOCK)
            turn = self._turn(time[part])
            since = np.clip(time[part] - turn * self.delay, 0.0, self.delay)
            element = np.clip(np.searchsorted(self.edges, since, side="right") - 1, 0, self.edges.size - 2)
            low, high = self.edges[element], self.edges[element + 1]
            rows = _interpolation(nodes, 2.0 * (since - low) / (high - low) - 1.0)
            out[:, part] = np.einsum("nj,njk->kn", rows, self.values[turn, element])
        return out

    def error_at(self, time: Floats) -> Floats:
        """The estimated error of both, shape (2, n)."""
        return np.asarray(self.doubts[self._turn(time)].T)

    def instants(self) -> Floats:
        """Rising instants from 0 on that describe the response, evenly spaced by fours.

        At each multiple of the delay, where signals may jump, four lie together, so that no sum reaches across.
        """
        last_turn = self.values.shape[0] - 1
        fine = np.concatenate([a + (b - a) * _SHARES for a, b in itertools.pairwise(self.edges)])
        parts = [np.zeros(1)]
        for turn in range(last_turn):
            end = (turn + 1) * self.delay
            parts += [turn * self.delay + fine[:-1], end * (1.0 - _TOGETHER * np.arange(4.0, -1.0, -1.0))]
        rest = self.horizon - last_turn * self.delay
        if rest > 4.0 * _TOGETHER * self.horizon:
            ends = np.append(self.edges[self.edges < rest], rest)
            parts += [last_turn * self.delay + a + (b - a) * _SHARES for a, b in itertools.pairwise(ends)]
        time = np.concatenate(parts)
        time[-1] = self.horizon
        return time

    def _turn(self, time: Floats) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
        turn = np.floor(time / self.delay * (1.0 + 4.0 * EPSILON)).astype(np.int64)
        return np.clip(turn, 0, self.values.shape[0] - 1)


def _suits(transforms: StepTransforms) -> bool:
    """Whether all orders are whole, and all delays are one."""
    functions = (transforms.characteristic, *transforms.numerators)
    terms = [term for function in functions for term in function.terms]
    return (
        len({term.delay for term in terms if term.delay}) == 1
        and all(term.order >= 0.0 and term.order.is_integer() for term in terms)
        and transforms.characteristic.degree >= 1.0
    )


def _coefficients(function: QuasiPolynomial, delay: float, degree: int, perturbed: float) -> Floats:
    """Of the terms with this delay, highest power first."""
    out = np.zeros(degree + 1)
    for i, term in enumerate(function.terms):
        if term.delay == delay:
            out[degree - int(term.order)] = term.coefficient * (1.0 + (-1) ** i * perturbed)
    return out


def _edges(rates: Complexes, echo_rate: float, delay: float, most: int) -> Floats | None:
    """Elements from 0 to the delay; None where they would be more than ``most``."""
    fastest = max(float(np.abs(rates).max()), echo_rate, 1.0 / delay)
    moving = np.maximum(np.abs(rates.imag), rates.real)
    edges, length = [0.0], _FIRST_LENGTH / fastest
    while edges[-1] < delay:
        if len(edges) > most:
            return None
        alive = rates.real * edges[-1] > -_DEAD
        echoes = math.sqrt(echo_rate / edges[-1]) if edges[-1] else 0.0
        turning = max(float(moving[alive].max(initial=0.0)), echoes, 1e-300)
        edges.append(edges[-1] + min(length, _LONGEST_ANGLE / turning))
        length *= _RATIO
    edges[-1] = delay
    if len(edges) > 2 and edges[-1] - edges[-2] < 0.5 * (edges[-2] - edges[-3]):
        del edges[-2]
    return np.array(edges)


def _solved(equations: Equations, edges: Floats, turns: int, degree: int) -> Floats:
    """The signals at the nodes of every element, shape (turns, elements, degree + 1, k)."""
    one, derive = equations, _derivatives(_nodes(degree))
    size, count = one.b_now.shape
    lengths = np.diff(edges)
    inverses = [
        np.linalg.inv(np.kron(derive[1:, 1:], np.eye(size)) - 0.5 * length * np.kron(np.eye(degree), one.a))
        for length in lengths
    ]
    values = np.empty((turns, lengths.size, degree + 1, count))
    x, impulse = np.zeros((size, count)), one.impulse_now
    back = np.zeros((lengths.size, degree + 1, count))
    for turn in range(turns):
        constant, direct = one.b_now, one.d_now
        if turn:
            constant, direct = constant + one.b_then, direct + one.d_then
            x = x + one.b_back[:, None] * impulse
            impulse = one.d_back * impulse + (one.impulse_then if turn == 1 else 0.0)
        for i, length in enumerate(lengths):
            drive = one.b_back[None, :, None] * back[i, 1:, None, :] + constant
            right = 0.5 * length * drive - derive[1:, :1, None] * x
            states = (inverses[i] @ right.reshape(degree * size, count)).reshape(degree, size, count)
            states = np.concatenate((x[None], states))
            values[turn, i] = np.einsum("n,jnk->jk", one.c, states) + one.d_back * back[i] + direct
            x = states[-1]
        back = values[turn]
    return values


@lru_cache(4)
def _nodes(degree: int) -> Floats:
    """-1 and Radau's nodes in (-1, 1], the last at 1."""
    legendre = np.polynomial.legendre.Legendre
    polynomial = legendre.basis(degree) - legendre.basis(degree - 1)
    roots = np.sort(polynomial.roots().real)
    return np.concatenate(([-1.0], roots[:-1], [1.0]))


def _weights(nodes: Floats) -> Floats:
    """The barycentric weights."""
    gaps = nodes[:, None] - nodes
    np.fill_diagonal(gaps, 1.0)
    return np.asarray(1.0 / np.prod(2.0 * gaps, axis=1))


def _derivatives(nodes: Floats) -> Floats:
    """From values at the nodes to the derivatives of their polynomial there (Berrut and Trefethen 2004)."""
    weights = _weights(nodes)
    gaps = nodes[:, None] - nodes
    np.fill_diagonal(gaps, 1.0)
    matrix = weights / weights[:, None] / gaps
    np.fill_diagonal(matrix, 0.0)
    np.fill_diagonal(matrix, -matrix.sum(axis=1))
    return np.asarray(matrix)


def _interpolation(nodes: Floats, x: Floats) -> Floats:
    """From values at the nodes to those of their polynomial at x, shape (x, nodes)."""
    gaps = x[:, None] - nodes
    hit = np.abs(gaps) < 4.0 * EPSILON
    gaps[hit] = 1.0
    terms = _weights(nodes) / gaps
    rows = terms / terms.sum(axis=1, keepdims=True)
    exact = hit.any(axis=1)
    rows[exact] = hit[exact]
    return np.asarray(rows)
