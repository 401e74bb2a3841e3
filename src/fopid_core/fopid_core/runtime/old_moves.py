"""What moves of the input of long ago still do, for as long as one likes, with work that hardly grows.

The older a move, the smoother the response to it: over any stretch no longer than its age it is a polynomial but for
rounding. So the moves of such a stretch act together as a few at its nodes do (Chebyshev interpolation, as in the fast
multipole method; Greengard & Rokhlin 1987), and of two neighbouring stretches one is made when they are old enough.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from fopid_core.model.arrays import Floats

NODES = 24
"""In a stretch, whose length is its age at most: 24 leave some 1e-17 of a power of time."""


def interpolation(at: Floats) -> Floats:
    """The weights, shape (n, NODES), that the values at the nodes have in those at n places between -1 and 1.

    Examples
    --------
    >>> x = np.array([-0.3, 0.9])
    >>> bool(np.allclose(interpolation(x) @ np.exp(PLACES), np.exp(x), rtol=1e-14))
    True
    """
    return np.asarray(chebvander(at, NODES - 1) @ _COEFFICIENTS)


def places(count: int) -> Floats:
    """Where so many samples lie between -1 and 1, each in the middle of its own share."""
    return np.asarray((np.arange(count) + 0.5) * 2.0 / count - 1.0)


PLACES: Floats = np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
"""The nodes: Chebyshev's, of the first kind."""
_COEFFICIENTS: Floats = chebvander(PLACES, NODES - 1).T * (2.0 - (np.arange(NODES) == 0.0))[:, None] / NODES
_OF_HALVES = tuple(interpolation(0.5 * (PLACES + side)).T for side in (-1.0, 1.0))


@dataclass(frozen=True)
class _Stretch:
    """The moves ``start`` to ``start + size - 1``, as moves at the nodes."""

    start: int
    size: int
    moves: Floats

    @property
    def end(self) -> int:
        return self.start + self.size

    @property
    def instants(self) -> Floats:
        """Of the nodes [samples]."""
        return np.asarray(self.start - 0.5 + 0.5 * (PLACES + 1.0) * self.size)


class OldMoves:
    """Moves that are older than ``chapter`` samples, told chapter by chapter.

    Parameters
    ----------
    chapter : int
        Samples; from that age on the response to a step is as smooth as a stretch asks for.
    response : callable
        The response to a unit step at rising ages [samples].

    Examples
    --------
    >>> old = OldMoves(100, lambda age: np.sqrt(age))
    >>> old.add(np.ones(100))  # ticks 0 to 99
    >>> exact = [np.sqrt(now - np.arange(100.0)).sum() for now in range(201, 301)]
    >>> bool(np.allclose(old.coming(200), exact, rtol=1e-13))
    True
    """

    def __init__(self, chapter: int, response: Callable[[Floats], Floats]) -> None:
        self._chapter, self._response = chapter, response
        self._stretches: list[_Stretch] = []
        self._of_samples = interpolation(places(chapter))

    def add(self, moves: Floats) -> None:
        """The moves of the next chapter that has become old."""
        start = self._stretches[-1].end if self._stretches else 0
        self._stretches.append(_Stretch(start, self._chapter, self._of_samples.T @ moves))

    def coming(self, now: int) -> Floats:
        """What all of them add to the output at the samples ``now + 1`` to ``now + chapter``."""
        self._join(now)
        instants = np.concatenate([each.instants for each in self._stretches])
        moves = np.concatenate([each.moves for each in self._stretches])
        nodes = now + 0.5 + 0.5 * (PLACES + 1.0) * self._chapter
        ages, where = np.unique(nodes[:, None] - instants, return_inverse=True)
        at_nodes = self._response(ages)[where.reshape(NODES, -1)] @ moves
        return np.asarray(self._of_samples @ at_nodes)

    def _join(self, now: int) -> None:
        """Make one of two stretches of one size wherever they are as old as both together are long."""
        done: list[_Stretch] = []
        for each in self._stretches:
            done.append(each)
            while len(done) > 1 and done[-2].size == done[-1].size and now - done[-1].end >= 2 * done[-1].size:
                second, first = done.pop(), done.pop()
                moves = sum(half @ part.moves for half, part in zip(_OF_HALVES, (first, second), strict=True))
                done.append(_Stretch(first.start, 2 * first.size, np.asarray(moves)))
        self._stretches = done
