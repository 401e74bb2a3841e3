"""A loop is what its block diagram says."""

from __future__ import annotations

import numpy as np
import pytest

from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import read_process

S = np.array([0.1 + 0.2j, 1.0 + 3.0j, 0.01j, 30j])
LOOPS = [
    Loop(read_process(text), Fopid(*gains))
    for text in ("P1", "1/(s^1.3+1)*exp(-0.4s)", "1/s", "(s+2)/(s-1)")
    for gains in ((2.0, 0.5, 0.3, 0.8, 1.2), (1.0, 0.0, 0.0, 1.0, 1.0), (-1.0, 2.0, 0.0, 1.4, 0.0))
]


@pytest.mark.parametrize("loop", LOOPS, ids=str)
def test_its_functions_are_those_of_the_loop_gain(loop: Loop) -> None:
    gain = loop.controller(S) * loop.process(S)
    assert loop(S) == pytest.approx(gain)
    assert loop.sensitivity(S) == pytest.approx(1 / (1 + gain))
    assert loop.complementary_sensitivity(S) == pytest.approx(gain / (1 + gain))
    assert loop.open_loop_numerator(S) / loop.open_loop_denominator(S) == pytest.approx(gain)
    assert loop.characteristic(S) / loop.open_loop_denominator(S) == pytest.approx(1 + gain)


@pytest.mark.parametrize("loop", LOOPS, ids=str)
def test_its_logarithmic_derivative_is_the_limit_of_difference_quotients(loop: Loop) -> None:
    s = S[:2]
    quotient = np.log(loop(s + 1e-6) / loop(s - 1e-6)) / 2e-6
    assert loop.logarithmic_derivative(s) == pytest.approx(quotient, rel=1e-6)


def test_sensitivities_stay_exact_where_the_loop_gain_is_tiny_or_huge() -> None:
    loop = Loop(read_process("P3"), Fopid(2.0, 0.5))
    assert complex(loop.complementary_sensitivity(1e6j)) == pytest.approx(2e-24, rel=1e-5)
    assert abs(complex(loop.sensitivity(1e-9j))) == pytest.approx(2e-9, rel=1e-6)


def test_a_pole_on_the_axis_makes_them_infinite() -> None:
    loop = Loop(read_process("1/s^2"), Fopid(1.0))
    assert np.isinf(np.abs(loop.sensitivity(1j))) or np.abs(loop.sensitivity(1j)) > 1e12
