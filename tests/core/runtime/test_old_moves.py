"""Moves of long ago, told together, against the sum over each of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from fopid_core.runtime.old_moves import PLACES, OldMoves, interpolation

CHAPTER = 64


@pytest.mark.parametrize(
    "response", [np.sqrt, np.log, lambda age: age**-0.9, lambda age: np.exp(-1e-3 * age), lambda age: age]
)
def test_told_together_they_are_what_they_are_one_by_one(response: Callable[[np.ndarray], np.ndarray]) -> None:
    moves = np.random.default_rng(3).normal(size=200 * CHAPTER)
    old = OldMoves(CHAPTER, response)
    for chapter in range(2, 200):
        old.add(moves[(chapter - 2) * CHAPTER : (chapter - 1) * CHAPTER])
        coming = old.coming(chapter * CHAPTER)
        if chapter % 20 == 0 or chapter > 196:
            them = np.arange((chapter - 1) * CHAPTER)
            exact = [
                response(now - them.astype(float)) @ moves[them] for now in chapter * CHAPTER + 1 + np.arange(CHAPTER)
            ]
            assert coming == pytest.approx(np.array(exact), abs=1e-11 * np.max(np.abs(exact)))


def test_what_is_kept_grows_as_a_logarithm() -> None:
    old = OldMoves(CHAPTER, np.sqrt)
    for chapter in range(2, 1000):
        old.add(np.ones(CHAPTER))
        old.coming(chapter * CHAPTER)
    assert len(old._stretches) < 30


def test_the_interpolation_is_exact_for_polynomials() -> None:
    at = np.linspace(-1.0, 1.0, 50)
    for power in range(PLACES.size):
        assert interpolation(at) @ PLACES**power == pytest.approx(at**power, abs=1e-13)
