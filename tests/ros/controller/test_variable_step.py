"""A controller node that goes by the stamps of its samples."""

from __future__ import annotations

import pytest

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.runtime.controller import ControllerSettings, FopidController
from fopid_ros.controller.sample_intervals import SampleIntervals, check_variable_step

from ..conftest import Graph
from .fed import PERIOD, LockstepByHand

GAINS = {"kp": 1.0, "ki": 2.0, "kd": 0.05, "lam": 0.9, "mu": 0.8}


@pytest.mark.slow
def test_uneven_stamps_are_the_intervals_of_the_controller_and_too_long_a_one_is_a_stale_measurement(
    graph: Graph,
) -> None:
    fed = LockstepByHand(graph, {**GAINS, "variable_step": True, "measurement_timeout": 0.2, "setpoint.initial": 1.0})
    twin = FopidController(ControllerSettings(Fopid(**GAINS), PERIOD, variable_step=True))
    last = None
    for sample, measurement in ((10.0, 0.0), (11.3, 0.1), (12.0, 0.15), (15.1, 0.3), (16.0, 0.35)):
        twin.set_interval(PERIOD if last is None else round((sample - last) * PERIOD * 1e9) * 1e-9)
        assert fed.tick(sample, measurement) == pytest.approx(twin.step(1.0, measurement), rel=1e-9)
        last = sample
    assert fed.states[-1].sample_interval == pytest.approx(0.9 * PERIOD)
    held = fed.controls[-1].value
    assert fed.tick(40.0, 0.9) == held  # 0.24 s later
    assert fed.states[-1].stale
    fed.tick(41.0, 0.9)
    assert not fed.states[-1].stale


def test_samples_that_repeat_or_nearly_do_are_waited_for_and_time_that_runs_back_begins_anew() -> None:
    intervals = SampleIntervals(0.01)
    found = [intervals.take(ns) for ns in (10_000_000, 10_000_000, 12_000_000, 21_000_000)]
    assert found == pytest.approx([0.01, 0.0, 0.0, 0.011])
    assert intervals.take(3_000_000) == 0.01
    assert intervals.take(15_000_000) == pytest.approx(0.012)
    intervals.begin()
    assert intervals.take(99_000_000) == 0.01


def test_a_timeout_and_the_longest_step_of_the_core_bound_the_interval() -> None:
    assert SampleIntervals(0.01).longest(0.1e9) == pytest.approx(0.1)
    assert SampleIntervals(0.01).longest(float("inf")) == pytest.approx(10.0)


def test_a_table_of_gains_beside_it_is_refused() -> None:
    with pytest.raises(InputError, match="variable_step = True, schedule_file given; allowed: one of them"):
        check_variable_step({"variable_step": True, "schedule_file": "table.yaml"})
