"""Where no controller has a flat phase, the nearest design keeps margin and crossover."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest

from fopid_core.design.specification import TuningRequest
from fopid_core.design.tuner import tune
from fopid_core.model.process import Process


@pytest.mark.parametrize(("degrees", "crossover"), [(80.0, 1.0), (80.0, 0.05), (85.0, 30.0)])
def test_two_integrators_have_the_margin_asked_for_and_integral_action(degrees: float, crossover: float) -> None:
    request = TuningRequest(Process.parse("1/s^2"), phase_margin=math.radians(degrees), crossover=crossover)
    result = tune(request)
    assert not result.success
    assert result.stable
    assert "nearest is PID with this margin and crossover" in result.unmet[0]
    kp, ki, kd, lam, mu = result.controller.gains
    assert (lam, mu) == (1.0, 1.0)
    assert ki > 0.0
    s = control.tf("s")
    loop = (kp + ki / s + kd * s) / s**2
    _, margin, _, _, at, _ = control.stability_margins(loop)
    assert margin == pytest.approx(degrees, abs=1e-3)
    assert at == pytest.approx(crossover, rel=1e-6)
    w = crossover * np.geomspace(1e-3, 1e3, 50_000)
    opened = loop(1j * w)
    assert np.abs(opened / (1.0 + opened)).max() == pytest.approx(2.0, abs=0.2), "as much integral as the loop bears"
