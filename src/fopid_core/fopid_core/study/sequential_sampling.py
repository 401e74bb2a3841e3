"""Draws from a density that is known up to a factor: sequential Monte Carlo with moves of differential evolution.

References
----------
Del Moral, Doucet and Jasra, J. R. Statist. Soc. B 68 (2006) 411-436; ter Braak and Vrugt, Stat. Comput. 18 (2008)
435-446.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from fopid_core.model.arrays import Floats

_HALF, _MOST_STAGES = 0.5, 60
"""After a stage the particles count as this share of as many independent ones."""
_MOVES, _LAST_MOVES = 3, 10
_ANEW = 0.3
"""As many of the moves draw some numbers anew, where the caller knows how."""

Redrawn = Callable[[Floats, np.random.Generator], tuple[Floats, Floats]]
"""Others in the place of particles, and the logarithm of how much likelier the way back is than that there."""


def sample(
    log_first: Callable[[Floats], Floats], log_last: Callable[[Floats], Floats], begin: Floats, m: int,
    random: np.random.Generator, redrawn: Redrawn | None = None,
) -> Floats:  # fmt: skip
    """From particles of one density, at least m, shape (M, k), to m of another: sequential Monte Carlo.

    The densities in between are geometric means, each so near the one before that half of m particles count; and
    in each the particles move by differences of others.
    """
    now, first, last = begin, log_first(begin), log_last(begin)
    share, k = 0.0, begin.shape[1]
    for _ in range(_MOST_STAGES):
        gain = last - first
        share, before = _next_share(gain, share, _HALF * m), share
        weights = np.exp((share - before) * (gain - gain.max()))
        chosen = _systematic(weights / weights.sum(), m, random)
        now, first, last = now[chosen], first[chosen], last[chosen]
        for _ in range(_MOVES if share < 1.0 else _LAST_MOVES):
            others = np.stack([now[random.permutation(m)], now[random.permutation(m)]])
            length = random.choice([1.0, 2.38 / math.sqrt(2.0 * k)], (m, 1), p=[0.1, 0.9])
            length = length * random.uniform(0.3, 1.2, (m, 1))
            some = random.uniform(size=(m, k)) < random.choice([0.3, 1.0], (m, 1))
            tried, back = now + length * (others[0] - others[1]) * some, np.zeros(m)
            if redrawn is not None:
                anew = random.uniform(size=m) < _ANEW
                tried[anew], back[anew] = redrawn(now[anew], random)
            first_tried, last_tried = log_first(tried), log_last(tried)
            tempered = last_tried if share == 1.0 else (1.0 - share) * first_tried + share * last_tried
            taken = np.log(random.uniform(size=m)) < back + tempered - (1.0 - share) * first - share * last
            now = np.where(taken[:, np.newaxis], tried, now)
            first, last = np.where(taken, first_tried, first), np.where(taken, last_tried, last)
        if share == 1.0:
            break
    return now


def _next_share(gain: Floats, share: float, least: float) -> float:
    """The furthest on the way at which so many of the particles still count."""

    def counting(to: float) -> float:
        weights = np.exp((to - share) * (gain - gain.max()))
        return float(weights.sum() ** 2 / (weights @ weights))

    if counting(1.0) >= least:
        return 1.0
    low, high = share, 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if counting(middle) >= least else (low, middle)
    return high


def _systematic(shares: Floats, count: int, random: np.random.Generator) -> Floats:
    places = (np.arange(count) + random.uniform()) / count
    return np.minimum(np.searchsorted(np.cumsum(shares), places), shares.size - 1)
