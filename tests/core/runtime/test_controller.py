"""The running controller: exact where it can be, bumpless between its modes, and light to import."""

from __future__ import annotations

import math
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fopid_core.data import paper_tables
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import read_process
from fopid_core.model.response import step_response
from fopid_core.runtime.controller import ControllerSettings, FopidController
from fopid_core.runtime.filter_bank import Band
from fopid_core.runtime.plant import Plant, PlantSettings
from fopid_core.runtime.simulation import simulate

ROW = next(row for row in paper_tables()["table4_to_7"] if (row["process"], row["index"]) == ("P1", "ITAE"))
ITAE = Fopid(*(ROW[name] for name in ("kp", "ki", "kd", "lam", "mu")))
TABLE_3 = Fopid(0.9116, 0.2526, 0.2023, 1.1577, 0.9973)


def run(gains: Fopid, sample_time: float, horizon: float = 30.0, **controller: object):
    plant = Plant(PlantSettings(read_process("P1"), sample_time=sample_time))
    settings_ = ControllerSettings(gains, sample_time=sample_time, **controller)
    return simulate(FopidController(settings_), plant, round(horizon / sample_time), lambda _: 1.0)


def distance_from_exact(sample_time: float, horizon: float = 0.0) -> float:
    trace = run(ITAE, sample_time, band=Band.for_sample_time(sample_time, horizon))
    exact = step_response(Loop(read_process("P1"), ITAE), 30.0)
    return float(np.abs(np.interp(trace.time, exact.time, exact.output) - trace.measurement).max())


@pytest.mark.parametrize("horizon", [0.0, 30.0])
def test_closed_loop_is_near_the_exact_continuous_response(horizon: float) -> None:
    assert distance_from_exact(0.01, horizon) < 5e-3


def test_that_distance_shrinks_with_the_sample_time() -> None:
    distances = [distance_from_exact(h) for h in (0.02, 0.01, 0.005)]
    assert distances[0] / distances[1] == pytest.approx(2.0, rel=0.1)
    assert distances[1] / distances[2] == pytest.approx(2.0, rel=0.1)


def test_integer_orders_are_the_classical_pid() -> None:
    # Trapezoidal integral, exact; derivative of a sine well below a tenth of the Nyquist frequency, to 1 %.
    h, w, pid = 0.05, 2.0, Fopid(2.0, 0.7, 0.4)
    controller = FopidController(ControllerSettings(pid, sample_time=h))
    area = last = 0.0
    for k in range(500):
        error = math.sin(w * k * h)
        controller.step(error, 0.0)
        area += 0.5 * h * (last + error)
        assert controller.state.proportional + controller.state.integral == pytest.approx(
            pid.kp * error + pid.ki * area
        )
        if k > 20:
            assert controller.state.derivative == pytest.approx(pid.kd * w * math.cos(w * k * h), abs=0.01 * pid.kd * w)
        last = error


def test_weights_filter_and_feedforward_are_those_of_the_two_degree_of_freedom_pid() -> None:
    # u = kp (b r - y) + ki int (r - y) + kd (v - x)/T + uf, where x' = (v - x)/T, v = c r - y, all from the first
    # measurement on. The derivative is right to 1 % of its size but for the ticks after a jump.
    h, b, c, filter_time, first = 0.05, 0.4, 0.3, 0.2, 2.0
    pid = Fopid(2.0, 0.7, 0.4)
    controller = FopidController(
        ControllerSettings(pid, h, setpoint_weight=b, derivative_setpoint_weight=c, derivative_filter_time=filter_time)
    )
    area = last_error = last = filtered = 0.0
    decay = math.exp(-h / filter_time)
    for k in range(200):
        setpoint, measured, fed = 3.0 + (k > 50), first + math.sin(0.1 * k), 0.01 * k
        r, y = setpoint - first, measured - first
        area += 0.5 * h * (last_error + r - y)
        new = c * r - y
        slope = (new - last) / h  # the lag of a line: x' = (v - x)/T
        filtered = new - slope * filter_time + (filtered - last + slope * filter_time) * decay
        control, state = controller.step(setpoint, measured, feedforward=fed), controller.state
        assert control == pytest.approx(state.proportional + state.integral + state.derivative + fed)
        assert state.proportional + state.integral == pytest.approx(pid.kp * (b * r - y) + pid.ki * area, rel=1e-9)
        if k > 60 or 10 < k <= 50:
            assert state.derivative == pytest.approx(
                pid.kd * (new - filtered) / filter_time, abs=0.01 * pid.kd / h * 0.1
            )
        last_error, last = r - y, new


