"""No experiment takes a foreign plant out of its safe range, on any seed; and each moves it enough to learn from."""

from __future__ import annotations

import math

import pytest
from foreign_plants.gallery import GALLERY
from virtual_loop import VirtualLoop

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_ros.tuner.learning.announcement import WORKED_OUT
from fopid_ros.tuner.learning.closed_loop_experiment import LONGEST, ClosedLoopExperiment, ExperimentSettings
from fopid_ros.tuner.learning.loop_baseline import LoopBaseline
from fopid_ros.tuner.learning.reach import Reach
from fopid_ros.tuner.learning.running_controller import TICKS_MIN, read_running_controller


def experiment(name: str, seed: int, history: float = 600.0) -> tuple[VirtualLoop, ClosedLoopExperiment, list[str]]:
    """The loop after an experiment, repeated as long as there is time for it; and how each ended."""
    exhibit = GALLERY[name]
    loop = VirtualLoop(exhibit, seed, history, longest=100.0 * exhibit.horizon)
    loop.run(0.3 * exhibit.horizon)
    made = ClosedLoopExperiment(loop, loop, LoopBaseline(read_running_controller(loop)), ExperimentSettings())
    made.measure()
    loop.history.whole_since = loop.time
    ended = [made.excite()]
    if not ended[0] and made.fits:
        ended.append(made.excite())
    return loop, made, ended


def check(name: str, seed: int) -> None:
    exhibit = GALLERY[name]
    loop, made, ended = experiment(name, seed)
    low, high = exhibit.unsafe
    assert low < min(loop.trace.true) < max(loop.trace.true) < high
    begun = loop.history.record(0.3 * exhibit.horizon).time.size
    far = max(abs(y - loop.setpoint) for y in loop.trace.true[-begun:])
    assert far < 1.2 * made.loop.deviation_max, ended  # the band is the measurement's, which is noisy
    assert far > 2.0 * made.loop.noise, ended


@pytest.mark.parametrize("name", ["stirred_reactor", "level_tank", "flexible_joint", "heat_exchanger"])
def test_an_experiment_stays_in_its_band(name: str) -> None:
    check(name, seed=5)


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", GALLERY)
def test_an_experiment_stays_in_its_band_on_any_seed(name: str) -> None:
    for seed in range(3):
        check(name, seed)


def test_what_was_announced_is_kept_and_the_record_is_whole() -> None:
    loop, made, _ = experiment("coupled_heaters", 2, history=60.0)
    most = LONGEST * made.duration + WORKED_OUT
    assert loop.stages[0].message.endswith(f"up to {most:.3g} s where it says too little")
    began = 0.3 * GALLERY["coupled_heaters"].horizon
    assert loop.time - began <= LONGEST * made.duration
    record = loop.history.record(began + 0.15 * made.duration)
    assert record.span > made.duration > 60.0


def test_a_limit_cycle_is_no_rest() -> None:
    loop = VirtualLoop(GALLERY["flexible_joint"], 1)
    made = ClosedLoopExperiment(loop, loop, LoopBaseline(read_running_controller(loop)), ExperimentSettings())
    step = loop.plant.step

    def cycling(control: float, dt: float) -> float:
        loop.plant.measurement = step(control, dt) + 2.0 * math.sin(2.0 * math.pi * loop.time / 0.15)
        return loop.plant.measurement

    loop.plant.step = cycling  # type: ignore[method-assign]
    with pytest.raises(InputError, match=r"swings by|drifting by"):
        made.measure()


def test_without_gains_it_says_how_to_come_by_the_first() -> None:
    loop = VirtualLoop(GALLERY["flexible_joint"], 1)
    loop.set(gains=Fopid(0.0))
    with pytest.raises(InputError, match=r"shows no time scale: record a step .* fopid design FILE"):
        ClosedLoopExperiment(loop, loop, LoopBaseline(read_running_controller(loop)), ExperimentSettings())


@pytest.mark.parametrize("gains", [Fopid(0.0, 0.5, 0.0), Fopid(0.5, 0.0, 0.1)])
def test_gains_without_a_time_scale_are_moved_for_as_long_as_those_they_were_learnt_with(gains: Fopid) -> None:
    loop = VirtualLoop(GALLERY["flexible_joint"], 1)
    loop.set(gains=gains)
    baseline, least = LoopBaseline(read_running_controller(loop)), 10.0 * TICKS_MIN * loop.sample_time
    before = Reach(0.01, 0.05, 0.5, duration=2.0 * least)
    assert ClosedLoopExperiment(loop, loop, baseline, ExperimentSettings(), before).duration == 2.0 * least
    assert ClosedLoopExperiment(loop, loop, baseline, ExperimentSettings()).duration == least
