"""Gains over a measured variable: gone through without a bump, as the sum over the whole past says."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.runtime import scheduler
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.schedule import GainSchedule, OperatingPoint, parse_schedule, read_schedule
from fopid_core.runtime.scheduler import GainScheduler
from fopid_core.runtime.settings import ControllerSettings

from .brute_force import BruteForce

H, COUNT = 0.02, 300
TIME = H * np.arange(COUNT)
ERRORS = np.exp(-0.3 * TIME) * np.cos(TIME) * (1 - np.exp(-5 * TIME))

INTEGER = (Fopid(1.0, 0.5, 0.1), Fopid(2.0, 1.5, 0.3), Fopid(0.5, 0.2, 0.0))
FRACTIONAL = (Fopid(1.0, 0.5, 0.2, 0.8, 0.6), Fopid(2.0, 0.9, 0.4, 1.1, 0.4), Fopid(0.8, 0.4, 0.1, 0.9, 0.9))


def table(gains: tuple[Fopid, ...], **more: float) -> GainSchedule:
    return GainSchedule(tuple(OperatingPoint(float(k), one) for k, one in enumerate(gains)), **more)


def run(schedule: GainSchedule, values: np.ndarray, errors: np.ndarray = ERRORS, **more: object) -> np.ndarray:
    controller = FopidController(ControllerSettings(schedule.points[0].gains, H, **more))
    scheduler = GainScheduler(schedule, controller)
    control = np.empty(len(errors))
    for k, error in enumerate(errors):
        scheduler.follow(float(values[k]))
        control[k] = controller.step(float(error), 0.0)
    return control


def interpolated(gains: tuple[Fopid, ...], value: float) -> Fopid:
    """By numpy's interpolation of each of the five numbers."""
    columns = np.array([one.gains for one in gains]).T
    return Fopid(*(float(np.interp(value, range(len(gains)), column)) for column in columns))


def remembered(gains: tuple[Fopid, ...], values: np.ndarray) -> np.ndarray:
    """By the sum over all errors: each tick moves the control as the gains of this tick would have moved it."""
    control, level = np.empty(COUNT), 0.0
    oracle = BruteForce(H, COUNT, "linear")
    for k in range(COUNT):
        oracle.use(interpolated(gains, values[k]))
        oracle.past[k] = ERRORS[k]
        now = float(oracle.weights[: k + 1] @ oracle.past[k::-1])
        before = float(oracle.weights[:k] @ oracle.past[k - 1 :: -1]) if k else 0.0
        level += now - before
        control[k] = level
    return control


SLOW = 1.0 + np.sin(0.7 * TIME)
FAST = 1.0 + np.sin(30.0 * TIME)
JUMPS = np.where(TIME % 1.0 < 0.5, 0.2, 1.9)


@pytest.mark.parametrize("gains", [INTEGER, FRACTIONAL], ids=["integer", "fractional"])
@pytest.mark.parametrize("values", [SLOW, FAST, JUMPS], ids=["slow", "fast", "jumps"])
def test_the_control_moves_as_that_of_the_interpolated_controller_that_forgets_nothing(
    gains: tuple[Fopid, ...], values: np.ndarray
) -> None:
    # The bank is within 0.04 dB = 0.5 % of each part; a jump of the variable weighs that error anew.
    expected = remembered(gains, values)
    off = np.abs(run(table(gains), values) - expected)
    assert off.max() < 0.01 * np.abs(expected).max()


@pytest.mark.parametrize("gains", [INTEGER, FRACTIONAL], ids=["integer", "fractional"])
def test_at_an_operating_point_it_is_the_controller_of_that_point_bit_for_bit(gains: tuple[Fopid, ...]) -> None:
    for k, one in enumerate(gains):
        plain = FopidController(ControllerSettings(one, H))
        scheduled = run(table(gains), np.full(COUNT, float(k)))
        expected = [plain.step(float(error), 0.0) for error in ERRORS]
        assert np.abs(scheduled - expected).max() < 1e-11  # rounding of differences over the sample time


@pytest.mark.parametrize("gains", [Fopid(2.0), Fopid(1.0, 0.5, 0.0, lam=0.0)], ids=["P", "integral of order 0"])
def test_without_an_integral_it_comes_back_from_a_hold_as_without_a_table(gains: Fopid) -> None:
    plain, read = (FopidController(ControllerSettings(gains, H)) for _ in range(2))
    scheduler = GainScheduler(table((gains, gains)), read)
    for controller in (plain, read):
        scheduler.follow(0.0)
        controller.step(1.0, 0.0)
        for _ in range(4):
            controller.hold(3.0)
    for _ in range(20):
        expected = plain.step(1.0, 0.0)
        scheduler.follow(0.0)
        found = read.step(1.0, 0.0)
    assert expected == pytest.approx(gains.kp + gains.ki)
    assert found == pytest.approx(expected)