def test_a_deadband_takes_its_size_off_the_error() -> None:
    banded, plain = (
        FopidController(ControllerSettings(Fopid(2.0), deadband=0.1)),
        FopidController(ControllerSettings(Fopid(2.0))),
    )
    for error in (0.05, -0.1, 0.1, 0.3, -0.7):
        beyond = math.copysign(max(abs(error) - 0.1, 0.0), error)
        assert banded.step(error, 0.0) == pytest.approx(plain.step(beyond, 0.0))
        assert banded.state.error == pytest.approx(beyond)


def test_within_the_deadband_the_integral_rests() -> None:
    controller = FopidController(ControllerSettings(Fopid(1.0, 0.5), deadband=0.1))
    for _ in range(100):
        controller.step(1.0, 0.0)
    resting = [controller.step(1.0, 0.93) for _ in range(500)]
    assert np.ptp(resting[1:]) == 0.0


def test_the_setpoint_moves_no_faster_than_its_rate_and_starts_at_the_measurement() -> None:
    controller = FopidController(ControllerSettings(Fopid(1.0), 0.1, setpoint_rate_max=2.0))
    taken = [(controller.step(5.0, 1.0), controller.state.setpoint)[1] for _ in range(25)]
    assert taken[0] == pytest.approx(1.2)
    assert np.diff([1.0, *taken]).max() == pytest.approx(0.2)
    assert taken[-1] == 5.0


def test_rate_limit_bounds_every_step_from_the_first() -> None:
    trace = run(ITAE, 0.01, horizon=5.0, control_rate_max=2.0)
    assert np.abs(np.diff(trace.control, prepend=0.0)).max() <= 0.02 + 1e-12


def test_negative_gains_control_a_process_that_acts_the_other_way() -> None:
    plant = Plant(PlantSettings(read_process("-1/(s+1)^3"), sample_time=0.01))
    reverse = FopidController(
        ControllerSettings(Fopid(-ITAE.kp, -ITAE.ki, -ITAE.kd, ITAE.lam, ITAE.mu), control_max=0.5)
    )
    trace = simulate(reverse, plant, 3000, lambda _: 1.0)
    direct = run(ITAE, 0.01, control_min=-0.5)
    np.testing.assert_allclose(trace.control, -direct.control, atol=1e-12)


def test_manual_to_automatic_is_bumpless_both_ways() -> None:
    controller = FopidController(ControllerSettings(ITAE))
    for _ in range(50):
        automatic = controller.step(1.0, 0.2)
    controller.set_mode("manual")
    assert controller.step(1.0, 0.2, manual=automatic) == automatic
    for _ in range(50):
        assert controller.step(1.0, 0.2, manual=0.7) == 0.7
    controller.set_mode("auto")
    assert controller.step(1.0, 0.2) == pytest.approx(0.7, abs=0.005)


def test_manual_obeys_the_limits_and_does_not_wind_up() -> None:
    controller = FopidController(ControllerSettings(Fopid(1.0, 1.0), control_max=2.0))
    controller.set_mode("manual")
    for _ in range(5000):
        assert controller.step(1.0, 0.0, manual=9.0) == 2.0
    controller.set_mode("auto")
    # The error falls by 1, of which kp = 1 makes a control of 1; what was asked for by hand is not taken in.
    assert controller.step(0.0, 0.0) == pytest.approx(1.0)


