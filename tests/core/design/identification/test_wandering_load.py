"""An ordinary day of a plant: loads wander without end, and the setpoint moves a few times."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from fopid_core.design.identification.identify import identify
from fopid_core.design.identification.record import Record
from fopid_core.design.identification.wandering_load import (
    MOST_SAMPLES,
    beside_wandering_loads,
    slow_beside_wandering_loads,
)
from fopid_core.design.recorded_tuning import tune_recorded
from tests.cases import slow

from .days import Day


def error(day: Day, record: Record) -> tuple[float, float]:
    """Of what is learnt, at the crossover, and its standard deviation, both relative."""
    found = beside_wandering_loads(record)
    assert found is not None
    frequency = np.array([found.crossover])
    learnt, true = found.process(1j * frequency), day.response(frequency)
    return float(abs(learnt / true - 1.0)[0]), found.deviation


DAYS = {
    "a calm one": Day(walk=0.002),
    "a usual one": Day(),
    "one step of the setpoint": Day(moves=(4.0,)),
    "a restless one": Day(walk=0.04, moves=(3.0, -3.0, 3.0, -3.0, 3.0)),
    "a delay about as long as the lags": Day(lags=(150.0, 50.0), delay=12, walk=0.005),
    "a negative gain": Day(gain=-0.7, moves=(1.0, -1.0, 1.0), walk=0.01),
}


@pytest.mark.parametrize("name", ["a usual one", *slow(*(name for name in DAYS if name != "a usual one"))])
def test_the_process_is_learnt_as_well_as_is_said(name: str) -> None:
    off, deviation = error(DAYS[name], DAYS[name].record(1))
    assert off < 2.5 * deviation
    assert deviation < 0.2


@pytest.mark.long
def test_the_deviation_is_the_usual_error() -> None:
    """Root mean square over twenty days; with so many it lies between these in 998 of 1,000 cases."""
    day = Day(samples=2000)
    found = np.array([error(day, day.record(seed)) for seed in range(20)])
    assert 0.5 < math.sqrt(np.mean((found[:, 0] / found[:, 1]) ** 2)) < 1.5


@pytest.mark.slow
def test_an_actuator_that_is_slow_is_learnt_beside_them() -> None:
    """It passes for lag and delay where the setpoint moves, which are all that is known of the process."""
    day = Day(walk=0.005, moves=(3.0, -3.0, 3.0), rate=0.01)
    record = day.record(0)
    found = beside_wandering_loads(record)
    assert found is not None
    behind = slow_beside_wandering_loads(record, found)
    assert behind is not None
    assert behind.flaws.rate == pytest.approx(0.01, rel=0.1)
    s = np.array([1j * behind.crossover])
    assert abs(behind.process(s) / day.response(s.imag) - 1.0) < 0.15
    assert abs(found.process(s) / day.response(s.imag) - 1.0) > 0.4
    assert behind.fit_pct > found.fit_pct + 30.0


@pytest.mark.slow
def test_a_process_that_was_learnt_from_a_part_is_looked_at_anew_in_the_whole() -> None:
    """An experiment learns from its moves and then asks all that was heard: it ended in an index error."""
    day = Day(walk=0.005, moves=(3.0, -3.0, 3.0), rate=0.01)
    record = day.record(0)
    found = beside_wandering_loads(record.part(float(record.time[0]), float(record.time[-400])))
    assert found is not None
    behind = slow_beside_wandering_loads(record, found)
    assert behind is not None
    assert behind.flaws.rate == pytest.approx(0.01, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("day", [Day(), Day(walk=0.005, sticks=0.6)])
def test_no_actuator_is_called_slow_that_is_not(day: Day) -> None:
    record = day.record(1)
    found = beside_wandering_loads(record)
    assert found is not None
    assert slow_beside_wandering_loads(record, found) is None


@pytest.mark.slow
def test_such_a_day_gives_gains_that_hold_the_plant() -> None:
    """By max |S| of the true process, the control held for a sample."""
    day = Day()
    found = tune_recorded(day.record(3), "frequency")
    assert found.success, found.message
    assert "beside it loads wander" in found.message
    assert found.tuned is not None
    tuning = found.tuned.tuning
    assert tuning is not None
    assert tuning.controller is not None
    assert day.peak(tuning.controller, tuning.filter) < 2.2


@pytest.mark.long
def test_identify_says_what_it_explains_and_why_a_worse_day_is_refused() -> None:
    day = Day()
    found = identify(day.record(1))
    assert found.success
    assert found.best is not None
    assert found.best.wanders
    assert "of what the loop was moved by from outside; beside it loads wander" in found.message
    restless = identify(replace(day, walk=0.3).record(1))
    assert not restless.success
    nothing_moved = identify(replace(day, moves=()).record(1))
    assert not nothing_moved.success


@pytest.mark.slow
def test_play_that_swallows_small_moves_is_learnt_beside_the_loads() -> None:
    """As if there were none the gain would be less than half of what it is for larger moves."""
    day = Day(walk=0.01, moves=(1.5, -1.5, 1.5, -1.5), play=0.4)
    record = day.record(4)
    found, linear = beside_wandering_loads(record), beside_wandering_loads(record, dead_band=False)
    assert found is not None
    assert linear is not None
    frequency = np.array([found.crossover])
    assert found.flaws.dead_band == pytest.approx(day.play, rel=0.1)
    assert found.flaws.slip == 0.0
    assert abs(found.process(1j * frequency) / day.response(frequency) - 1.0)[0] < 2.5 * found.deviation
    assert abs(linear.process(1j * frequency) / day.response(frequency))[0] < 0.7


@pytest.mark.long
def test_uneven_samples_and_longer_records_are_learnt_from_as_well() -> None:
    day = Day()
    record = day.record(1)
    kept = np.sort(np.random.default_rng(0).choice(record.time.size, round(0.95 * record.time.size), replace=False))
    uneven = Record(*(x[kept] for x in (record.time, record.control, record.measurement, record.setpoint)))
    assert not uneven.is_regular
    off, deviation = error(day, uneven)
    assert off < 2.5 * deviation
    assert deviation < 0.2
    long = replace(day, samples=MOST_SAMPLES + 5000, moves=(0.0,) * 6 + (4.0, -4.0, 4.0))
    found = beside_wandering_loads(long.record(1))
    assert found is not None
    assert found.offset > 0.0
    frequency = np.array([found.crossover])
    assert abs(found.process(1j * frequency) / long.response(frequency) - 1.0)[0] < 2.5 * found.deviation
    assert found.deviation < 0.2


@pytest.mark.slow
def test_of_few_samples_or_of_a_load_that_passes_for_the_process_it_is_not_known() -> None:
    """A wave of a load, next to no noise: five searches came to five ends, the likeliest with a delay of 2,844 s."""
    short = Day(samples=300).record(1)
    assert beside_wandering_loads(short) is None
    assert not identify(short.part(last=500.0)).success
    wave = Day(
        gain=-3.165, lags=(426.4, 286.3), delay=6, h=30.0, samples=6463, walk=0.0104, noise=0.008,
        moves=(1.67, 1.67, 1.67), sine=3.0, strength=0.49,
    )  # fmt: skip
    assert beside_wandering_loads(wave.record(1053)) is None


def test_without_anything_from_outside_it_is_not_known() -> None:
    record = Day(moves=()).record(1)
    assert beside_wandering_loads(record) is None
    assert beside_wandering_loads(replace(record, setpoint=None)) is None


def hovering(seed: int) -> Record:
    """Height of what hovers on thrust that lags by 60 ms, in gusts that wander, while an experiment moves it."""
    random, tick, count = np.random.default_rng(seed), 0.02, 3000
    moves = np.repeat(random.choice([-1.0, 1.0], count // 40), 40)
    moves[:400] = 0.0
    gusts = np.cumsum(0.05 * random.standard_normal(count))
    height = speed = thrust = integral = 0.0
    control, measured = np.empty(count), np.empty(count)
    for k in range(count):
        measured[k] = height + 0.007 * random.standard_normal()
        integral -= 2.0 * tick * measured[k]
        control[k] = integral - 10.0 * measured[k] - 6.0 * speed + moves[k]
        for _ in range(4):
            thrust += 0.25 * tick * (0.39 * (control[k] + gusts[k]) - thrust) / 0.06
            speed += 0.25 * tick * (thrust - 0.1 * speed)
            height += 0.25 * tick * speed
    return Record(tick * np.arange(count), control, measured, excitation=moves)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 3])
def test_loads_that_move_further_than_an_experiment_hide_it_and_that_is_said(seed: int) -> None:
    """What is learnt beside them has no spring in truth: it is off by 37 and 79 % at 1 rad/s, for all its fit."""
    found = identify(hovering(seed), noise=0.007)
    assert not found.success
    assert "loads that wander hide" in found.message
