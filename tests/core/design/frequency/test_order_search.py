"""Every pair of orders has one controller that meets phase margin, crossover and flat phase exactly."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fopid_core.design.frequency.exact_gains import exact_gains, has_one_sign
from fopid_core.design.frequency.order_search import OrderSearch, frequency_grid
from fopid_core.design.specification import Bound, FrequencySpecification
from fopid_core.errors import InputError
from fopid_core.model.process import Process, read_process

PROCESSES = ["P1", "P2", "P4", "1/(s+1)*exp(-2s)", "(1-s)/(s+1)^3", "1/(0.8s^2.2+0.5s^0.9+1)", "-2/s*exp(-0.3s)"]


def loop_at(process: Process, gains: np.ndarray, w: float) -> complex:
    """L(jw), written out."""
    kp, ki, kd, lam, mu = (float(number) for number in gains)
    s = 1j * w
    return complex(process(s)) * (kp + ki * s ** (-lam) + kd * s**mu)


@settings(derandomize=True, deadline=None, max_examples=60)
@given(
    text=st.sampled_from(PROCESSES),
    phase_margin=st.floats(0.2, 2.8),
    crossover=st.floats(0.05, 5.0),
    lam=st.floats(0.1, 1.9),
    mu=st.floats(0.1, 1.9),
)
def test_margin_crossover_and_flat_phase_are_met_to_rounding(
    text: str, phase_margin: float, crossover: float, lam: float, mu: float
) -> None:
    process = read_process(text)
    gains = exact_gains(process, phase_margin, crossover, [lam], [mu])[0]
    wished = cmath.exp(1j * (phase_margin - math.pi))
    # The parts of a controller may cancel to many digits: that many are lost.
    parts = [abs(gains[0]), abs(gains[1]) * crossover ** (-lam), abs(gains[2]) * crossover**mu]
    cancelled = max(parts) * abs(complex(process(1j * crossover)))
    assert abs(loop_at(process, gains, crossover) - wished) < 1e-11 * max(cancelled, 1.0)
    # What cancels makes the phase turn as often faster: the step is shorter, and rounding costs that many digits again.
    step = 1e-5 * crossover / max(cancelled, 1.0)
    turn = cmath.phase(loop_at(process, gains, crossover + step) / loop_at(process, gains, crossover - step))
    assert abs(turn / (2.0 * step) * crossover) < 1e-6 * max(cancelled, 1.0) + 1e-10 * cancelled**2


def test_orders_that_contradict_the_equations_give_no_finite_gains() -> None:
    """A derivative of order zero is a second proportional part: there are two unknowns for three equations."""
    gains = exact_gains(Process.parse("1/s"), 1.0, 1.0, [1.0, 1.0], [0.0, 0.7])
    assert not np.all(np.isfinite(gains[0]))
    assert np.all(np.isfinite(gains[1]))


def test_a_process_without_crossover_at_the_wished_frequency_is_refused() -> None:
    with pytest.raises(InputError, match=r"crossover 1 rad/s = 0"):
        exact_gains(Process.parse("(s^2+1)/(s+1)^4"), 1.0, 1.0, [1.0], [1.0])


@pytest.mark.parametrize(
    ("gains", "expected"),
    [
        ((1.0, 1.0, 0.0), True),
        ((-1.0, -2.0, 0.0), True),
        ((1.0, 0.0, 1.0), False),  # no integral: a steady-state error
        ((1.0, 1.0, -0.1), False),
        ((0.0, 3.0, 0.0), True),
    ],
)
def test_parts_that_pull_against_each_other_are_sorted_out(gains: tuple[float, ...], expected: bool) -> None:
    assert bool(has_one_sign(np.array([[*gains, 1.0, 1.0]]))[0]) is expected


@pytest.mark.slow
def test_measures_are_those_of_the_loop_written_out() -> None:
    process = read_process("P1")
    specification = FrequencySpecification(1.2, 0.5, Bound(-20.0, 5.0), Bound(-20.0, 0.02), "flatness")
    search = OrderSearch(process, specification, frequency_grid(specification, 400))
    gains = exact_gains(process, 1.2, 0.5, [1.1], [0.9])
    measured = search.measure(gains)
    w = np.geomspace(1e-5, 1e4, 40001)
    loop = np.array([loop_at(process, gains[0], x) for x in w])
    s_gain, t_gain = 1.0 / np.abs(1.0 + loop), np.abs(loop / (1.0 + loop))
    assert measured.ms[0] == pytest.approx(s_gain.max(), rel=1e-4)
    assert measured.mt[0] == pytest.approx(max(t_gain.max(), 1.0), rel=1e-4)
    assert measured.t_db[0] == pytest.approx(20.0 * math.log10(t_gain[w >= 5.0].max()), abs=0.01)
    assert measured.s_db[0] == pytest.approx(20.0 * math.log10(s_gain[w <= 0.02].max()), abs=0.01)
    off = np.abs(np.angle(loop * cmath.exp(1j * (math.pi - 1.2)))) > math.radians(5.0)
    left, right = w[off & (w < 0.5)].max(), w[off & (w > 0.5)].min()
    assert measured.flatness[0] == pytest.approx(math.log10(right / left), abs=0.01)