any_gains = st.builds(
    Fopid, kp=st.floats(-5, 5), ki=st.floats(-2, 2), kd=st.floats(-1, 1), lam=st.floats(0.5, 2), mu=st.floats(0, 2)
)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    gains=any_gains, missing=st.integers(1, 50), policy=st.sampled_from([None, -0.4, 0.0]),
    signals=st.tuples(st.floats(-10, 10), st.floats(-10, 10), st.floats(-2, 2)),
    filter_time=st.sampled_from([0.0, 0.3]),
)  # fmt: skip
def test_a_hold_keeps_the_control_and_the_next_step_goes_on_from_it(
    gains: Fopid, missing: int, policy: float | None, signals: tuple, filter_time: float
) -> None:
    setpoint, measured, fed = signals
    assume(gains.ki != 0.0)  # without an integral the control goes back, see below
    controller = FopidController(ControllerSettings(gains, derivative_filter_time=filter_time))
    for k in range(40):
        last = controller.step(1.0, 0.01 * k, feedforward=0.2)
    for _ in range(missing):
        held = controller.hold(policy)
        assert held == (last if policy is None else policy)
        state = controller.state
        parts = state.proportional + state.integral + state.derivative + state.feedforward
        assert parts == pytest.approx(held, abs=1e-9)
    # What the integral gathers in a tick, of an error of up to 20, is all that moves the control.
    gathered = abs(gains.ki) * 21.0 * 0.01**gains.lam / math.gamma(1.0 + gains.lam) + 1e-6
    trend = abs(controller.state.integral) + 1.0
    assert abs(controller.step(setpoint, measured, feedforward=fed) - held) < gathered + 0.02 * abs(gains.ki) * trend


NOT_INTEGRATING = (Fopid(2.0), Fopid(2.0, 0.0, 0.3), Fopid(1.5, 0.5, 0.1, lam=0.0))


@pytest.mark.parametrize("gains", NOT_INTEGRATING, ids=str)
@pytest.mark.parametrize("held", [1, 2, 7, 200])
def test_without_an_integral_the_control_is_that_of_its_law_again_as_long_after_a_hold_as_that_lasted(
    gains: Fopid, held: int
) -> None:
    """Beside a controller that was never held, while both signals stand still: what is left is the way back."""
    holding, unheld = (FopidController(ControllerSettings(gains)) for _ in range(2))
    for _ in range(1000):  # until the derivative has settled
        unheld.step(1.0, 0.3)
        before = holding.step(2.0, 0.3)
    goal = (gains.kp + (gains.ki if gains.lam == 0.0 else 0.0)) * 0.7
    assert unheld.state.control == pytest.approx(goal)
    for _ in range(held):
        assert holding.hold() == before
    back = [holding.step(1.0, 0.3) for _ in range(held + 50)]
    way = [goal + (before - goal) * max(1.0 - (k + 1) / held, 0.0) for k in range(held + 50)]
    first = 0 if gains.lam else held  # an integral of order 0 is not kept from jumping, only from staying away
    assert back[first:] == pytest.approx(way[first:])


def test_without_an_integral_and_with_every_other_sample_missing_the_control_still_follows() -> None:
    controller = FopidController(ControllerSettings(Fopid(2.0)))
    for k in range(100):
        assert controller.step(math.sin(0.1 * k), 0.1) == pytest.approx(2.0 * (math.sin(0.1 * k) - 0.1), abs=1e-12)
        controller.hold()


def test_after_a_hold_the_loop_settles_again_even_when_every_other_sample_is_missing() -> None:
    controller, plant = (
        FopidController(ControllerSettings(ITAE, 0.02)),
        Plant(PlantSettings(read_process("P1"), sample_time=0.02)),
    )
    for k in range(4000):
        missing = 500 <= k < 1000 or (k >= 2000 and k % 2)
        control = controller.hold() if missing else controller.step(1.0, plant.measurement)
        plant.step(control, 0.2 if k > 600 else 0.0)
        if k == 1999:
            assert plant.measurement == pytest.approx(1.0, abs=0.01)
    assert plant.measurement == pytest.approx(1.0, abs=0.01)


