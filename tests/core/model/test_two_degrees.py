"""A loop with a filter of the measurement and weights of the setpoint, against python-control's state space."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest
from scipy.integrate import quad

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.gruenwald import gl1_response
from fopid_core.model.loop import Loop
from fopid_core.model.loop_peaks import LoopPeaks
from fopid_core.model.noise_power import noise_rms
from fopid_core.model.process import Process
from fopid_core.model.response import step_response
from fopid_core.model.stability import stability, stable_mask
from fopid_core.model.two_degrees import MeasurementFilter, SetpointWeights

PID = Fopid(2.0, 0.9, 1.1)
FILTERS = [MeasurementFilter(1, 0.3), MeasurementFilter(2, 0.4)]
NYQUIST = 300.0


def loop(slow: MeasurementFilter) -> Loop:
    return Loop(Process.parse("1/(s+1)^3"), PID, slow, SetpointWeights(0.4, 0.1))


def transfer(slow: MeasurementFilter) -> tuple[control.TransferFunction, ...]:
    """The process, the controller as the measurement and as the setpoint see it, and the filter."""
    s = control.tf("s")
    filtered = 1 / (1 + 0.3 * s) if slow.order == 1 else 1 / (1 + 0.4 * s + 0.08 * s**2)
    return 1 / (s + 1) ** 3, 2.0 + 0.9 / s + 1.1 * s, 0.8 + 0.9 / s + 0.11 * s, filtered


@pytest.mark.parametrize("slow", FILTERS, ids=["order 1", "order 2"])
@pytest.mark.parametrize("source", ["setpoint", "load"])
def test_responses_are_those_of_the_state_space(slow: MeasurementFilter, source: str) -> None:
    p, c, c_r, f = transfer(slow)
    around = 1 / (1 + p * c * f)
    exact = step_response(loop(slow), 20.0, source, points=201)  # type: ignore[arg-type]
    system = control.minreal((p * c_r if source == "setpoint" else p) * around, 1e-6, verbose=False)
    _, output = control.step_response(control.tf2ss(system), exact.time)
    assert exact.output == pytest.approx(output, abs=1e-7)


@pytest.mark.parametrize("slow", FILTERS, ids=["order 1", "order 2"])
def test_peaks_and_noise_are_those_of_a_dense_grid(slow: MeasurementFilter) -> None:
    p, c, _, f = transfer(slow)
    w = np.geomspace(1e-4, NYQUIST, 100_001)
    opened, forward = (p * f)(1j * w) * c(1j * w), c(1j * w) * f(1j * w)
    peaks = LoopPeaks(loop(slow))
    assert peaks.sensitivity().value == pytest.approx(np.abs(1 / (1 + opened)).max(), rel=1e-6)
    assert peaks.complementary().value == pytest.approx(np.abs(opened / (1 + opened)).max(), rel=1e-6)
    assert peaks.noise_gain((0.0, NYQUIST)).value == pytest.approx(np.abs(forward / (1 + opened)).max(), rel=1e-6)

    def power(w: float) -> float:
        s = 1j * max(w, 1e-12)
        return float(abs(c(s) * f(s) / (1 + p(s) * c(s) * f(s))) ** 2)

    exact = quad(power, 0.0, NYQUIST, limit=400, epsrel=1e-10, points=[0.1, 1.0, 10.0])[0]
    assert noise_rms(loop(slow), 0.02, NYQUIST) == pytest.approx(math.sqrt(0.02 / math.pi * exact), rel=1e-8)


@pytest.mark.parametrize("order", [1, 2])
def test_many_filtered_loops_at_once_are_judged_as_one_by_one(order: int) -> None:
    rng = np.random.default_rng(order)
    process = Process.parse("1/(s+1)^3*exp(-0.2s)")
    rows = np.column_stack([rng.uniform([0, 0, 0, 0.5, 0.5], [4, 3, 3, 1.5, 1.4], size=(60, 5))])
    times = rng.uniform(0.01, 1.0, size=60)
    one_by_one = [
        stability(Loop(process, Fopid(*row), MeasurementFilter(order, time))).stable
        for row, time in zip(rows.tolist(), times.tolist(), strict=True)
    ]
    assert stable_mask(process, rows, times, order).tolist() == one_by_one
    assert 10 < sum(one_by_one) < 50


def test_what_is_no_filter_or_weight_is_refused() -> None:
    for bad in (lambda: MeasurementFilter(3, 1.0), lambda: MeasurementFilter(1, -1.0), lambda: SetpointWeights(1.1)):
        with pytest.raises(InputError, match="allowed"):
            bad()
    with pytest.raises(InputError, match="neither filter nor weights"):
        gl1_response(loop(FILTERS[0]), 10.0, 0.01)
