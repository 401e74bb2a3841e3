"""From transforms to signals without delay: the inverse Laplace transform on hyperbolas.

The transform of a loop without delay is analytic but for poles and a cut along the negative real axis. Poles outside a
sector about that axis, those that ring or grow, are known and stand apart (``poles``); around the rest goes a hyperbola
along which exp(s t) dies out, and the trapezoid rule on it converges geometrically, whatever the loop (Weideman and
Trefethen 2007; Lopez-Fernandez, Palencia and Schaedle 2006). One hyperbola serves a window of instants up to a factor
apart; in each window the signal is kept as a Chebyshev series. A second hyperbola checks the first.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fopid_core.model.arrays import Complexes, Floats

WINDOW_RATIO = 5.0
_NODES = 48  # of the Chebyshev series in a window
_DIGITS = 33.0  # what the trapezoid rule and its truncation leave: exp(-33)
_CHECKS = np.array([0.003, 0.021, 0.083, 0.171, 0.317, 0.443, 0.591, 0.707, 0.859, 0.953, 0.991])
_SAFETY = 4.0

Transforms = Callable[[Complexes], tuple[Complexes, Floats]]


@dataclass(frozen=True)
class Hyperbola:
    """Nodes s (m,) and weights w (m,) for instants in a window: the signal is the real part of sum w F(s) exp(s t)."""

    nodes: Complexes
    weights: Complexes

    @staticmethod
    def around(sector: float, first: float, last: float, growth: float, fullness: float) -> Hyperbola:
        """For instants from ``first`` to ``last``, within ``sector`` [rad] of the imaginary axis.

        ``growth`` is how far exp(s t) grows at most, exp(growth), and ``fullness`` where in the sector it lies.
        """
        turn = 0.5 * math.pi - sector  # from the negative real axis to the free sector's edge
        alpha = fullness * (0.5 * math.pi - turn)
        strip = 0.95 * min(alpha, sector - alpha)
        step = 2.0 * math.pi * strip / (_DIGITS + growth)
        mu = growth / last
        reach = math.acosh(1.0 / math.sin(alpha) + (_DIGITS + growth) / (mu * first * math.sin(alpha)))
        u = (np.arange(math.ceil(reach / step)) + 0.5) * step
        nodes = mu * (1.0 - math.sin(alpha) * np.cosh(u) + 1j * math.cos(alpha) * np.sinh(u))
        slopes = mu * (-math.sin(alpha) * np.sinh(u) + 1j * math.cos(alpha) * np.cosh(u))
        return Hyperbola(nodes, slopes * (step / (1j * math.pi)))

    def signals(self, values: Complexes, time: Floats) -> Floats:
        """The k signals (k, n) from their transforms at the nodes (k, m)."""
        return np.asarray((values * self.weights @ np.exp(np.outer(self.nodes, time))).real)


@dataclass(frozen=True)
class Windows:
    """k signals as Chebyshev series on adjoining windows.

    Attributes
    ----------
    edges : ndarray, shape (w + 1,)
        Rising instants [s], a constant factor apart.
    series : ndarray, shape (w, k, n)
    errors : ndarray, shape (w, k)
        Estimated largest error in each window.
    """

    edges: Floats
    series: Floats
    errors: Floats

    def at(self, time: Floats) -> Floats:
        """The signals at any instants, shape (k, n); before the first edge as there."""
        time = np.clip(time, self.edges[0], self.edges[-1])
        home = np.searchsorted(self.edges[1:-1], time)
        values = np.empty((self.series.shape[1], time.size))
        for i in np.unique(home):
            first, last = self.edges[i], self.edges[i + 1]
            own = home == i
            x = 2.0 * ((time[own] - first) / (last - first)) - 1.0
            values[:, own] = np.polynomial.chebyshev.chebval(x, _shortened(self.series[i]).T)
        return values

    def error_at(self, time: Floats) -> Floats:
        """The estimated error at any instants, shape (k, n)."""
        home = np.clip(np.searchsorted(self.edges[1:-1], time), 0, len(self.errors) - 1)
        return np.asarray(self.errors[home].T)


def invert_on_hyperbolas(transforms: Transforms, sector: float, first: float, last: float) -> Windows:
    """Signals without delay from their transforms.

    Parameters
    ----------
    transforms : callable
        From points (m,) to k transforms there (k, m) and the errors of these (k, m). Analytic but within ``pi/2 -
        sector`` of the negative real axis.
    sector : float
        How far beyond the imaginary axis the transforms are analytic [rad].
    first, last : float
        Instants [s].

    Examples
    --------
    >>> def transforms(s):
    ...     return 1.0 / (s + 1.0)[None, :] ** 2, np.zeros((1, s.size))
    >>> windows = invert_on_hyperbolas(transforms, math.pi / 4, 0.1, 2.0)
    >>> round(float(windows.at(np.array([2.0]))[0, 0]), 12)  # t exp(-t)
    0.270670566473
    """
    count = max(math.ceil(math.log(last / first) / math.log(WINDOW_RATIO) - 1e-9), 1)
    edges = last * np.exp(-math.log(WINDOW_RATIO) * np.arange(count, -1, -1.0))
    main = Hyperbola.around(sector, 1.0, WINDOW_RATIO, 5.0, 0.5)
    second = Hyperbola.around(sector, 1.0, WINDOW_RATIO, 6.5, 0.42)
    x = np.cos(math.pi * (np.arange(_NODES) + 0.5) / _NODES)
    spots = 0.5 * (1.0 + WINDOW_RATIO) + 0.5 * (WINDOW_RATIO - 1.0) * x
    checks = 1.0 + (WINDOW_RATIO - 1.0) * _CHECKS
    to_series = (2.0 / _NODES) * np.cos(math.pi * np.outer(np.arange(_NODES), np.arange(_NODES) + 0.5) / _NODES)
    to_series[0] *= 0.5
    rate = 1.0 / edges[:-1]
    values, wobble = _scaled(transforms, main, rate)
    other, _ = _scaled(transforms, second, rate)
    grown = np.exp(np.outer(main.nodes, spots))
    series = ((values * main.weights) @ grown).real @ to_series.T
    checked = ((other * second.weights) @ np.exp(np.outer(second.nodes, checks))).real
    x_checks = 2.0 * _CHECKS - 1.0
    seen = np.polynomial.chebyshev.chebval(x_checks, np.moveaxis(series, -1, 0))
    rounding = ((wobble * np.abs(main.weights)) @ np.abs(grown)).max(axis=-1)
    errors = _SAFETY * (np.abs(seen - checked).max(axis=-1) + rounding)
    return Windows(edges, series, errors)


def _scaled(transforms: Transforms, hyperbola: Hyperbola, rate: Floats) -> tuple[Complexes, Floats]:
    """The transforms at the nodes of all windows, shape (w, k, m), times the windows' rates."""
    points = (rate[:, None] * hyperbola.nodes).ravel()
    values, errors = transforms(points)
    shape = (values.shape[0], rate.size, hyperbola.nodes.size)
    scale = rate[:, None, None]
    return np.moveaxis(values.reshape(shape), 1, 0) * scale, np.moveaxis(errors.reshape(shape), 1, 0) * scale


def _shortened(series: Floats) -> Floats:
    """Without the last terms that are nothing but rounding."""
    sizes = np.abs(series).max(axis=0)
    needed = np.flatnonzero(sizes > 1e-17 * sizes.max(initial=0.0))
    return series[:, : int(needed[-1]) + 1] if needed.size else series[:, :1]
