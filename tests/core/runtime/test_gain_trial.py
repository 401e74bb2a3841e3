"""Gains on trial that are taken back: the loop goes on as if they had never been, but for what the plant has done."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fopid_core.model.fopid import Fopid
from fopid_core.model.process import read_process
from fopid_core.runtime.controller import ControllerSettings, FopidController
from fopid_core.runtime.controller_bank import ControllerBank
from fopid_core.runtime.plant import Plant, PlantSettings
from fopid_core.runtime.simulation import simulate

H = 0.01
WEAK, WILD, WILDER = Fopid(0.1, 0.05), Fopid(2.0, 30.0), Fopid(3.0, 60.0)


def at_work(ticks: int = 300, **given: object) -> FopidController:
    """A controller whose integral holds something."""
    controller = FopidController(ControllerSettings(WEAK, sample_time=H, **given))  # type: ignore[arg-type]
    for _ in range(ticks):
        controller.step(1.0, 0.0)
    return controller


def change(controller: FopidController, gains: Fopid, *, on_trial: bool = False) -> None:
    controller.reconfigure(replace(controller.settings, gains=gains, on_trial=on_trial))


def push_away(controller: FopidController, ticks: int = 100, measurement: float = 0.5) -> None:
    for _ in range(ticks):
        controller.step(1.0, measurement)


def without_error(controller: FopidController) -> float:
    """The control, once measurement and setpoint are the same."""
    controller.step(1.0, 1.0)
    return controller.step(1.0, 1.0)


orders, gains = st.floats(0.3, 1.7), st.floats(-5.0, 5.0)
controllers = st.builds(Fopid, gains, gains, gains, orders, st.floats(0.3, 1.0))


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    controllers, controllers, st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=15), st.floats(0.0, 1.0),
    st.floats(-2.0, 2.0),
)  # fmt: skip
def test_the_control_without_an_error_is_what_it_was_whatever_the_trial_did(
    before: Fopid, tried: Fopid, measured: list[float], weight: float, moved: float
) -> None:
    """Beside a twin that is given the same gains without a bump; the setpoint's weight moves the integral with it."""
    assume(tried != before)
    controls, levels = [], []
    for confirmed in (False, True):
        controller = FopidController(ControllerSettings(before, sample_time=H, setpoint_weight=weight))

        def level(one: FopidController = controller) -> float:
            return one.state.integral - before.kp * (1.0 - weight) * one.state.setpoint

        for k in range(20):
            controller.step(1.0, 0.1 * k)
        began = level()
        change(controller, tried, on_trial=True)
        for value in measured:
            controller.step(1.0 + moved, value)
        if confirmed:
            change(controller, tried)
        change(controller, before)
        levels.append(level() - began)
        controls.append(controller.step(1.0 + moved, 0.3))
    assert controls[1] - controls[0] == pytest.approx(levels[1], rel=1e-7, abs=1e-7)


def test_the_control_is_that_of_a_pi_whose_integral_stood_still_meanwhile() -> None:
    controller = at_work()
    level = controller.state.integral
    change(controller, WILD, on_trial=True)
    push_away(controller)
    assert controller.state.control > 10.0
    change(controller, WEAK)
    assert controller.step(1.0, 0.4) == pytest.approx(level + 0.1 * 0.6 + 0.05 * H * 0.5 * (0.5 + 0.6), rel=1e-12)


def test_gains_that_were_confirmed_are_no_trial_that_can_be_taken_back() -> None:
    controller = at_work()
    change(controller, WILD, on_trial=True)
    change(controller, WILD)
    push_away(controller)
    stood = controller.state.control
    change(controller, WEAK)
    assert controller.step(1.0, 0.5) == pytest.approx(stood, rel=1e-3), "somebody's choice: without a bump"


def test_others_than_those_before_are_taken_without_a_bump() -> None:
    controller = at_work()
    change(controller, WILD, on_trial=True)
    push_away(controller)
    stood = controller.state.control
    change(controller, Fopid(0.2, 0.05))
    assert controller.step(1.0, 0.5) == pytest.approx(stood, rel=1e-3)


def test_trials_within_trials_go_back_one_by_one_or_all_at_once() -> None:
    for at_once in (False, True):
        controller = at_work()
        first = controller.state.integral
        change(controller, WILD, on_trial=True)
        push_away(controller)
        second = controller.state.integral
        change(controller, WILDER, on_trial=True)
        push_away(controller)
        if not at_once:
            change(controller, WILD, on_trial=True)
            assert without_error(controller) == pytest.approx(second, abs=0.1)
        change(controller, WEAK)
        assert without_error(controller) == pytest.approx(first, abs=0.01)


