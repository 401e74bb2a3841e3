"""Weights of the setpoint that overshoot less at little more error, beside python-control's responses."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import control
import numpy as np
import pytest
from scipy.integrate import trapezoid

from fopid_core.design.setpoint_weights import DERIVATIVE_PAYS, LITTLE_MORE, SHARES, calmest_weights
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process
from fopid_core.model.two_degrees import SetpointWeights
from tests.cases import slow

KP, KI, KD, HORIZON = 20.0, 6.0, 10.0, 60.0
LOOP = Loop(Process.parse("1/((10s+1)(s+1))"), Fopid(KP, KI, KD))


@cache
def seen(proportional: float, derivative: float, kd: float = KD) -> tuple[float, float]:
    """Integral of the absolute error after a step of the setpoint, and the overshoot [%]."""
    s = control.tf("s")
    process, controller = 1 / ((10 * s + 1) * (s + 1)), KP + KI / s + kd * s
    acts_on = proportional * KP + KI / s + derivative * kd * s
    answer = control.minreal(process * acts_on / (1 + process * controller), verbose=False)
    time = np.linspace(0.0, HORIZON, 6_001)
    output = control.step_response(answer, time).outputs
    return float(trapezoid(np.abs(1.0 - output), time)), 100.0 * max(float(output.max()) - 1.0, 0.0)


def least(derivative: float, kd: float = KD) -> float:
    """Error of the best weight of the proportional part."""
    return min(seen(weight, derivative, kd)[0] for weight in SHARES.tolist())


def test_it_overshoots_less_at_little_more_error() -> None:
    chosen = calmest_weights(LOOP, HORIZON)
    error, overshoot = seen(chosen.proportional, chosen.derivative)
    assert error <= LITTLE_MORE * least(chosen.derivative) * 1.001
    assert overshoot < 0.2 * seen(1.0, chosen.derivative)[1]


def test_no_smaller_weight_leaves_as_little() -> None:
    chosen = calmest_weights(LOOP, HORIZON)
    smaller = [weight for weight in SHARES.tolist() if weight < chosen.proportional]
    most = LITTLE_MORE * least(chosen.derivative) * 0.999
    assert min(seen(weight, chosen.derivative)[0] for weight in smaller) > most


@pytest.mark.parametrize("kd", slow(0.3, 1.0, 3.0, 10.0))
def test_a_derivative_of_the_setpoint_must_pay(kd: float) -> None:
    chosen = calmest_weights(replace(LOOP, controller=Fopid(KP, KI, kd)), HORIZON)
    pays = least(0.0, kd) > DERIVATIVE_PAYS * least(1.0, kd)
    assert chosen.derivative == (1.0 if pays else 0.0)


def test_a_small_derivative_does_not_pay_and_a_large_one_does() -> None:
    small, large = (calmest_weights(replace(LOOP, controller=Fopid(KP, KI, kd)), HORIZON) for kd in (0.3, KD))
    assert (small.derivative, large.derivative) == (0.0, 1.0)


@pytest.mark.parametrize(("sample_time", "weight"), [(0.0, 1.0), (0.5, 1.0), (0.05, 0.0)])
def test_a_kick_far_beyond_the_rest_of_the_move_does_not_pay_whatever_it_promises(
    sample_time: float, weight: float
) -> None:
    """kd over the sample time, some 26 and 260, beside the 14 by which a step moves the control without it."""
    assert calmest_weights(LOOP, HORIZON, sample_time).derivative == weight


def test_without_a_derivative_there_is_no_weight_of_it() -> None:
    assert calmest_weights(replace(LOOP, controller=Fopid(KP, KI)), HORIZON).derivative == 0.0


def test_one_that_does_not_overshoot_keeps_its_proportional_part() -> None:
    loop = replace(LOOP, controller=Fopid(2.0, 0.18), weights=SetpointWeights(0.8, 0.0))
    assert calmest_weights(loop, HORIZON) == loop.weights


@pytest.mark.parametrize("weight", [0.0, 0.5])
def test_it_never_gives_the_proportional_part_more(weight: float) -> None:
    assert calmest_weights(replace(LOOP, weights=SetpointWeights(weight)), HORIZON).proportional <= weight
