"""Limits: the memory of the controller stays that of an error its control could follow."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fopid_core.model.fopid import Fopid
from fopid_core.model.process import read_process
from fopid_core.runtime.antiwindup import conditioning
from fopid_core.runtime.controller import ControllerSettings, FopidController
from fopid_core.runtime.plant import Plant, PlantSettings

from .brute_force import BruteForce

H = 0.01
METHODS = ["back_calculation", "conditional_integration"]
# The best ITAE with max |S| <= 1.6 and a first control of at most 20, of all FOPIDs and of all PIDs.
BEST = {
    "P1": (Fopid(1.2369, 0.68133, 0.90206, 0.99685, 0.63349), Fopid(1.07, 0.45993, 0.18926)),
    "P2": (Fopid(0.91861, 1.3347, 0.14259, 0.99979, 1.0722), Fopid(0.92368, 1.4346, 0.19067)),
    "P3": (Fopid(0.90001, 0.39894, 0.78245, 0.9977, 0.66916), Fopid(0.78772, 0.28431, 0.19209)),
    "P4": (Fopid(4.0329, 3.836, 0.65213, 0.99447, 0.66958), Fopid(3.7364, 3.488, 0.16244)),
}
FRACTIONAL = Fopid(1.5, 0.6, 0.3, 0.8, 0.5)
ABOVE_ONE = Fopid(0.9116, 0.2526, 0.2023, 1.1577, 0.9973)


def saturated(k: int) -> float:
    """25 s of a setpoint that no control within the limits reaches, then one that is reached."""
    return 3.0 if k < 2500 else 0.5


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("gains", [BEST["P1"][0], FRACTIONAL, ABOVE_ONE])
def test_it_is_the_controller_that_remembers_every_realisable_error(gains: Fopid, method: str) -> None:
    # The integral of lines, by its formula; the bank's 0.25 % are left. Any other derivative has another kick, and what
    # is realisable goes by the kick.
    config = ControllerSettings(gains, H, control_min=-0.5, control_max=1.5, antiwindup=method)
    controller = FopidController(config)
    oracle = BruteForce(H, 3500, "linear", -0.5, 1.5, conditionally=method == "conditional_integration")
    oracle.use(gains)
    plant, twin = (Plant(PlantSettings(read_process("P1"), sample_time=H)) for _ in range(2))
    limited = 0
    for k in range(3500):
        control, expected = (
            controller.step(saturated(k), plant.measurement),
            oracle.step(saturated(k) - twin.measurement),
        )
        limited += controller.state.saturated
        assert abs(control - expected) < 5e-3
        assert abs(plant.step(control) - twin.step(expected)) < 3e-4
    assert limited > 2000


def recovery(process: str, gains: Fopid, scenario: str, **config: object) -> tuple[float, float]:
    """Time to within 2 % from when the setpoint can be reached again [s], and the integral of |error| from then."""
    before, after = 3000, 2000
    infeasible = scenario == "setpoint"
    target = 0.5 if infeasible else 1.0
    controller = FopidController(
        ControllerSettings(gains, H, control_min=-0.5, control_max=1.5 if infeasible else 1.2, **config)
    )
    plant = Plant(PlantSettings(read_process(process), sample_time=H))
    off = []
    for k in range(before + after):
        setpoint, load = (3.0, 0.0) if infeasible else (1.0, -0.8)
        if k >= before:
            setpoint, load = target, 0.0
            off.append(abs(plant.measurement - target))
        plant.step(controller.step(setpoint, plant.measurement), load)
    late = [k for k, error in enumerate(off) if error > 0.02]
    return H * (max(late, default=-1) + 1), H * sum(off)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("scenario", ["setpoint", "load"])
@pytest.mark.parametrize("process", BEST)
def test_recovery_from_half_a_minute_at_the_limit_is_no_slower_than_the_best_pids(
    process: str, scenario: str, method: str
) -> None:
    fopid, pid = BEST[process]
    (settled, area), (pid_settled, pid_area) = (recovery(process, g, scenario, antiwindup=method) for g in (fopid, pid))
    assert settled <= 1.02 * pid_settled  # P2: 4.34 s and 4.29 s; without limits 4.30 s and 4.24 s
    assert area <= 1.02 * pid_area


@pytest.mark.parametrize("gains", [BEST["P1"][0], BEST["P1"][1]])
def test_without_anti_windup_recovery_costs_several_times_as_much(gains: Fopid) -> None:
    assert recovery("P1", gains, "setpoint", antiwindup="none")[1] > 5.0 * recovery("P1", gains, "setpoint")[1]


def test_the_classical_scheme_is_chosen_by_a_tracking_time_and_works_too() -> None:
    classical = recovery("P1", BEST["P1"][1], "setpoint", tracking_time=2.0)
    assert classical[1] < 0.2 * recovery("P1", BEST["P1"][1], "setpoint", antiwindup="none")[1]
    assert classical != recovery("P1", BEST["P1"][1], "setpoint")


def test_a_controller_whose_inverse_is_not_stable_falls_back_to_the_classical_scheme() -> None:
    # kd s^2 + kp + ki/s has zeros in the right half plane: kd s^3 + kp s + ki lacks s^2.
    unstable, stable = (
        FopidController(ControllerSettings(g)) for g in (Fopid(1, 1, 0.5, 1, 2), Fopid(1, 1, 0.5, 1, 1))
    )
    assert conditioning(unstable._operators, unstable.settings.gains) is None
    assert conditioning(stable._operators, stable.settings.gains) is not None


@pytest.mark.parametrize("gains", [Fopid(0.0, 0.5), Fopid(0.0, 0.5, 0.0, 0.8), Fopid(0.001, 0.5, 0.0, 1.3)])
def test_an_integral_alone_leaves_the_limit_as_soon_as_the_error_turns(gains: Fopid) -> None:
    controller = FopidController(ControllerSettings(gains, H, control_max=1.0))
    for _ in range(3000):
        assert controller.step(1.0, 0.0) <= 1.0
    assert [controller.step(0.0, 0.05) for _ in range(3)][-1] < 1.0


@pytest.mark.parametrize("lam", [1.5, 1.7, 1.875, 1.95])
def test_an_integral_of_any_order_alone_does_not_wind_up(lam: float) -> None:
    controller = FopidController(ControllerSettings(Fopid(0.0, 1.75, 0.0, lam), 0.02, control_max=1.0))
    for _ in range(1500):
        controller.step(1.0, 0.0)
        assert controller.state.control_unlimited < 1.05
    assert conditioning(controller._operators, controller.settings.gains) is not None


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("tracking_time", [0.0, 1.0])
def test_gains_of_the_other_sign_between_the_opposite_limits_give_the_opposite_control(
    method: str, tracking_time: float
) -> None:
    def controller(sign: float, low: float, high: float) -> FopidController:
        gains = Fopid(sign * 1.5, sign * 0.6, sign * 0.3, 0.8, 0.5)
        limits = {"control_min": low, "control_max": high, "antiwindup": method, "tracking_time": tracking_time}
        return FopidController(ControllerSettings(gains, H, **limits))

    direct, reverse = controller(1.0, -0.5, 1.5), controller(-1.0, -1.5, 0.5)
    for k in range(3500):
        measured = 0.2 * math.sin(0.01 * k)
        assert direct.step(saturated(k), measured) == -reverse.step(saturated(k), measured)


@pytest.mark.parametrize("lam", [0.7, 1.0])
def test_the_classical_scheme_does_not_overshoot_however_short_its_tracking_time(lam: float) -> None:
    settings_ = ControllerSettings(Fopid(1.0, 1.0, 0.0, lam), H, control_max=1.0, tracking_time=1e-6)
    controller = FopidController(settings_)
    for _ in range(3000):
        controller.step(1.5, 0.0)
        assert 1.0 < controller.state.control_unlimited < 1.6


@pytest.mark.parametrize(
    ("h", "gains", "tracking_time"),
    [(0.17, Fopid(3.2, 0.0185, 0.744, 1.966), 0.0067), (0.113, Fopid(1.63, 0.29, 0.0, 1.952), 0.00064)],
)
def test_near_a_double_integral_the_classical_scheme_does_not_wind_up_either(
    h: float, gains: Fopid, tracking_time: float
) -> None:
    settings_ = ControllerSettings(gains, h, control_min=-1.0, control_max=1.0, tracking_time=tracking_time)
    controller = FopidController(settings_)
    for _ in range(3000):
        controller.step(1.0, 0.0)
        assert abs(controller.state.control_unlimited) < 10.0


@pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid")
@pytest.mark.parametrize("tracking_time", [0.0, 1e-9, 1e9])
@pytest.mark.parametrize("ki", [5e-324, -1e-300, 1e100])
@pytest.mark.parametrize("kp", [0.0, 5e-324, -1e100])
def test_the_smallest_and_the_largest_gains_are_taken(kp: float, ki: float, tracking_time: float) -> None:
    for lam, sample_time in ((0.3, 1e6), (2.0 - 1e-12, 1e-6), (1.0, 0.01)):
        gains = Fopid(kp, ki, 1e-300, lam, 1.5)
        FopidController(ControllerSettings(gains, sample_time, control_max=1.0, tracking_time=tracking_time))


orders = st.one_of(st.sampled_from([0.0, 1.0]), st.floats(0, 1.9))


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    gains=st.builds(Fopid, kp=st.floats(0, 5), ki=st.floats(0.01, 2), kd=st.floats(0, 1), lam=orders, mu=orders),
    method=st.sampled_from(METHODS),
    rate=st.sampled_from([math.inf, 0.5]),
    sign=st.sampled_from([-1.0, 1.0]),
)
def test_half_a_minute_at_the_limit_does_not_wind_any_controller_up(
    gains: Fopid, method: str, rate: float, sign: float
) -> None:
    gains = Fopid(sign * gains.kp, sign * gains.ki, sign * gains.kd, gains.lam, gains.mu)
    config = ControllerSettings(
        gains, 0.02, control_min=-1.0, control_max=1.0, control_rate_max=rate, antiwindup=method
    )
    controller = FopidController(config)
    kicks = []
    for _ in range(50):
        controller.step(sign, 0.0)
        kicks.append(abs(controller.state.control_unlimited))
    for _ in range(1450):
        controller.step(sign, 0.0)
    # Remembered is an error the control could follow: what it asks for is no more than the first kick and a few parts.
    reach = 2.0 * max(kicks) + 10.0 * (1.0 + abs(gains.kp) + abs(gains.ki) + abs(gains.kd))
    assert abs(controller.state.control_unlimited) < reach
    assert abs(controller.state.integral) < reach


def test_tracking_takes_the_place_of_the_own_limited_control() -> None:
    # Another controller drives the actuator at 0.3 for a minute; then the loop goes on from there.
    gains = Fopid(1.0, 0.5)
    follower, blind = (FopidController(ControllerSettings(gains, H)) for _ in range(2))
    follower.step(1.0, 0.0)
    blind.step(1.0, 0.0)
    for _ in range(6000):
        followed, wound_up = follower.step(1.0, 0.5, tracking=0.3), blind.step(1.0, 0.5)
    # In balance the correction cancels the error: 0.5 + (0.3 - u) / kp = 0.
    assert followed == pytest.approx(0.8, abs=1e-6)
    assert wound_up > 15.0


def test_the_rate_limit_counts_from_what_the_actuator_did() -> None:
    controller = FopidController(ControllerSettings(Fopid(10.0, 1.0), H, control_rate_max=5.0))
    controller.step(1.0, 0.0)
    assert controller.step(1.0, 0.0, tracking=2.0) == pytest.approx(2.05)


def test_at_the_first_tick_there_is_nothing_yet_to_follow() -> None:
    tracked, plain = (FopidController(ControllerSettings(FRACTIONAL, H)) for _ in range(2))
    assert tracked.step(1.0, 0.2, tracking=5.0) == plain.step(1.0, 0.2)


def test_tracking_what_was_asked_for_changes_nothing() -> None:
    tracked, plain = (FopidController(ControllerSettings(FRACTIONAL, H)) for _ in range(2))
    last = tracked.state.control
    for k in range(300):
        measured = math.sin(0.02 * k)
        last = tracked.step(1.0, measured, tracking=last)
        assert last == plain.step(1.0, measured)
    assert np.isfinite(last)
