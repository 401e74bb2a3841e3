"""Roots in many brackets at once are where a scalar solver finds them, and each bracket closes from both sides."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from fopid_core.model.adaptive_grid import roots
from fopid_core.model.arrays import Floats

TOLERANCE = 1e-14
EDGES = np.arange(-7.6, 7.0, 0.1)

CURVES = {
    "a sine": np.sin,
    "a steep step": lambda z: np.tanh(1e3 * np.sin(z)),
    "an exponential": lambda z: np.exp(3.0 * np.sin(z)) - 1.0,
    "an infinite slope": lambda z: np.cbrt(np.sin(z)),
    "a triple root": lambda z: np.sin(z) ** 3,
}


def brackets(curve) -> tuple[Floats, Floats]:
    values = curve(EDGES)
    at = np.flatnonzero(values[1:] * values[:-1] < 0.0)
    return EDGES[at], EDGES[at + 1]


@pytest.mark.parametrize("name", CURVES)
def test_roots_are_those_of_a_scalar_solver(name: str) -> None:
    curve = CURVES[name]
    left, right = brackets(curve)
    assert left.size == 5
    alone = [brentq(np.sin, a, b, xtol=TOLERANCE, rtol=TOLERANCE) for a, b in zip(left, right, strict=True)]
    found = roots(curve, left, right, TOLERANCE)
    assert np.all(np.abs(found - alone) <= 2.0 * TOLERANCE * np.maximum(np.abs(found), 1.0))
    assert np.all((left <= found) & (found <= right))


def test_a_smooth_curve_takes_few_evaluations() -> None:
    """Ridders' method doubles the digits with each step of two; bisection of 0.1 to 1e-14 would take 44 such steps."""
    calls = 0

    def counted(z: Floats) -> Floats:
        nonlocal calls
        calls += 1
        return np.sin(z)

    roots(counted, *brackets(np.sin), TOLERANCE)
    assert calls <= 12


def test_a_root_on_the_edge_of_its_bracket_is_that_edge() -> None:
    found = roots(lambda z: z * (z - 1.0), np.array([0.0, 0.4]), np.array([0.7, 1.0]), TOLERANCE)
    assert found.tolist() == [0.0, 1.0]


def test_no_bracket_has_no_root() -> None:
    nothing = np.zeros(0)
    assert roots(lambda z: math.nan * z, nothing, nothing).size == 0