@settings(max_examples=12, deadline=None, derandomize=True)
@given(
    gains=st.lists(
        st.builds(Fopid, kp=st.floats(-2, 5), ki=st.floats(0, 2), kd=st.floats(0, 1), lam=st.floats(0, 1.9),
                  mu=st.floats(0, 1.9)), min_size=2, max_size=3,
    ),
    jumps=st.lists(st.floats(-1, 3), min_size=2, max_size=6),
)  # fmt: skip
def test_however_the_variable_jumps_the_control_of_a_constant_error_does_not(
    gains: list[Fopid], jumps: list[float]
) -> None:
    # Of a constant error only the memory moves: by no more per tick than under the greatest of the gains.
    controller = FopidController(ControllerSettings(gains[0], H))
    scheduler = GainScheduler(table(tuple(gains)), controller)
    for _ in range(200):
        scheduler.follow(0.0)
        controller.step(1.0, 0.0)
    for value in jumps:
        before = controller.state.control
        scheduler.follow(value)
        parts = controller.state.proportional + controller.state.integral + controller.state.derivative
        faded = 0.0 if scheduler.gains.ki else 0.02 * abs(controller._bias) * 1.03
        assert abs(parts - before) <= faded + 1e-9 * (1.0 + abs(before) + abs(controller._bias))
        controller.step(1.0, 0.0)


def test_without_an_integral_what_a_change_leaves_behind_fades() -> None:
    # Proportional control: soon it is the gain of the instant times the error, whatever the variable did before.
    schedule = table((Fopid(1.0), Fopid(3.0)))
    values = np.where(TIME < 0.5, 0.0, 1.0)
    control = run(schedule, values, np.ones(COUNT))
    assert np.abs(np.diff(control)).max() < 0.05  # no step of 2
    assert control[-1] == pytest.approx(3.0, abs=0.02)


def test_a_filter_and_a_play_keep_a_noisy_variable_from_moving_the_gains() -> None:
    noise = 0.5 + 0.05 * np.random.default_rng(1).standard_normal(COUNT)

    def moved(**more: float) -> float:
        scheduler = GainScheduler(table(INTEGER, **more), FopidController(ControllerSettings(INTEGER[0], H)))
        path = []
        for value in noise:
            scheduler.follow(float(value))
            path.append(scheduler.value)
        return float(np.abs(np.diff(path)).sum())

    assert moved(hysteresis=0.25) == 0.0
    assert moved(filter_time=0.5) < 0.05 * moved()


def test_the_filter_is_a_first_order_lag_and_the_first_value_counts_at_once() -> None:
    scheduler = GainScheduler(table(INTEGER, filter_time=0.2), FopidController(ControllerSettings(INTEGER[0], H)))
    scheduler.follow(0.5)
    assert scheduler.value == 0.5
    for _ in range(10):
        scheduler.follow(1.5)
    assert scheduler.value == pytest.approx(1.5 - math.exp(-1.0), abs=1e-12)


def test_while_the_variable_is_not_known_the_gains_stay_and_beyond_the_table_they_are_those_of_its_ends() -> None:
    scheduler = GainScheduler(table(INTEGER), FopidController(ControllerSettings(INTEGER[0], H)))
    scheduler.follow(None)
    assert scheduler.gains == INTEGER[0]
    scheduler.follow(1.5)
    held = scheduler.gains
    for _ in range(10):
        scheduler.follow(None)
    assert scheduler.gains == held
    scheduler.follow(1e9)
    assert scheduler.gains == INTEGER[-1]
    scheduler.follow(-1e9)
    assert scheduler.gains == INTEGER[0]
    with pytest.raises(InputError, match="scheduling variable = nan; allowed: finite numbers"):
        scheduler.follow(math.nan)


@pytest.mark.parametrize("gains", [INTEGER, FRACTIONAL], ids=["integer", "fractional"])
def test_a_scheduled_controller_does_not_wind_up(gains: tuple[Fopid, ...]) -> None:
    # Half a minute at the limit while the variable moves; when the error turns, it leaves the limit at once.
    controller = FopidController(ControllerSettings(gains[0], H, control_min=-1.0, control_max=1.0))
    scheduler = GainScheduler(table(gains), controller)
    for k in range(1500):
        scheduler.follow(1.0 + math.sin(0.02 * k))
        controller.step(2.0, 0.0)
    for _ in range(5):
        controller.step(0.0, 0.1)
    assert controller.state.control < 0.9


