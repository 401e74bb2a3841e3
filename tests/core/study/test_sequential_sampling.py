"""Draws from a density, against the moments that integrals of it give."""

from __future__ import annotations

import numpy as np
import pytest

from fopid_core.study.sequential_sampling import sample


def _two_hills(x: np.ndarray) -> np.ndarray:
    """A narrow and a wide hill, 2 : 1 in weight, far apart."""
    narrow = np.exp(-0.5 * np.sum(((x - 3.0) / 0.5) ** 2, axis=1)) / 0.25
    wide = np.exp(-0.5 * np.sum((x + 3.0) ** 2, axis=1))
    return np.log(2.0 * narrow + wide + 1e-300)


def _broad(x: np.ndarray) -> np.ndarray:
    return -0.5 * np.sum((x / 5.0) ** 2, axis=1)


def test_hills_far_apart_have_the_share_of_draws_of_their_volume_and_their_own_widths() -> None:
    random = np.random.default_rng(0)
    found = sample(_broad, _two_hills, 5.0 * random.standard_normal((8000, 2)), 800, random)
    right = found[:, 0] > 0.0
    assert found.shape == (800, 2)
    # 400 independent ones count at least; a share of 2/3 is then known to 0.024.
    assert np.mean(right) == pytest.approx(2.0 / 3.0, abs=0.12)
    assert found[right].mean(axis=0) == pytest.approx(3.0, abs=0.1)
    assert found[right].std(axis=0) == pytest.approx(0.5, rel=0.25)
    assert found[~right].std(axis=0) == pytest.approx(1.0, rel=0.25)


def test_a_border_is_not_crossed() -> None:
    random = np.random.default_rng(1)

    def above_zero(x: np.ndarray) -> np.ndarray:
        return np.where(x[:, 0] >= 0.0, -x[:, 0], -np.inf)

    found = sample(lambda x: np.where(np.abs(x[:, 0] - 10.0) <= 10.0, 0.0, -np.inf), above_zero,
                   random.uniform(0.0, 20.0, (2000, 1)), 400, random)  # fmt: skip
    assert found.min() >= 0.0
    assert found.mean() == pytest.approx(1.0, abs=0.2)


def test_peaks_far_apart_have_their_shares_from_one_alone_on_where_some_moves_draw_anew() -> None:
    random = np.random.default_rng(2)
    weights = np.array([0.5, 0.3, 0.2])

    def peaks(x: np.ndarray) -> np.ndarray:
        at = np.floor(x[:, 0]).astype(int)
        inside = (at >= 0) & (at < 3) & (np.abs(x[:, 0] - at - 0.5) < 0.15)
        return np.where(inside, np.log(weights[np.clip(at, 0, 2)]), -np.inf)

    def redrawn(x: np.ndarray, drawing: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Between 0 and 3, the likelier the further from 0."""
        tried = 3.0 * np.sqrt(drawing.uniform(size=x.shape))
        return tried, np.log(x[:, 0] / tried[:, 0])

    begin = random.uniform(0.4, 0.6, (4000, 1))
    assert sample(peaks, peaks, begin, 4000, random).max() < 1.0
    found = begin
    for _ in range(20):  # of its 200 moves 60 draw anew, and 3 in 10 of these meet a peak
        found = sample(peaks, peaks, found, 4000, random, redrawn)
    shares = np.bincount(np.floor(found[:, 0]).astype(int), minlength=3) / len(found)
    # Of 4,000 independent ones a share is known to 0.008; without the way back they were 0.21, 0.38, 0.42.
    assert shares == pytest.approx(weights, abs=0.03)
