"""Weights of the setpoint that overshoot less at hardly more error, beside python-control's responses."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import control
import numpy as np
import pytest
from scipy.integrate import trapezoid

from fopid_core.design.setpoint_weights import HARDLY_MORE, calmest_weights
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process
from fopid_core.model.two_degrees import SetpointWeights

KP, KI, HORIZON = 20.0, 6.0, 60.0
LOOP = Loop(Process.parse("1/((10s+1)(s+1))"), Fopid(KP, KI, 10.0))


@cache
def seen(weight: float) -> tuple[float, float]:
    """Integral of the absolute error after a step of the setpoint, and the overshoot [%]."""
    s = control.tf("s")
    process, controller = 1 / ((10 * s + 1) * (s + 1)), KP + KI / s + 10 * s
    answer = control.minreal(process * (weight * KP + KI / s + 10 * s) / (1 + process * controller), verbose=False)
    time = np.linspace(0.0, HORIZON, 6_001)
    output = control.step_response(answer, time).outputs
    return float(trapezoid(np.abs(1.0 - output), time)), 100.0 * max(float(output.max()) - 1.0, 0.0)


def test_it_overshoots_less_at_hardly_more_error() -> None:
    chosen = calmest_weights(LOOP, HORIZON)
    least = min(seen(weight)[0] for weight in np.linspace(0.0, 1.0, 11))
    error, overshoot = seen(chosen.proportional)
    assert error <= HARDLY_MORE * least * 1.001
    assert overshoot < 0.5 * seen(1.0)[1]
    assert chosen.derivative == 1.0


def test_no_other_of_as_little_error_overshoots_less() -> None:
    chosen = calmest_weights(LOOP, HORIZON).proportional
    found = [seen(weight) for weight in np.linspace(0.0, 1.0, 11)]
    least = min(error for error, _ in found)
    calmest = min(overshoot for error, overshoot in found if error <= HARDLY_MORE * least)
    assert seen(chosen)[1] <= max(calmest, 2.0) + 0.01


def test_one_that_does_not_overshoot_stays_as_it_is() -> None:
    weights = SetpointWeights(0.8, 0.3)
    loop = replace(LOOP, controller=Fopid(2.0, 0.18), weights=weights)
    assert calmest_weights(loop, HORIZON) == weights


@pytest.mark.parametrize("weight", [0.0, 0.5])
def test_it_never_gives_the_proportional_part_more(weight: float) -> None:
    assert calmest_weights(replace(LOOP, weights=SetpointWeights(weight)), HORIZON).proportional <= weight
