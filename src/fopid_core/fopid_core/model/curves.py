"""A complex curve over the logarithm of frequency, followed so closely that nothing happens between its points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fopid_core.model.arrays import Complexes, Floats

_LARGEST_CHANGE = 0.5  # of the value's logarithm between neighbours: rad of phase, or ln of gain
_MOST_HALVINGS = 30


def follow(curve: Callable[[Floats], Complexes], z: Floats) -> tuple[Floats, Complexes]:
    """Put points in until phase and gain change little from each to the next.

    Parameters
    ----------
    curve : callable
        From ln w, shape (m,), to values, shape (m,).
    z : ndarray, shape (n,)
        The first grid, ascending; close enough that a delay does not turn by more than half a turn between its points.

    Returns
    -------
    z, values : ndarray
        The grid with the new points, and the values there.

    Examples
    --------
    >>> import numpy as np
    >>> z, values = follow(lambda z: 1.0 / (1.0 - np.exp(2.0 * z) + 1e-4j), np.linspace(-1.0, 1.0, 3))
    >>> bool(np.max(np.abs(np.angle(values[1:] / values[:-1]))) < 0.5)
    True
    """
    values = curve(z)
    for _ in range(_MOST_HALVINGS):
        with np.errstate(divide="ignore", invalid="ignore"):
            wide = np.flatnonzero(np.abs(np.log(values[1:] / values[:-1])) > _LARGEST_CHANGE)
        if wide.size == 0:
            break
        middle = 0.5 * (z[wide] + z[wide + 1])
        z = np.insert(z, wide + 1, middle)
        values = np.insert(values, wide + 1, curve(middle))
    return z, values
