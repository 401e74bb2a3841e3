"""Gains and orders changed while the controller runs: as one that had them all along, with or without the step."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import read_process
from fopid_core.model.stability import stability
from fopid_core.runtime.controller import ControllerSettings, FopidController, with_gains
from fopid_core.runtime.filter_bank import Band
from fopid_core.runtime.plant import Plant, PlantSettings

from .brute_force import BruteForce, Kind

H, COUNT = 0.01, 1500
TIME = H * np.arange(COUNT)
ERRORS = np.exp(-0.3 * TIME) * np.cos(TIME) * (1 - np.exp(-5 * TIME))

TO_INTEGER = {
    0: Fopid(2.9692, 0.8028, 1.3394, 1.0138, 0.6074),
    500: Fopid(1.2, 0.5, 0.6, 0.8, 0.4),
    900: Fopid(0.8, 0.3, 0.2, 1.0, 1.0),
}
THROUGH_ALL = {
    0: Fopid(1.0, 0.5, 0.2, 1.0, 1.0),
    300: Fopid(1.0, 0.5, 0.2, 0.5, 0.5),
    600: Fopid(2.0, 1.0, 0.1, 1.5, 0.0),
    900: Fopid(0.5, 0.2, 0.3, 0.0, 0.2),
    1200: Fopid(1.0, 1.0, 0.1, 2.0, 1.0),
}
ABOVE_ONE = {
    0: Fopid(1.0, 0.5, 0.02, 1.0, 1.5),
    300: Fopid(1.0, 0.5, 0.02, 0.5, 2.0),
    600: Fopid(2.0, 1.0, 0.1, 1.5, 0.0),
    900: Fopid(0.5, 0.2, 0.03, 1.2, 1.2),
    1200: Fopid(1.0, 1.0, 0.01, 1.0, 1.9),
}


def changed(changes: dict[int, Fopid], *, bumpless: bool) -> np.ndarray:
    config = ControllerSettings(changes[0], sample_time=H, bumpless=bumpless)
    controller = FopidController(config)
    control = np.empty(COUNT)
    for k in range(COUNT):
        if k in changes:
            controller.reconfigure(with_gains(config, changes[k]))
        control[k] = controller.step(float(ERRORS[k]), 0.0)
    return control


def remembered(changes: dict[int, Fopid], kind: Kind) -> np.ndarray:
    oracle = BruteForce(H, COUNT, kind)
    control = np.empty(COUNT)
    for k in range(COUNT):
        if k in changes:
            oracle.use(changes[k])
        control[k] = oracle.step(ERRORS[k])
    return control


@pytest.mark.parametrize("changes", [TO_INTEGER, THROUGH_ALL])
def test_from_the_very_next_tick_it_is_the_controller_that_remembers_every_sample(changes: dict) -> None:
    # Both take the error as lines between samples; what is left are the bank's 0.02 dB = 0.25 % of each part.
    off = np.abs(changed(changes, bumpless=False) - remembered(changes, "linear"))
    assert off.max() < 1e-3
    assert max(off[k] for k in changes) < 3e-4


@pytest.mark.parametrize("changes", [TO_INTEGER, THROUGH_ALL, ABOVE_ONE])
def test_from_the_very_next_tick_it_is_the_gruenwald_letnikov_controller(changes: dict) -> None:
    # First-order differences are off by order/2 * h * slope; more where the signal has a corner, at its start.
    off = np.abs(changed(changes, bumpless=False) - remembered(changes, "gruenwald"))
    assert off[100:].max() < 5e-3
    assert max(off[k] for k in changes) < 1e-3


@pytest.mark.parametrize("changes", [TO_INTEGER, THROUGH_ALL, ABOVE_ONE])
def test_bumpless_is_the_same_but_for_a_constant(changes: dict) -> None:
    bias = changed(changes, bumpless=True) - changed(changes, bumpless=False)
    edges = [*changes, COUNT]
    for begin, end in itertools.pairwise(edges):
        assert np.ptp(bias[begin:end]) < 1e-9
    assert np.abs(np.diff(bias)).max() > 0.01


def test_new_gains_step_the_control_no_further_than_they_ask_for() -> None:
    first, second = Fopid(0.9116, 0.2526, 0.2023, 1.1577, 0.9973), TO_INTEGER[0]
    config = ControllerSettings(first, sample_time=H)
    changing, always_new = FopidController(config), FopidController(with_gains(config, second))
    control = []
    for k, value in enumerate(1 - np.exp(-0.4 * H * np.arange(1200))):
        if k == 700:
            changing.reconfigure(with_gains(config, second))
        control.append((changing.step(1.0, float(value)), always_new.step(1.0, float(value))))
    steps = np.diff(np.array(control), axis=0)[699:]
    np.testing.assert_allclose(steps[:, 0], steps[:, 1], atol=1e-11)
    assert abs(steps[0, 0]) < 0.05 < abs(control[699][1] - control[699][0])


@pytest.mark.parametrize(
    "change",
    [
        {"setpoint_weight": 0.3},
        {"derivative_setpoint_weight": 0.0},
        {"derivative_filter_time": 0.2},
        {"setpoint_weight": 0.0, "derivative_setpoint_weight": 0.4, "derivative_filter_time": 0.0},
    ],
)
def test_new_weights_and_filters_do_not_step_the_control_either(change: dict) -> None:
    config = ControllerSettings(TO_INTEGER[0], sample_time=H, derivative_filter_time=0.05)
    changing, unchanged = FopidController(config), FopidController(config)
    for k in range(300):
        if k == 200:
            changing.reconfigure(ControllerSettings(TO_INTEGER[0], sample_time=H, **change))
        signals = (2.0, 1 - math.exp(-0.02 * k))
        step = changing.step(*signals) - unchanged.step(*signals)
        assert abs(step) < (1e-9 if k < 200 else 0.02 if k == 200 else 1.0)


@pytest.mark.parametrize(
    ("filter_time", "change"),
    [
        (0.0, {"band": Band(1e-3, 1e2, 12)}),
        (0.0, {"horizon": 50.0}),
        (1.0, {"measurement_filter_order": 0}),
        (1.0, {"measurement_filter_time": 0.0}),
        (1.0, {"measurement_filter_time": 0.1}),
        (1.0, {"measurement_filter_order": 0, "deadband": 2.0}),
    ],
)
@pytest.mark.parametrize("slope", [0.0, 1.0])
def test_neither_a_new_band_nor_a_faster_filter_is_a_jump_of_the_measurement(
    filter_time: float, change: dict, slope: float
) -> None:
    """A band moved the control from 164 to -947, a filter that was taken off a ramp by 27."""
    config = ControllerSettings(
        Fopid(1.0, 0.5, 0.2), H, derivative_setpoint_weight=0.0, measurement_filter_order=1,
        measurement_filter_time=filter_time, deadband=change.get("deadband", 0.0),
    )  # fmt: skip
    changing, unchanged = FopidController(config), FopidController(config)
    for k in range(2020):
        if k == 2000:
            changing.reconfigure(replace(config, **change))
        signals = (60.0, 50.0 * (1.0 - math.exp(-H * k)) + slope * H * k)
        assert abs(changing.step(*signals) - unchanged.step(*signals)) < 0.6


@pytest.mark.parametrize("mu", [1.0, 1.25])
@pytest.mark.parametrize("order", [1, 2])
def test_noise_of_the_past_is_no_move_when_a_derivative_comes_with_a_filter(mu: float, order: int) -> None:
    before = ControllerSettings(Fopid(0.3, 0.012), sample_time=1.0)
    slow = {"measurement_filter_order": order, "measurement_filter_time": 6.0}
    after = ControllerSettings(Fopid(1.2, 0.037, 17.0, 1.0, mu), sample_time=1.0, **slow)
    moves, unfiltered = [], []
    for seed in range(20):
        noise = np.random.default_rng(seed).normal(scale=0.05, size=300)
        controller = FopidController(before)
        control = [controller.step(0.0, float(noise[k])) for k in range(200)]
        controller.reconfigure(after)
        control += [controller.step(0.0, float(noise[k])) for k in range(200, 300)]
        moves.append(abs(control[200] - control[199]))
        unfiltered.append(abs(after.gains.kd * (noise[199] - noise[198])))
    assert np.mean(unfiltered) > 0.5, "what the derivative makes of the last two samples"
    assert max(moves) < 0.01, "one tick of the integral"


@pytest.mark.parametrize("sample_time", [1.0, 0.05])
@pytest.mark.parametrize("mu", [0.6, 1.0, 1.0923, 1.3])
def test_nor_does_it_move_the_control_later(mu: float, sample_time: float) -> None:
    """A control at rest at 40 % went to its limit in the second tick: the derivative still held what noise had been."""
    noise = 0.1
    before = ControllerSettings(Fopid(1.0, 0.01), sample_time)
    slow = {"measurement_filter_order": 2, "measurement_filter_time": 4.0}
    after = ControllerSettings(Fopid(5.4, 0.1, 79.0, 1.0, mu), sample_time, **slow)
    behind = FopidController(after)
    steps = [behind.step(0.0, 0.0 if k < 10 else 4.0 * noise) for k in range(10 + round(20.0 / sample_time))]
    for seed in range(10):
        measured = np.random.default_rng(seed).normal(scale=noise, size=4000)
        changing = FopidController(before)
        rest = [changing.step(0.0, float(y)) for y in measured[:2000]][-1]
        changing.reconfigure(after)
        control = [changing.step(0.0, float(y)) for y in measured[2000 : 2000 + round(20.0 / sample_time)]]
        assert np.abs(np.array(control) - rest).max() < np.abs(steps).max(), "as a step by four deviations moves it"


@pytest.mark.parametrize("ticks", [0.01, 0.04, 0.2, 0.45])
@pytest.mark.parametrize("mu", [0.5, 1.0, 1.6])
def test_nor_behind_a_filter_of_less_than_a_tick(mu: float, ticks: float) -> None:
    """It went to 200 deviations: the slopes were forgotten, and washouts that stand for the same past were not."""
    noise, sample_time = 0.002, 2.0
    before = ControllerSettings(Fopid(20.0, 0.4), sample_time)
    short = {"measurement_filter_order": 2, "measurement_filter_time": ticks * sample_time}
    after = ControllerSettings(Fopid(310.0, 18.0, 437.0, 1.0, mu), sample_time, **short)
    for seed in range(5):
        measured = np.random.default_rng(seed).normal(scale=noise, size=900)
        usual = FopidController(after)
        all_along = [usual.step(0.0, float(y)) for y in measured][500:]
        changing = FopidController(before)
        rest = [changing.step(0.0, float(y)) for y in measured[:300]][-1]
        changing.reconfigure(after)
        control = [changing.step(0.0, float(y)) for y in measured[300:312]]
        assert np.abs(np.array(control) - rest).max() < np.ptp(all_along), "as it moves in this noise anyway"


@pytest.mark.parametrize("mu", [0.7, 1.0, 1.3])
@pytest.mark.parametrize("filter_before", [0.0, 0.02])
def test_noise_at_the_tick_of_the_change_becomes_no_load(mu: float, filter_before: float) -> None:
    """Of a derivative without a filter it moves the control widely; nobody else may take that over for good."""
    noise, left, moved = np.random.default_rng(5).standard_normal(700), [], []
    for last in range(200, 260):
        before = ControllerSettings(Fopid(kp=2.0, ki=1e-9, kd=0.2, mu=mu), 0.005, measurement_filter_time=filter_before)
        controller = FopidController(before)
        told = [controller.step(0.0, read) for read in noise[:last].tolist()]
        moved.append(told[-1] - np.mean(told[100:]))
        controller.reconfigure(
            replace(before, gains=Fopid(3.0, 1e-9, 0.2), measurement_filter_order=2, measurement_filter_time=0.02)
        )
        left.append(np.mean([controller.step(0.0, read) for read in noise[last : last + 400].tolist()][40:]))
    assert np.std(moved) > 8.0 or mu < 1.0
    assert np.std(left) < 0.5 * np.std(moved)
    assert np.std(left) < 10.0


@pytest.mark.parametrize("weight", [0.0, 0.6, 1.0])
def test_the_setpoint_acts_at_once_also_where_a_filter_takes_over(weight: float) -> None:
    after = ControllerSettings(
        Fopid(2.0, 0.5), sample_time=H, measurement_filter_order=2, measurement_filter_time=0.3, setpoint_weight=weight
    )
    controller = FopidController(ControllerSettings(Fopid(1.0, 0.5), sample_time=H))
    last = [controller.step(0.0, 0.0) for _ in range(50)][-1]
    controller.reconfigure(after)
    controller.reconfigure(ControllerSettings(**{**vars(after), "control_max": 1e3}))
    assert controller.step(1.0, 0.0) - last == pytest.approx(2.0 * weight, abs=0.5 * H + 1e-12)


def test_new_limits_alone_leave_what_is_remembered_alone() -> None:
    # At the limit something is still owed to the memory; a hold right after the change shows whether it was touched.
    config = ControllerSettings(TO_INTEGER[0], sample_time=H, control_min=-1.0, control_max=1.0)
    changing, unchanged = FopidController(config), FopidController(config)
    for k in range(200):
        if k % 50 == 20:
            changing.reconfigure(ControllerSettings(TO_INTEGER[0], sample_time=H, control_min=-0.5, control_max=2.0))
            changing.reconfigure(config)
            assert changing.hold() == pytest.approx(unchanged.hold(), abs=1e-12)
        signals = (2.0 if k < 120 else -0.3, 1 - math.exp(-0.02 * k))
        assert changing.step(*signals) == pytest.approx(unchanged.step(*signals), abs=1e-12)


orders = st.one_of(st.sampled_from([0.0, 1.0, 2.0]), st.floats(0, 2))
numbers = st.one_of(st.just(0.0), st.floats(1e-3, 5.0), st.floats(-5.0, -1e-3))
any_gains = st.builds(Fopid, kp=numbers, ki=numbers, kd=numbers, lam=orders, mu=orders)
antiwindup = st.sampled_from(["none", "back_calculation", "conditional_integration"])


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.lists(st.tuples(any_gains, antiwindup, st.integers(1, 30), st.floats(-10, 10)), min_size=1, max_size=8))
def test_any_sequence_of_changes_keeps_the_control_finite_and_within_limits(stretches: list) -> None:
    def config(numbers: Fopid, method: str) -> ControllerSettings:
        return ControllerSettings(numbers, control_min=-3.0, control_max=4.0, antiwindup=method)

    controller = FopidController(config(*stretches[0][:2]))
    for numbers, method, ticks, setpoint in stretches:
        controller.reconfigure(config(numbers, method))
        for _ in range(ticks):
            assert -3.0 <= controller.step(setpoint, 0.0) <= 4.0
            state = controller.state
            parts = (state.proportional, state.integral, state.derivative, state.control_unlimited)
            assert all(math.isfinite(part) for part in parts)


# Around the ITAE optimum of P1 with max |S| = 1.6; what is not stable by the argument principle is left out.
sound_gains = st.builds(
    Fopid, kp=st.floats(0.5, 1.5), ki=st.floats(0.2, 0.7), kd=st.floats(0, 1.0),
    lam=st.one_of(st.just(1.0), st.floats(0.85, 1.15)), mu=st.one_of(st.sampled_from([0.0, 1.0]), st.floats(0, 1.1)),
).filter(lambda gains: stability(Loop(read_process("P1"), gains)).stable)  # fmt: skip


@settings(max_examples=12, deadline=None, derandomize=True)
@given(st.lists(st.tuples(sound_gains, st.integers(20, 300)), min_size=2, max_size=8))
def test_after_any_sequence_of_sound_changes_the_loop_settles(stretches: list) -> None:
    config = ControllerSettings(stretches[0][0], sample_time=0.02, control_min=-2.0, control_max=3.0)
    controller, plant = FopidController(config), Plant(PlantSettings(read_process("P1"), sample_time=0.02))
    largest = 0.0
    for gains, ticks in [*stretches, (Fopid(1.2369, 0.68133, 0.90206, 0.99685, 0.63349), 1500)]:
        controller.reconfigure(with_gains(config, gains))
        for _ in range(ticks):
            plant.step(controller.step(1.0, plant.measurement))
            largest = max(largest, plant.measurement)
    assert largest < 2.0
    assert plant.measurement == pytest.approx(1.0, abs=0.02)