def test_a_hold_obeys_limits_and_rate() -> None:
    controller = FopidController(ControllerSettings(Fopid(1.0), 0.1, control_max=2.0, control_rate_max=5.0))
    controller.step(0.0, 0.0)
    assert [controller.hold(9.0) for _ in range(6)] == pytest.approx([0.5, 1.0, 1.5, 2.0, 2.0, 2.0])
    assert controller.state.saturated
    assert controller.state.control_unlimited == 9.0


def test_reset_is_as_new_but_for_the_mode() -> None:
    used, new = (FopidController(ControllerSettings(TABLE_3)) for _ in range(2))
    for k in range(100):
        used.step(1.0, 0.01 * k)
    used.hold(0.3)
    used.set_mode("manual")
    used.reset()
    assert used.state.mode == "manual"
    used.set_mode("auto")
    assert [used.step(1.0, 0.1 * k) for k in range(50)] == [new.step(1.0, 0.1 * k) for k in range(50)]


@pytest.mark.parametrize("fed", [1e9, -1e9, 50.0])
def test_a_feedforward_far_beyond_the_limits_drives_the_integral_away_by_their_range_only(fed: float) -> None:
    controller = FopidController(ControllerSettings(Fopid(0.5, 0.6), 0.05, control_min=0.0, control_max=10.0))
    for _ in range(4000):  # at rest at 3
        controller.step(3.0, controller.state.control + 1.2 * (3.0 - controller.state.control))
    before = controller.state.integral
    for _ in range(20):
        controller.step(3.0, 3.0, feedforward=fed)
    assert abs(controller.state.feedforward) <= 10.0
    assert abs(controller.state.integral - before) <= 10.0 + 3.0


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e101])
@pytest.mark.parametrize("name", ["setpoint", "measurement", "feedforward", "manual", "tracking"])
def test_a_signal_that_is_not_finite_is_refused_and_changes_nothing(name: str, bad: float) -> None:
    controller, twin = (FopidController(ControllerSettings(ITAE)) for _ in range(2))
    for k in range(5):
        with pytest.raises(InputError, match=re.escape(f"{name} = {bad}")):
            controller.step(**{"setpoint": 1.0, "measurement": 0.0, name: bad})
        with pytest.raises(InputError, match="control = "):
            controller.hold(bad)
        assert controller.step(1.0, 0.01 * k) == twin.step(1.0, 0.01 * k)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.lists(st.floats(-1e100, 1e100), min_size=1, max_size=30), st.floats(0, 2), st.floats(0, 2))
def test_no_signal_that_is_taken_makes_a_control_that_is_not_finite(signals: list, lam: float, mu: float) -> None:
    controller = FopidController(ControllerSettings(Fopid(1e100, 1e100, 1e100, lam, mu), 1e-3))
    for signal in signals:
        assert math.isfinite(controller.step(signal, -signal))


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"sample_time": 0.0}, "sample_time = 0.0"),
        ({"sample_time": math.nan}, "sample_time = nan"),
        ({"control_min": 1.0, "control_max": 0.0}, "control_min = 1.0"),
        ({"control_rate_max": 0.0}, "control_rate_max = 0.0"),
        ({"setpoint_rate_max": -1.0}, "setpoint_rate_max = -1.0"),
        ({"deadband": -0.1}, "deadband = -0.1"),
        ({"horizon": -1.0}, "horizon = -1.0"),
        ({"setpoint_weight": 1.5}, "setpoint_weight = 1.5"),
        ({"antiwindup": "hope"}, "'hope'"),
        ({"control_min": 1.0}, "safe_control = 0.0"),
    ],
)
def test_bad_settings_are_named(changes: dict, named: str) -> None:
    with pytest.raises(InputError, match=named):
        replace(ControllerSettings(ITAE), **changes)


def test_the_controllers_path_loads_neither_scipy_nor_control_nor_the_parser() -> None:
    code = "import sys, fopid_core.runtime.controller; print({'scipy', 'control', 'lark'} & set(sys.modules))"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert told.stdout.strip() == "set()"
