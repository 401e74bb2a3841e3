"""A complex curve over the logarithm of frequency, followed so closely that nothing happens between its points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fopid_core.model.arrays import Complexes, Floats

_LARGEST_CHANGE = 0.5  # of the value's logarithm between neighbours: rad of phase, or ln of gain
_MOST_HALVINGS = 30
_MOST_RIDDERS_STEPS = 60  # each at least halves the bracket: to less than rounding leaves of it
_MOST_POINTS = 30_000  # more are asked for only by a curve that is nothing but rounding
_ROOT = 1e-14  # of a bracket, where a root is found


def refine(
    curve: Callable[[Floats], Complexes], z: Floats, values: Complexes | None = None
) -> tuple[Floats, Complexes]:
    """Put points in until phase and gain change little from each to the next.

    Parameters
    ----------
    curve : callable
        From ln w, shape (m,), to values, shape (m,).
    z : ndarray, shape (n,)
        The first grid, ascending; close enough that a delay does not turn by more than half a turn between its points.
    values : ndarray, shape (n,), optional
        The curve there, where it is known.

    Returns
    -------
    z, values : ndarray
        The grid with the new points, and the values there. A curve that moves between any two points is given up.

    Examples
    --------
    >>> import numpy as np
    >>> z, values = refine(lambda z: 1.0 / (1.0 - np.exp(2.0 * z) + 1e-4j), np.linspace(-1.0, 1.0, 3))
    >>> bool(np.max(np.abs(np.angle(values[1:] / values[:-1]))) < 0.5)
    True
    """
    values = curve(z) if values is None else values
    most = max(_MOST_POINTS, 2 * z.size)
    for _ in range(_MOST_HALVINGS):
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):  # of values that are next to nothing
            wide = np.flatnonzero(np.abs(np.log(values[1:] / values[:-1])) > _LARGEST_CHANGE)
        if wide.size == 0 or z.size + wide.size > most:
            break
        middle = 0.5 * (z[wide] + z[wide + 1])
        z = np.insert(z, wide + 1, middle)
        values = np.insert(values, wide + 1, curve(middle))
    return z, values


def roots(curve: Callable[[Floats], Floats], left: Floats, right: Floats, tolerance: float = _ROOT) -> Floats:
    """Where a curve passes through zero, one root in each bracket: Ridders' method, all brackets at once.

    Own, because scipy 1.11 has none for arrays: ``brentq`` in a loop takes 5 times as long for 10 brackets, 31 for 100.

    Parameters
    ----------
    curve : callable
        From z, shape (m,), to values, shape (m,).
    left, right : ndarray, shape (n,)
        Between which it changes its sign.
    tolerance : float
        Width of a bracket, relative, at which its middle is the root.

    References
    ----------
    Ridders, A new algorithm for computing a single root of a real continuous function (1979).

    Examples
    --------
    >>> import numpy as np
    >>> roots(lambda z: z**3 - 2.0, np.array([0.0]), np.array([2.0])).round(9).tolist()
    [1.25992105]
    """
    if left.size == 0:
        return left
    low, high = curve(left), curve(right)
    for _ in range(_MOST_RIDDERS_STEPS):
        middle = 0.5 * (left + right)
        value = curve(middle)
        root = np.sqrt(value**2 - low * high)
        share = np.divide(np.sign(low - high) * value, root, out=np.zeros_like(root), where=root > 0.0)
        # A root at one end would leave the other to bisection: a point just inside closes the bracket.
        inside = np.minimum(0.5 * tolerance * np.maximum(np.abs(left), 1.0), 0.25 * (right - left))
        between = np.clip(middle + (middle - left) * share, left + inside, right - inside)
        found = curve(between)
        # Of the four points the two neighbours with a change of sign are kept.
        points = np.stack([left, np.minimum(middle, between), np.maximum(middle, between), right])
        swapped = between < middle
        values = np.stack([low, np.where(swapped, found, value), np.where(swapped, value, found), high])
        at = np.argmax(np.sign(values[:-1]) != np.sign(values[1:]), axis=0)
        every = np.arange(left.size)
        left, right, low, high = points[at, every], points[at + 1, every], values[at, every], values[at + 1, every]
        if np.all(right - left <= tolerance * np.maximum(np.abs(left), 1.0)):
            break
    zero: Floats = np.where(low == 0.0, left, np.where(high == 0.0, right, 0.5 * (left + right)))
    return zero