def test_other_settings_change_under_a_schedule_without_a_bump() -> None:
    controller = FopidController(ControllerSettings(INTEGER[0], H))
    scheduler = GainScheduler(table(INTEGER), controller)
    for _ in range(300):
        scheduler.follow(0.7)
        controller.step(1.0, 0.2)
    before = controller.state.control
    scheduler.configure(ControllerSettings(Fopid(99.0), H, control_max=50.0, derivative_filter_time=0.1))
    scheduler.follow(0.7)
    assert abs(controller.step(1.0, 0.2) - before) < 0.02
    assert controller.settings.control_max == 50.0
    assert controller.settings.gains == scheduler.gains
    assert scheduler.gains.gains == pytest.approx(interpolated(INTEGER, 0.7).gains)


def test_weights_of_the_setpoint_change_under_a_schedule_without_working_it_out_anew(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """That held the ticks of a table of 30 points up for 2.4 s."""
    plain = ControllerSettings(INTEGER[0], H)
    weighted = replace(plain, setpoint_weight=0.3, derivative_setpoint_weight=0.5)
    changed, made = FopidController(plain), FopidController(weighted)
    schedulers = GainScheduler(table(INTEGER), changed), GainScheduler(table(INTEGER), made)
    monkeypatch.setattr(scheduler, "_knots", None)
    schedulers[0].configure(weighted)
    for setpoint in (0.0, 1.0, 1.0, 2.0):
        for one in schedulers:
            one.follow(0.7)
        assert changed.step(setpoint, 0.2) == made.step(setpoint, 0.2)
        assert changed.setpoint_feedthrough == made.setpoint_feedthrough


GOOD = """
variable: airspeed [m/s]
filter_time: 0.5
points:
  - {at: 10, kp: 2.0, ki: 1.0, K: 1.0}
  - {at: 20, kp: 1.2, lam: 0.9, K: 2.0}
"""


def test_a_file_is_a_table_of_gains_and_of_what_the_names_of_the_process_are(tmp_path: Path) -> None:
    file = tmp_path / "wing.yaml"
    file.write_text(GOOD)
    schedule, _ = read_schedule(file)
    assert (schedule.variable, schedule.filter_time, schedule.hysteresis) == ("airspeed [m/s]", 0.5, 0.0)
    assert [point.gains for point in schedule.points] == [Fopid(2.0, 1.0), Fopid(1.2, lam=0.9)]
    assert schedule.points[1].process == {"K": 2.0}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("nothing", "no list of points"),
        ({"points": [{"at": 1, "kp": 1}]}, "points: 1 of them; allowed: 2 to 100"),
        ({"points": [{"at": 2, "kp": 1}, {"at": 1, "kp": 1}]}, "at = 1 after 2; allowed: ascending"),
        ({"points": [{"at": 1}, {"at": 2, "kp": 1}]}, r"points\[0\]: no gain"),
        ({"points": [{"at": 1, "kp": "x"}, {"at": 2, "kp": 1}]}, r"points\[0\].kp = 'x'; allowed: a finite number"),
        ({"points": [{"at": math.nan, "kp": 1}, {"at": 2, "kp": 1}]}, r"points\[0\].at = nan"),
        ({"points": [{"at": 1, "kp": True}, {"at": 2, "kp": 1}]}, r"points\[0\].kp = True"),
        ({"points": [{"at": 1, "kp": 1, "lam": 3}, {"at": 2, "kp": 1}]}, r"points\[0\].lam = 3.0; allowed: 0 to 2"),
        ({"points": [{"at": 1, "kp": 1}, {"at": 2, "kp": 1}], "filtertime": 1}, "key 'filtertime'; allowed: variable"),
        ({"points": [{"at": 1, "kp": 1}, {"at": 2, "kp": 1}], "filter_time": -1}, "filter_time = -1.0; allowed: 0 to"),
        ({"points": 3}, "no list of points"),
        ({"points": [5, 6]}, r"points\[0\] = 5; allowed: a mapping"),
    ],
)
def test_what_is_no_table_is_refused_in_one_line(content: object, message: str) -> None:
    with pytest.raises(InputError, match=message) as refused:
        parse_schedule(content)
    assert "\n" not in str(refused.value)
