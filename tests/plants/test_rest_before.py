"""An experiment that begins while the loop still comes to its setpoint: what came before tells that apart."""

from __future__ import annotations

import math

import pytest
from foreign_plants.gallery import Exhibit
from foreign_plants.parts import Plant, Sensor, State
from virtual_loop import VirtualLoop

from fopid_core.design.robust_verification import RobustLimits
from fopid_core.design.specification import TuningRequest
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import read_process
from fopid_core.model.stability import stability
from fopid_ros.tuner.learning.autotune import Autotuner
from fopid_ros.tuner.learning.autotune_request import AutotuneRequest
from fopid_ros.tuner.learning.closed_loop_experiment import ClosedLoopExperiment, ExperimentSettings
from fopid_ros.tuner.learning.gain_update import AcceptanceCriteria
from fopid_ros.tuner.learning.loop_baseline import LoopBaseline
from fopid_ros.tuner.learning.running_controller import read_running_controller

LIMITS = RobustLimits(2.5, math.radians(30.0))
CRITERIA = AcceptanceCriteria(TuningRequest(read_process("P1"), method="frequency"), LIMITS, 2.0)
EXPERIMENT = ExperimentSettings(excitation="relay", deviation_max=0.2, duration=8.0)
TRUE = read_process("-1.5/((0.4s+1)(0.1s+1))*exp(-0.015s)")
"""With what holding the control for a tick adds."""


class Cooling(Plant):
    """Two lags, behind an actuator without limits."""

    rest = (0.0, 0.0)
    substep = 0.002

    def make_sensor(self) -> Sensor:
        return Sensor(noise=0.002)

    def slopes(self, x: State, u: float) -> State:
        return (-1.5 * x[1] - x[0]) / 0.4, (u - x[1]) / 0.1


def on_its_way(after: float, seed: int) -> VirtualLoop:
    """The loop so long after a step of its setpoint [s]."""
    loop = VirtualLoop(Exhibit(Cooling, 0.01, (-0.5, -1.0, 0.0), 0.5, 0.3, 8.0, (-5.0, 5.0)), seed)
    loop.setpoint = 1.0
    loop.run(after)
    return loop


@pytest.mark.parametrize(("after", "rest"), [(0.8, 0.64), (10.0, 0.0)])
def test_the_rest_is_learnt_from_where_the_loop_was_on_its_way(after: float, rest: float) -> None:
    loop = on_its_way(after, 97)
    made = ClosedLoopExperiment(loop, loop, LoopBaseline(read_running_controller(loop)), EXPERIMENT)  # type: ignore[arg-type]
    made.measure()
    assert made.newest - made.learnt_since == pytest.approx(rest, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(("after", "seed"), [(1.8398867424695577, 33), (0.8252505694195889, 97)])
def test_gains_are_not_livelier_for_a_loop_that_was_still_on_its_way(after: float, seed: int) -> None:
    """It was within a tenth of what is allowed; taken for a rest, its way was taken for an answer to small moves."""
    loop = on_its_way(after, seed)
    outcome = Autotuner(loop, loop, AutotuneRequest(EXPERIMENT, "all", CRITERIA, False), loop).run()  # type: ignore[arg-type]
    assert outcome.applied, outcome.message
    held = Loop(TRUE, loop.gains())
    assert stability(held).stable
    assert margins(held).ms < 2.0
