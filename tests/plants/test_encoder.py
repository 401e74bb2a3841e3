"""Between two lines of an encoder a loop moves its control for ever, unless what the lines hide counts as none."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from compare import autotuned
from foreign_plants.gallery import GALLERY
from foreign_plants.motion import MotorPosition
from foreign_plants.parts import Sensor
from virtual_loop import VirtualLoop

from fopid_core.design.identification.identify import identify
from fopid_core.design.identification.noise import hidden_by_steps
from fopid_core.design.robust_verification import RobustLimits
from fopid_core.design.specification import TuningRequest
from fopid_core.design.sufficiency import Sufficiency
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process
from fopid_ros.tuner.learning.autotune import Autotuner
from fopid_ros.tuner.learning.autotune_request import AutotuneRequest
from fopid_ros.tuner.learning.closed_loop_experiment import ClosedLoopExperiment, ExperimentSettings
from fopid_ros.tuner.learning.gain_update import AcceptanceCriteria, GainUpdate, Outcome
from fopid_ros.tuner.learning.loop_baseline import LoopBaseline
from fopid_ros.tuner.learning.running_controller import read_running_controller

MOTOR, STEP = GALLERY["motor_position"], 2.0 * math.pi / 4096.0


class NoisyMotor(MotorPosition):
    """With a potentiometer of twelve bits for the encoder."""

    def make_sensor(self) -> Sensor:
        return Sensor(noise=STEP, step=STEP)


class CoarseMotor(MotorPosition):
    """With steps of four times the noise."""

    def make_sensor(self) -> Sensor:
        return Sensor(noise=0.25 * STEP, step=STEP)


@pytest.mark.parametrize(("move", "load"), [(0.5, 0.3), (0.37, -0.2), (0.62, 0.45)])
def test_a_deadband_of_half_a_line_ends_the_chatter_for_hardly_more_error(move: float, load: float) -> None:
    seen = []
    for deadband in (0.0, 0.5 * STEP):
        loop = VirtualLoop(MOTOR)
        loop.set(
            gains=Fopid(11.5, 290.0, 0.04), measurement_filter_order=2, measurement_filter_time=4e-4,
            setpoint_weight=0.4, derivative_setpoint_weight=0.0, deadband=deadband,
        )  # fmt: skip
        loop.setpoint += move
        loop.run(1.0)
        loop.plant.load = load
        _, setpoint, true, control = loop.trace.part(loop.run(2.0))
        seen.append((np.abs(np.diff(control)).sum(), np.abs(setpoint - true)[-500:].mean()))
    (chatter, _), (calm, error) = seen
    assert calm < 0.6 * chatter
    assert error < STEP


@pytest.mark.parametrize(("plant", "hidden"), [(MotorPosition, 0.5 * STEP), (NoisyMotor, 0.0), (CoarseMotor, 0.0)])
def test_steps_hide_nothing_where_there_is_more_noise(plant: type[MotorPosition], hidden: float) -> None:
    loop = VirtualLoop(replace(MOTOR, plant=plant), 3)
    loop.run(1.0)
    noise = float(np.std(loop.history.newest_values("measurement", 500)))
    loop.setpoint += 0.2
    loop.run(1.0)
    assert hidden_by_steps(loop.history.newest_values("measurement", 1000), noise) == pytest.approx(hidden)


@pytest.mark.slow
def test_a_proposal_tells_of_it_and_sets_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Sufficiency, "look", lambda *_: True)
    monkeypatch.setattr(GainUpdate, "design", lambda *_, **__: Outcome(success=True, message="better gains"))
    criteria = AcceptanceCriteria(TuningRequest(Process.parse("1/(s+1)")), RobustLimits(), 2.0, compare=True)
    loop = VirtualLoop(MOTOR)
    loop.run(1.0)
    request = AutotuneRequest(ExperimentSettings(), "all", criteria, propose_only=True)
    told = Autotuner(loop, loop, request, loop).run().message  # type: ignore[arg-type]
    assert told == "better gains; errors up to 0.000767 are to count as none (deadband), half a step of the measurement"
    assert loop.tuned_settings()["deadband"] == 0.0


@pytest.mark.slow
def test_moves_of_a_few_lines_show_an_integrator_and_nothing_that_runs_away() -> None:
    """The best of all models needs a longer record; one with fewer numbers does not, and explains hardly less."""
    loop = VirtualLoop(MOTOR, 1)
    loop.run(0.5 * MOTOR.horizon)
    made = ClosedLoopExperiment(loop, loop, LoopBaseline(read_running_controller(loop)), ExperimentSettings())  # type: ignore[arg-type]
    made.measure()
    began = loop.history.newest_time("control")
    assert not made.excite()
    record = loop.history.record(began)
    found = identify(record.part(record.time[0], record.time[0] + 20.7), noise=STEP / math.sqrt(12.0))
    assert found.success, found.message
    assert found.best is not None
    assert not found.best.structure.runs_away, found.message


@pytest.mark.long
@pytest.mark.timeout(900)
def test_autotuning_a_motor_behind_an_encoder_sets_it() -> None:
    """21 of the control's movement without; less than half the load's error of SIMC's PID, which moves it by 17."""
    found = autotuned("motor_position")
    assert "count as none (deadband), half a step of the measurement" in found.note
    assert found.seen.load < 0.5 * 0.0167
    assert found.seen.variation < 14.0