def test_trials_without_end_are_not_all_remembered() -> None:
    controller = at_work()
    for k in range(1000):
        change(controller, Fopid(0.2, 0.1 + 0.01 * k), on_trial=True)
    stood = controller.state.control
    change(controller, WEAK)
    assert controller.step(1.0, 0.0) == pytest.approx(stood, rel=1e-2), "too long ago"


def test_a_renewed_trial_is_the_same_one_and_a_filter_is_part_of_it() -> None:
    controller = at_work()
    level = controller.state.integral
    filtered = {"measurement_filter_order": 1, "measurement_filter_time": 0.1}
    controller.reconfigure(replace(controller.settings, on_trial=True, **filtered))
    push_away(controller)
    controller.reconfigure(replace(controller.settings, on_trial=True))
    push_away(controller)
    back = {"measurement_filter_order": 0, "measurement_filter_time": 0.0}
    controller.reconfigure(replace(controller.settings, on_trial=False, **back))
    assert without_error(controller) == pytest.approx(level, abs=1e-3)


def test_who_goes_to_manual_meanwhile_is_the_one_who_says_where_the_control_is() -> None:
    controller = at_work()
    change(controller, WILD, on_trial=True)
    controller.set_mode("manual")
    controller.step(1.0, 0.5, manual=7.0)
    controller.set_mode("auto")
    change(controller, WEAK)
    assert controller.step(1.0, 0.5) == pytest.approx(7.0, abs=0.01)


def test_while_the_measurement_is_lost_the_control_stays_where_it_is_held_and_then_it_comes_back() -> None:
    """A sample that was lost in the middle of a swing kept its control for good."""
    controller = at_work()
    level = controller.state.integral
    change(controller, WILD, on_trial=True)
    push_away(controller)
    held = controller.hold()
    change(controller, WEAK)
    assert controller.hold() == held > 10.0
    controller.step(1.0, 1.0)
    assert without_error(controller) == pytest.approx(level, abs=0.1)


def test_a_trial_that_was_begun_by_hand_has_nothing_to_go_back_to() -> None:
    controller = at_work()
    controller.set_mode("manual")
    controller.step(1.0, 1.0, manual=7.0)
    change(controller, WILD, on_trial=True)
    controller.set_mode("auto")
    controller.step(1.0, 1.0)
    change(controller, WEAK)
    assert without_error(controller) == pytest.approx(7.0)


def test_a_controller_without_an_integral_keeps_nothing_of_a_hold() -> None:
    controller = FopidController(ControllerSettings(Fopid(1.0), sample_time=H))
    controller.step(0.0, 0.0)
    for _ in range(20):
        controller.hold(5.0)
    controller.step(0.0, 0.0)
    change(controller, Fopid(2.0), on_trial=True)
    for _ in range(50):
        controller.step(0.0, 0.0)
    change(controller, Fopid(1.0))
    assert controller.step(0.0, 0.0) == pytest.approx(0.0)


@pytest.mark.parametrize("tracking_time", [0.0, 0.02, 0.5])
def test_what_was_limited_on_trial_is_no_excess_of_the_gains_from_before(tracking_time: float) -> None:
    controller = at_work(control_min=-5.0, control_max=5.0, tracking_time=tracking_time)
    level = controller.state.integral
    change(controller, Fopid(50.0, 80.0), on_trial=True)
    push_away(controller, measurement=0.0)
    change(controller, WEAK)
    assert without_error(controller) == pytest.approx(level, abs=1e-3)


@pytest.mark.parametrize(("load", "setpoint"), [(-1.5, 1.0), (0.0, 3.0)])
def test_a_trial_that_has_found_rest_elsewhere_is_where_the_plant_is_held_now(load: float, setpoint: float) -> None:
    """The level from before was right for another load: weak gains took half a minute to find it again."""
    plant = Plant(PlantSettings(read_process("1/(s+1)*exp(-0.1s)"), sample_time=H))
    controller = FopidController(ControllerSettings(WEAK, sample_time=H))
    simulate(controller, plant, 20_000, lambda _: 1.0)
    change(controller, Fopid(2.0, 2.0), on_trial=True)
    simulate(controller, plant, 2000, lambda k: setpoint if k > 500 else 1.0, lambda k: load if k > 500 else 0.0)
    change(controller, WEAK)
    after = simulate(controller, plant, 2000, lambda _: setpoint, lambda _: load)
    assert abs(after.measurement - setpoint).max() < 0.02


