"""The trade-off: every design is stable and does what is told of it, and none is beaten."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest

from fopid_core.design.front.front import Front, beaten, front
from fopid_core.errors import InputError
from fopid_core.model.process import Process, read_process

SAMPLE_TIME = 0.01


@pytest.fixture(scope="module")
def trade_off() -> Front:
    return front(read_process("P1"), "pid", points=40)


def test_it_has_the_points_asked_for_all_stable_and_none_beaten(trade_off: Front) -> None:
    assert len(trade_off) == 40
    assert trade_off.stable.all()
    assert not beaten(trade_off.objectives).any()


def test_it_reaches_from_end_to_end_of_its_bounds(trade_off: Front) -> None:
    assert trade_off.ms.min() == pytest.approx(1.2, rel=2e-3)
    assert trade_off.ms.max() == pytest.approx(2.0, rel=2e-3)
    assert trade_off.noise_gain.max() == pytest.approx(20.0, rel=2e-3)
    assert trade_off.noise_gain.min() < 1.01, "hardly more than an integral alone"


def test_where_the_trade_off_is_a_curve_the_designs_lie_evenly_along_it() -> None:
    """With two gains max |S| and noise go together: 36 of 40 designs once lay in the flattest tenth of it."""
    found = front(read_process("2/((3s+1)(s+1)) * exp(-0.7s)"), "pi", points=40)
    assert len(found) == 40
    order = np.argsort(found.ms)
    path = np.log(np.column_stack([found.ms - 1.0, found.noise_gain]))[order]
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert steps.max() < 4.0 * steps.mean()


def test_its_figures_are_those_of_a_dense_grid_and_of_python_control(trade_off: Front) -> None:
    s = control.tf("s")
    w = np.geomspace(1e-4, math.pi / SAMPLE_TIME, 100_000)
    time = np.linspace(0.0, trade_off.horizon, 20_001)
    for index in range(0, len(trade_off), 13):
        (kp, ki, kd, lam, mu), slow = trade_off.gains[index], trade_off.filter_time[index]
        assert (lam, mu) == (1.0, 1.0)
        feedback = (kp + ki / s + kd * s) / (1 + slow * s + (slow * s) ** 2 / 2)
        process = 1 / (s + 1) ** 3
        closed = control.minreal(process / (1 + process * feedback), verbose=False)
        assert closed.poles().real.max() < 0.0
        output = control.forced_response(closed, time, np.ones_like(time)).outputs
        assert (np.abs(output[1:]) + np.abs(output[:-1])).sum() * time[1] / 2.0 == pytest.approx(
            trade_off.iae_load[index], rel=1e-4
        )
        at = 1j * w
        c = (kp + ki / at + kd * at) / (1 + slow * at + (slow * at) ** 2 / 2)
        opened = c / (1 + at) ** 3
        assert np.abs(1.0 / (1.0 + opened)).max() == pytest.approx(trade_off.ms[index], rel=1e-5)
        assert np.abs(opened / (1.0 + opened)).max() == pytest.approx(trade_off.mt[index], rel=1e-5)
        assert np.abs(c / (1.0 + opened)).max() == pytest.approx(trade_off.noise_gain[index], rel=1e-5)


def test_the_best_within_bounds_is_within_them(trade_off: Front) -> None:
    index = trade_off.best(ms_max=1.5, noise_max=8.0)
    within = (trade_off.ms <= 1.5) & (trade_off.noise_gain <= 8.0)
    assert within[index]
    assert trade_off.iae_load[index] == trade_off.iae_load[within].min()
    assert trade_off.best(ms_max=1.0) == -1


def test_what_cannot_be_held_has_an_empty_front_and_a_reason() -> None:
    found = front(Process.parse("1/(s-1)*exp(-0.6s)"), "pi", points=10)
    assert len(found) == 0
    assert "no design of structure pi with Ms <= 2" in found.reason


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"structure": "pidd"}, "structure = 'pidd'"),
        ({"points": 1}, "points = 1; allowed: 2 to"),
        ({"ms_min": 2.5}, "ms_min = 2.5; allowed: above 1 and below"),
        ({"filter_order": 0}, "filter_order = 0; allowed: 1 or 2"),
        ({"ms_max": math.nan}, "ms_min"),
        ({"noise_max": -1.0}, "noise_max = -1"),
    ],
)
def test_a_bad_argument_is_named(changes: dict, told: str) -> None:
    with pytest.raises(InputError, match=told):
        front(read_process("P1"), **changes)
