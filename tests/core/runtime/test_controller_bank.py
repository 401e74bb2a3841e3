"""Each joint of a bank is the controller that it would be by itself, bit for bit, whatever happens to it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.runtime.controller import ControllerSettings, FopidController
from fopid_core.runtime.controller_bank import ControllerBank, Signals

H = 0.005
BASE = ControllerSettings(Fopid(2.0, 1.0, 0.1, 0.9, 0.7), sample_time=H)


def varied(random: np.random.Generator, sample_time: float = H) -> ControllerSettings:
    """Settings of all kinds, with limits that are met."""
    gains = Fopid(
        *(float(g) for g in random.uniform((0.0, 0.0, 0.0, 0.1, 0.1), (4.0, 3.0, 0.2, 1.6, 1.4)))
    )  # fmt: skip
    limit = float(random.uniform(0.5, 3.0))
    return ControllerSettings(
        gains, sample_time, control_min=-limit, control_max=limit * float(random.choice([0.3, 1.0, math.inf])),
        control_rate_max=float(random.choice([5.0, 100.0, math.inf])), setpoint_weight=float(random.choice([0.3, 1.0])),
        derivative_setpoint_weight=float(random.choice([0.0, 1.0])),
        derivative_filter_time=float(random.choice([0.0, 0.02])), tracking_time=float(random.choice([0.0, 0.5])),
        setpoint_rate_max=float(random.choice([2.0, math.inf])), deadband=float(random.choice([0.0, 0.05])),
        antiwindup=str(random.choice(["none", "back_calculation", "conditional_integration"])),  # type: ignore[arg-type]
        measurement_filter_order=int(random.integers(3)), measurement_filter_time=0.02,
        bumpless=bool(random.choice([True, False])), angle_wraparound=bool(random.choice([True, False])),
    )  # fmt: skip


def signals(random: np.random.Generator, k: int) -> Signals:
    tracking = None if k % 3 else float(random.normal())
    return float(k // 60 % 3), float(random.normal(0.0, 0.4)), 0.1 * math.sin(0.05 * k), 0.3, tracking


class Beside:
    """A bank, and beside it a single controller for each joint that gets the same."""

    def __init__(self, settings: list[ControllerSettings]) -> None:
        self.bank, self.single = ControllerBank(settings), [FopidController(each) for each in settings]

    def step(self, given: list[Signals | None]) -> None:
        alone = [one.state.control if each is None else one.step(*each)
                 for one, each in zip(self.single, given, strict=True)]  # fmt: skip
        assert self.bank.step(given) == alone
        assert [one.state for one in self.bank.controllers] == [one.state for one in self.single]

    def reconfigure(self, settings: list[ControllerSettings]) -> None:
        self.bank.reconfigure(settings)
        for one, each in zip(self.single, settings, strict=True):
            if each != one.settings:
                one.reconfigure(each)


@pytest.mark.parametrize(("seed", "joints"), [(1, 1), (2, 2), (3, 7), (4, 7), (5, 30)])
def test_each_joint_is_its_single_controller_bit_for_bit_through_all_changes(seed: int, joints: int) -> None:
    random = np.random.default_rng(seed)
    settings = [varied(random) for _ in range(joints)]
    both, saturated = Beside(settings), 0
    for k in range(600):
        if k % 37 == 5:  # new gains, limits, filters for one of them
            settings = list(settings)
            settings[int(random.integers(joints))] = varied(random)
            both.reconfigure(settings)
        if k % 53 in (20, 30):
            chosen, mode = int(random.integers(joints)), "manual" if k % 53 == 20 else "auto"
            both.bank.controllers[chosen].set_mode(mode)  # type: ignore[arg-type]
            both.single[chosen].set_mode(mode)  # type: ignore[arg-type]
        if k == 300:
            both.bank.reset()
            for one in both.single:
                one.reset()
        given: list[Signals | None] = [signals(random, k) for _ in range(joints)]
        if k % 41 < 6:  # a joint whose sensor is silent
            silent = k // 41 % joints
            wanted = None if k % 2 else 0.2
            assert both.bank.controllers[silent].hold(wanted) == both.single[silent].hold(wanted)
            given[silent] = None
        both.step(given)
        saturated += sum(one.state.saturated for one in both.single)
    assert saturated > 50  # the limits were met


def test_the_whole_bank_changes_its_sample_time_and_band() -> None:
    random = np.random.default_rng(6)
    both = Beside([varied(random) for _ in range(3)])
    for settings in ([varied(random, 0.02) for _ in range(3)],
                     [replace(varied(random, 0.02), horizon=5.0) for _ in range(3)]):  # fmt: skip
        for k in range(50):
            both.step([signals(random, k) for _ in range(3)])
        both.reconfigure(settings)
    for k in range(50):
        both.step([signals(random, k) for _ in range(3)])


def test_over_a_long_time_at_rest_too() -> None:
    """What dies away is swept to zero at the same ticks."""
    both = Beside([BASE, replace(BASE, gains=Fopid(1.0, 0.5, 0.2, 0.4, 1.3))])
    both.step([(1.0, 0.0, 0.0, 0.0, None)] * 2)
    for _ in range(3000):
        both.step([(0.0, 0.0, 0.0, 0.0, None)] * 2)


def test_a_signal_that_is_refused_leaves_its_joint_as_it_was_and_the_others_tick() -> None:
    bank, single = ControllerBank([BASE] * 3), FopidController(BASE)
    good: Signals = (1.0, 0.2, 0.0, 0.0, None)
    with pytest.raises(InputError, match=r"joint 1: setpoint = 1.0, measurement = nan.*allowed: finite numbers"):
        bank.step([good, (1.0, math.nan, 0.0, 0.0, None), good])
    single.step(*good)
    assert [one.state.control for one in bank.controllers] == [single.state.control, 0.0, single.state.control]
    assert bank.step([good] * 3) == [single.step(*good), FopidController(BASE).step(*good), single.state.control]


def test_joints_of_different_clocks_or_none_are_refused() -> None:
    with pytest.raises(InputError, match="allowed: 1 and more"):
        ControllerBank([])
    with pytest.raises(InputError, match=r"sample_time = 0.01, .* allowed: one sample time and one band"):
        ControllerBank([BASE, replace(BASE, sample_time=0.01)])
    bank = ControllerBank([BASE])
    with pytest.raises(InputError, match="2 settings; allowed: 1, one for each joint"):
        bank.reconfigure([BASE, BASE])