def test_a_lively_loop_behind_a_slow_actuator_is_not_driven_to_swing_by_the_way_back() -> None:
    """Anti-windup that stood back until the control was free of its rate stood back for ever: it swung by 14."""
    process = read_process("1/s*exp(-0.03s)")
    plant = Plant(PlantSettings(process, sample_time=H, noise_std=0.003, seed=1))
    lively = ControllerSettings(Fopid(11.115, 31.233), sample_time=H, control_min=-10.0, control_max=10.0,
                                control_rate_max=0.58)  # fmt: skip
    controller = FopidController(lively)
    simulate(controller, plant, 2500, lambda _: 0.2, lambda k: -0.3 if k > 100 else 0.0)
    change(controller, Fopid(45.823, 394.79), on_trial=True)
    trial = simulate(controller, plant, 116, lambda _: 0.25, lambda _: -0.3)
    change(controller, lively.gains)
    after = simulate(controller, plant, 3000, lambda _: 0.25, lambda _: -0.3)
    assert abs(after.measurement - 0.25).max() < 2.0 * abs(trial.measurement - 0.25).max()
    assert after.measurement[-500:] == pytest.approx(0.25, abs=0.02), "in noise of 0.003"


def test_without_bumpless_changes_it_is_a_controller_that_never_knew_the_trial() -> None:
    controller, other = at_work(bumpless=False), at_work(bumpless=False)
    change(controller, WILD, on_trial=True)
    push_away(controller)
    push_away(other)
    change(controller, WEAK)
    assert controller.step(1.0, 0.4) == pytest.approx(other.step(1.0, 0.4), rel=1e-12)


@pytest.mark.parametrize("antiwindup", ["none", "back_calculation", "conditional_integration"])
@pytest.mark.parametrize("gains", [WEAK, Fopid(0.1, 0.05, 0.02, 0.9, 0.6)])
@pytest.mark.parametrize("variable_step", [False, True])
def test_an_actuators_rate_delays_the_return_and_does_not_end_it(
    antiwindup: str, gains: Fopid, variable_step: bool
) -> None:
    """Anti-windup would take the control that is on its way for all that the actuator can do."""
    rate = {"antiwindup": antiwindup, "control_rate_max": 20.0, "variable_step": variable_step}
    controller = at_work(**rate)
    change(controller, gains)
    push_away(controller, 50, 1.0)
    level = controller.state.integral
    change(controller, WILD, on_trial=True)
    for k in range(100):
        controller.step(1.0, 0.5 if k < 80 else 1.0)
    away = controller.state.control
    change(controller, gains)
    seen = []
    for _ in range(200):
        if variable_step:
            controller.set_interval(H)
        seen.append(controller.step(1.0, 1.0))
    assert away - seen[0] == pytest.approx(20.0 * H, rel=0.02), "as fast as it may"
    needed = math.ceil((away - level) / (20.0 * H)) + 1
    assert needed < 150
    assert seen[needed] == pytest.approx(level, abs=0.02)
    assert seen[-1] == pytest.approx(level, abs=0.02)


def test_limits_of_the_control_hold_and_wind_it_up_no_more_than_one_that_never_knew_the_trial() -> None:
    controller, other = (at_work(control_min=-1.0, control_max=1.0) for _ in range(2))
    change(controller, WILD, on_trial=True)
    push_away(controller)
    change(controller, WEAK)
    for _ in range(50):
        assert -1.0 <= controller.step(1.0, -50.0) <= 1.0, "its own gains saturate now"
        other.step(1.0, -50.0)
    assert controller.step(1.0, 1.0) == pytest.approx(other.step(1.0, 1.0), abs=1e-3)


def test_a_bank_of_joints_does_the_same() -> None:
    one, given = at_work(), ControllerSettings(WEAK, sample_time=H)
    bank = ControllerBank([given, given])
    for _ in range(300):
        bank.step([(1.0, 0.0, 0.0, 0.0, None)] * 2)
    on_trial = replace(given, gains=WILD, on_trial=True)
    for each, measured in ((on_trial, 0.5), (given, 0.4)):
        change(one, each.gains, on_trial=each.on_trial)
        bank.reconfigure([given, each])
        for _ in range(20):
            wanted = one.step(1.0, measured)
            assert bank.step([(1.0, measured, 0.0, 0.0, None)] * 2)[1] == wanted


def test_an_integrating_plant_is_not_driven_off_by_what_a_trial_left_to_weak_gains() -> None:
    """A load of 0.13 kg m2 whose controller moves the control by 0.05 a second: the trial left it -2.6 N m."""
    plant = Plant(PlantSettings(read_process("1/(0.13*s + 0.05) * exp(-0.02*s)"), sample_time=H))
    controller = FopidController(ControllerSettings(WEAK, sample_time=H, control_min=-5.0, control_max=5.0))
    simulate(controller, plant, 6000, lambda _: 2.0)
    assert plant.output == pytest.approx(2.0, abs=0.05)
    change(controller, Fopid(20.0, 80.0), on_trial=True)
    trial = simulate(controller, plant, 40, lambda _: 2.1)
    assert abs(trial.control[-1]) > 2.0, "it swings from limit to limit"
    change(controller, WEAK)
    after = simulate(controller, plant, 2000, lambda _: 2.0)
    assert abs(after.measurement - 2.0).max() < 1.5 * abs(trial.measurement - 2.0).max()
