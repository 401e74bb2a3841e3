"""Rounding errors of a recursion in double precision make the printed indices of P1."""

from __future__ import annotations

import control
import numpy as np
import pytest

from fopid_core.model.fopid import Fopid
from fopid_core.model.gruenwald import gl1_response
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process
from fopid_core.study.reproduce.facts import printed_tuning
from fopid_core.study.reproduce.recursion import recursive_index, recursive_output


def test_with_whole_orders_it_is_the_backward_difference_of_the_loop() -> None:
    step = 0.1
    z = control.tf([1.0, 0.0], [1.0], step)
    s = (1.0 - 1.0 / z) / step
    opened = (2.0 + 1.0 / s) / (s + 1.0)
    # the answer comes one sample after the step
    closed = control.minreal(opened / (1.0 + opened) / z, verbose=False)
    expected = control.step_response(closed, T=np.arange(50) * step).outputs
    found = recursive_output(Loop(Process.parse("1/(s+1)"), Fopid(2.0, 1.0, 0.0)), 50, step)
    assert found == pytest.approx(np.squeeze(expected), abs=1e-9)


def test_the_differences_are_those_of_the_transform() -> None:
    loop = printed_tuning("P2", "ITSE").loop
    expected = gl1_response(loop, 5.0, 0.01).output
    # the last bit times step**-3.84, the highest order; its errors are drawn together by the loop
    assert recursive_output(loop, 501, 0.01) == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("index", ["ITAE", "ISTES"])
def test_the_printed_index_holds_the_rounding_errors(index: str) -> None:
    tuning = printed_tuning("P1", index)
    assert recursive_index(tuning) == pytest.approx(tuning.value, rel=3e-5)
