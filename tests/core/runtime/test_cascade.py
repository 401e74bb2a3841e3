"""Two controllers in cascade: what the inner one could follow, and that the outer one does not wind up."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fopid_core.model.fopid import Fopid
from fopid_core.runtime.cascade import TrackingInput, realisable_setpoint
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.settings import ControllerSettings

H = 0.01
orders = st.one_of(st.just(1.0), st.floats(0.2, 1.4))


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    gains=st.builds(Fopid, kp=st.floats(0.2, 5), ki=st.floats(0, 3), kd=st.floats(0, 0.2), lam=orders, mu=orders),
    weight=st.floats(0.3, 1.0),
    rate=st.sampled_from([float("inf"), 3.0]),
    setpoints=st.lists(st.floats(-3, 3), min_size=3, max_size=12),
)
def test_with_the_realisable_setpoint_the_same_controller_would_just_not_have_been_limited(
    gains: Fopid, weight: float, rate: float, setpoints: list[float]
) -> None:
    # The definition itself, tried on a second controller with the same past: no formula of the code is used.
    config = ControllerSettings(gains, H, setpoint_weight=weight, control_min=-1.0, control_max=1.0,
                                control_rate_max=rate)  # fmt: skip
    inner, past = FopidController(config), []
    measured = 0.0
    for setpoint in setpoints:
        control = inner.step(setpoint, measured)
        possible = realisable_setpoint(inner)
        assert min(setpoint, measured) <= possible <= max(setpoint, measured)
        if not inner.state.saturated:
            assert possible == setpoint
        elif possible not in (setpoint, measured):
            again = FopidController(config)
            for signals in past:
                again.step(*signals)
            assert again.step(possible, measured) == pytest.approx(control, abs=1e-9)
            assert again.state.control_unlimited == pytest.approx(control, abs=1e-9)
        past.append((setpoint, measured))
        measured += 0.2 * (control - measured)


def test_an_inner_loop_that_does_not_follow_at_all_offers_what_it_has_reached() -> None:
    inner = FopidController(ControllerSettings(Fopid(2.0, 1.0), H))
    inner.step(1.0, 0.4)
    assert realisable_setpoint(inner) == 1.0
    inner.hold()
    assert realisable_setpoint(inner) == 0.4
    inner.step(1.0, 0.5)
    inner.set_mode("manual")
    assert realisable_setpoint(inner) == 0.5


def test_a_setpoint_that_acts_by_the_integral_alone_is_limited_to_what_was_reached() -> None:
    weights = {"setpoint_weight": 0.0, "derivative_setpoint_weight": 0.0}
    inner = FopidController(ControllerSettings(Fopid(2.0, 0.5), H, control_max=0.1, **weights))
    inner.step(1.0, 0.0)
    for _ in range(50):
        inner.step(1.0, -0.3)
    assert inner.state.saturated
    assert realisable_setpoint(inner) == -0.3


def test_what_comes_back_as_it_went_out_is_no_limit_whatever_time_it_took() -> None:
    tracking = TrackingInput()
    assert tracking.limit(0.5) == 0.5  # before anything went out: that is where the inner loop stands
    for k in range(100):
        tracking.sent(0.1 * k)
        assert tracking.limit(0.1 * max(0, k - 5)) is None
    assert tracking.limit(0.1 * 42) == 0.1 * 42


@dataclass
class Axis:
    """Speed within position: v' = (10 u - v) / 0.2, x' = v, stepped by its exact solution, no code of the project."""

    speed: float = 0.0
    position: float = 0.0

    def advance(self, torque: float, h: float = H) -> None:
        from math import exp

        decay = exp(-h / 0.2)
        settled = 10.0 * torque
        self.position += settled * h + 0.2 * (1.0 - decay) * (self.speed - settled)
        self.speed = settled + (self.speed - settled) * decay


@dataclass
class Outcome:
    overshoot: float
    largest_integral: float
    error: float


def run(*, tracks: bool, way: float = 20.0, delay: int = 1, seconds: float = 40.0) -> Outcome:
    """A cascade on the axis, whose speed cannot exceed 2; the limit comes back ``delay`` ticks late."""
    outer = FopidController(ControllerSettings(Fopid(1.2, 0.5), H, control_min=-8.0, control_max=8.0))
    inner = FopidController(ControllerSettings(Fopid(0.6, 3.0), H, control_min=-0.2, control_max=0.2))
    axis, tracking = Axis(), TrackingInput()
    told: list[float | None] = [None] * delay
    furthest = largest = 0.0
    for _ in range(round(seconds / H)):
        heard = told[-delay]
        limit = tracking.limit(heard) if tracks and heard is not None else None
        wanted = outer.step(way, axis.position, tracking=limit)
        tracking.sent(wanted)
        torque = inner.step(wanted, axis.speed)
        told.append(realisable_setpoint(inner))
        axis.advance(torque)
        furthest = max(furthest, axis.position)
        largest = max(largest, abs(outer.state.integral))
    return Outcome(furthest / way - 1.0, largest, axis.position - way)


@pytest.mark.parametrize("delay", [1, 3])
@pytest.mark.parametrize("way", [20.0, -20.0])
def test_the_outer_integral_does_not_wind_up_while_the_inner_control_is_limited(way: float, delay: int) -> None:
    # The speed never exceeds 2: no more than that is what the outer integral may stand for.
    tracked, blind = run(tracks=True, way=way, delay=delay), run(tracks=False, way=way, delay=delay)
    assert tracked.largest_integral < 2.5 < 6.0 < blind.largest_integral
    if way > 0:
        assert tracked.overshoot < 0.35 * blind.overshoot
    assert abs(tracked.error) < 1e-3 * abs(way)


def test_where_nothing_is_limited_the_wiring_changes_no_bit() -> None:
    for delay in (1, 5):
        assert run(tracks=True, way=0.2, delay=delay, seconds=10.0) == run(tracks=False, way=0.2, seconds=10.0)


@settings(max_examples=15, deadline=None, derandomize=True)
@given(kp=st.floats(0.3, 2.0), ki=st.floats(0.05, 1.0), lam=st.floats(0.6, 1.2))
def test_a_fractional_outer_integral_does_not_wind_up_either(kp: float, ki: float, lam: float) -> None:
    assume(ki < kp)
    gains = Fopid(kp, ki, 0.0, lam)
    largest = []
    for tracks in (True, False):
        outer = FopidController(ControllerSettings(gains, H))
        tracking = TrackingInput()
        for _ in range(3000):  # half a minute against an inner loop that stands still at 0
            limit = tracking.limit(0.0) if tracks else None
            tracking.sent(outer.step(1.0, 0.0, tracking=limit))
        largest.append(outer.state.integral)
    assert largest[0] < 0.5 * largest[1]
