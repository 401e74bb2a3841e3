"""The volume that a front dominates, exactly, for three objectives."""

from __future__ import annotations

import numpy as np


def hypervolume(values: np.ndarray, reference: np.ndarray) -> float:
    """Volume between points and a reference that is worse in everything; smaller is better, shape (n, 3).

    Slabs between neighbouring values of the last objective: in each, the area that the points below it dominate.

    >>> hypervolume(np.array([[0.0, 0.0, 0.0], [-1.0, 0.5, 0.5]]), np.ones(3))
    1.25
    """
    inside = values[(values < reference).all(axis=1)]
    inside = inside[np.argsort(inside[:, 2])]
    levels = np.append(inside[:, 2], reference[2])
    return float(sum(_area(inside[: k + 1, :2], reference) * (levels[k + 1] - levels[k]) for k in range(len(inside))))


def _area(points: np.ndarray, reference: np.ndarray) -> float:
    area, lowest = 0.0, reference[1]
    for x, y in points[np.lexsort((points[:, 1], points[:, 0]))]:
        if y < lowest:
            area += (reference[0] - x) * (lowest - y)
            lowest = y
    return area
