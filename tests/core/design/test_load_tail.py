"""What a load has left in the end, against inverse transforms in 30 digits, and in designs that were once made."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest

from fopid_core.design.load_tail import LEFT_MAX, LoadTail, fading_time, left_in_words
from fopid_core.design.specification import TuningRequest
from fopid_core.design.tuner import tune
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process

SLOW = [
    ("1/s", 1.0, (1.0, 0.05, 0.0, 1.0, 1.0)),
    ("1/s", 1.0, (0.0, 1.0, 0.0, 0.5, 1.0)),
    ("1/(s(0.5s+1))", 1.17, (0.0036, 1.37, 0.5, 0.27, 0.81)),
    ("2/(3s+1)", 0.5, (0.5, 0.02, 0.0, 0.9, 1.0)),
    ("1/(s^1.2+1)", 1.0, (0.5, 0.2, 0.1, 0.4, 0.5)),
]


def by_inversion(process: str, crossover: float, gains: tuple[float, ...]) -> float:
    """By Talbot's contour; the processes are without delay, their texts read by hand."""
    kp, ki, kd, lam, mu = gains
    transfer = {
        "1/s": lambda s: 1 / s, "1/(s(0.5s+1))": lambda s: 1 / (s * (s / 2 + 1)),
        "2/(3s+1)": lambda s: 2 / (3 * s + 1), "1/(s^1.2+1)": lambda s: 1 / (s**1.2 + 1),
    }[process]  # fmt: skip
    with mp.workdps(30):

        def load(s: mp.mpc) -> mp.mpc:
            return 1 / (1 / transfer(s) + kp + ki * s**-lam + kd * s**mu) / s

        left = mp.invertlaplace(load, fading_time(Process.parse(process), crossover), method="talbot")
        return float(abs(left) / abs(transfer(mp.mpc(0, crossover))))


@pytest.mark.parametrize(("process", "crossover", "gains"), SLOW)
def test_what_is_left_is_that_of_the_inverse_transform(
    process: str, crossover: float, gains: tuple[float, ...]
) -> None:
    found = LoadTail(Process.parse(process), crossover).left(np.array([gains]))[0]
    assert found == pytest.approx(by_inversion(process, crossover, gains), abs=1e-3)  # eight terms give three digits


@pytest.mark.parametrize("method", ["frequency", pytest.param("time", marks=pytest.mark.slow)])
@pytest.mark.parametrize("process", ["1/(s(0.5s+1))", "1/s*exp(-0.5s)"])
def test_no_design_leaves_a_load_for_ever(process: str, method: str) -> None:
    """Once lam was 0.05 to 0.6 here, and a sixth to all of the error stayed."""
    result = tune(TuningRequest(Process.parse(process), method))
    assert result.success, result.unmet
    assert isinstance(result.controller, Fopid)
    crossover = result.achieved.crossover if method == "frequency" else 1.0  # their natural crossovers are near 1
    assert LoadTail(Process.parse(process), crossover).left(np.array([result.controller.gains]))[0] < 1.5 * LEFT_MAX


@pytest.mark.parametrize(
    ("process", "method"), [("1/s", "frequency"), pytest.param("1/s*exp(-0.5s)", "time", marks=pytest.mark.slow)]
)
def test_where_that_is_not_kept_it_is_said(process: str, method: str) -> None:
    """No design for 1/s with a flat phase fades fast; nor need one in time for which lam's range is named."""
    named = {"lam": (0.05, 2.0)} if method == "time" else {}
    result = tune(TuningRequest(Process.parse(process), method, bounds=named))
    assert "a load fades slowly" in result.message
    assert result.success


def test_what_hardly_fades_is_not_said_to_fade() -> None:
    weak = Fopid(0.1, 0.01, 0.0, 0.05)
    said = left_in_words(Process.parse("1/s"), weak, 1.0)
    assert said.startswith("; a load hardly fades: after 100 s its error is ")
    left = float(LoadTail(Process.parse("1/s"), 1.0).left(np.array([weak.gains]))[0])
    assert said.endswith(f" {left:.2g} times the process's gain at the crossover")


@pytest.mark.parametrize("process", ["1/s", "1/(s+1)"])
def test_designs_have_a_margin_for_a_delay(process: str) -> None:
    result = tune(TuningRequest(Process.parse(process), "frequency"))
    assert result.success, result.message
    assert result.achieved.delay_margin > 0.0


@pytest.mark.slow
def test_without_one_for_any_delay_a_design_is_no_success() -> None:
    assert not tune(TuningRequest(Process.parse("(s+2)/(s+1)"), "frequency")).success
