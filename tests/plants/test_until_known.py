"""An experiment that ends once enough is known is shorter, as safe, and over before it was said to be."""

from __future__ import annotations

import numpy as np
import pytest
from foreign_plants.gallery import GALLERY
from virtual_loop import VirtualLoop

from fopid_core.design.identification.identify import identify
from fopid_core.design.sufficiency import Sufficiency
from fopid_ros.tuner.learning.announcement import LONGEST, usual_time
from fopid_ros.tuner.learning.closed_loop_experiment import ClosedLoopExperiment, ExperimentSettings
from fopid_ros.tuner.learning.loop_baseline import LoopBaseline
from fopid_ros.tuner.learning.running_controller import read_running_controller


def experiment(name: str, seed: int, until_known: bool = True) -> tuple[VirtualLoop, ClosedLoopExperiment, float]:
    """The loop after one experiment, and when it began."""
    exhibit = GALLERY[name]
    loop = VirtualLoop(exhibit, seed, longest=100.0 * exhibit.horizon)
    loop.run(0.3 * exhibit.horizon)
    baseline = LoopBaseline(read_running_controller(loop))
    made = ClosedLoopExperiment(loop, loop, baseline, ExperimentSettings(until_known=until_known))
    made.measure()
    began = loop.history.whole_since = loop.history.newest_time("control")
    sufficiency = Sufficiency("all", made.loop.noise, exhibit.sample_time)
    assert not made.excite(lambda: sufficiency.look(loop.history.record(began)))
    return loop, made, began


def is_safe(name: str, loop: VirtualLoop, made: ClosedLoopExperiment, began: float) -> bool:
    """Within what is safe all along, and within what is allowed from the beginning of the experiment on."""
    low, high = GALLERY[name].unsafe
    ticks = zip(loop.trace.time, loop.trace.true, strict=True)
    far = max(abs(y - loop.setpoint) for time, y in ticks if time >= began)
    return low < min(loop.trace.true) <= max(loop.trace.true) < high and far < 1.2 * made.loop.deviation_max


def test_it_is_shorter_and_what_is_learnt_is_what_the_whole_experiment_shows() -> None:
    short, made, began = experiment("quadruple_tank", 1)
    whole, _, whole_began = experiment("quadruple_tank", 1, until_known=False)
    assert short.time - began < 0.6 * (whole.time - whole_began)
    assert is_safe("quadruple_tank", short, made, began)
    learnt, all_there_is = (
        identify(loop.history.record(begin), "all", noise=made.loop.noise).best
        for loop, begin in ((short, began), (whole, whole_began))
    )
    assert learnt is not None
    assert all_there_is is not None
    s = 1j * all_there_is.crossover * np.geomspace(0.1, 1.0, 10)
    assert np.max(np.abs(learnt.process(s) / all_there_is.process(s) - 1.0)) < 0.15


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", GALLERY)
def test_it_is_safe_on_all_plants_and_over_in_time(name: str) -> None:
    loop, made, began = experiment(name, 2)
    assert is_safe(name, loop, made, began)
    announced = loop.stages[0].remaining
    assert announced == made.estimate < usual_time(made.duration, until_known=False, proved=False)
    assert loop.time - 0.3 * GALLERY[name].horizon <= LONGEST * made.duration, "what is said to be the most"
