"""A plant that nobody has described is driven, learnt, tuned and handed over; or left as it was, with the reason."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from sensor_msgs.msg import Temperature
from std_msgs.msg import Float64

from fopid_core.design.certificate.checker import check
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import read_process
from fopid_core.model.stability import stability
from fopid_msgs.action import Autotune
from fopid_msgs.msg import ScalarStamped, TuningResult
from fopid_ros.common.managed_node import latched_qos

from ...patience import FACTOR
from ..conftest import SETTLE, Graph

GAINS = ("kp", "ki", "kd", "lam", "mu")
REMAPS = ("-r", "measurement:=sensor", "-r", "control:=actuator")
PI = {"kp": 0.5, "ki": 1.0}


def _types(type_name: str, field: str) -> dict[str, object]:
    return {f"{signal}.{key}": value for signal in ("measurement", "control")
            for key, value in (("type", type_name), ("field", field))}  # fmt: skip


class ForeignLoop:
    """The foreign plant under a hand-made PI, and a tuner that knows nothing."""

    def __init__(
        self, graph: Graph, kind: str, gains: Mapping[str, float], *, steps: bool = True,
        setpoint: float | None = 1.0, **tuner: object,
    ) -> None:  # fmt: skip
        self.graph = graph
        self.plant = graph.run_script(Path(__file__).with_name("foreign_plant.py"), kind, *["steps"] * steps)
        message = Temperature if steps else Float64
        types = _types(*("sensor_msgs/msg/Temperature", "temperature") if steps else ("std_msgs/msg/Float64", "data"))
        trigger = {"trigger": "lockstep"} if steps else {}
        graph.start("fopid_controller", {**gains, **types, **trigger, "use_sim_time": steps}, *REMAPS)
        self.tuner = graph.start("fopid_tuner", {**types, **tuner, "use_sim_time": steps}, *REMAPS)
        self._field = "temperature" if steps else "data"
        self._sensed = graph.listen(message, "sensor")
        self.added = graph.listen(ScalarStamped, "feedforward")
        self.feedback: list[Any] = []
        self._setpoint = graph.node.create_publisher(ScalarStamped, "setpoint", 1)
        self._client = ActionClient(graph.node, Autotune, "fopid_tuner/autotune")
        graph.until(self._client.server_is_ready, "the action")
        graph.until(self._setpoint.get_subscription_count, "the controller")
        graph.spin(SETTLE)
        if setpoint is not None:
            self.move_setpoint(setpoint)
        graph.until(lambda: self._sensed, "the plant")

    @property
    def sensed(self) -> list[float]:
        """What the plant has measured so far."""
        return [getattr(message, self._field) for message in self._sensed]

    def autotune(self, **goal: Any) -> Any:
        """Send a goal; the accepted goal's handle. By one method, unless told otherwise, since comparing takes long."""
        sent = self._client.send_goal_async(
            Autotune.Goal(**{"method": "frequency", **goal}),
            feedback_callback=lambda m: self.feedback.append(m.feedback),
        )
        return self.graph.result(sent)

    def outcome(self, handle: Any, patience: float = 200.0 * FACTOR) -> Any:
        return self.graph.result(handle.get_result_async(), patience)

    def move_setpoint(self, value: float) -> None:
        self._setpoint.publish(ScalarStamped(value=value))

    def gains(self) -> list[float]:
        return self.graph.get("fopid_controller", *GAINS)

    def until_at_rest(self) -> None:
        def rests() -> bool:
            newest = self.sensed[-50:]
            return len(newest) == 50 and all(abs(value - 1.0) < 0.05 for value in newest)

        self.graph.until(rests, "the loop rests at its setpoint")


@pytest.fixture
def loops(graph: Graph) -> Any:
    return partial(ForeignLoop, graph)


@pytest.mark.slow
def test_an_unknown_plant_is_learnt_tuned_and_handed_over(loops: Any) -> None:
    loop = loops("saturating", PI, steps=False)
    handle = loop.autotune(deviation_max=0.3, duration=8.0)
    done = loop.outcome(handle)
    result = done.result
    assert result.success, result.message
    assert done.status == GoalStatus.STATUS_SUCCEEDED
    assert result.applied
    assert not result.rolled_back
    gains = loop.gains()
    assert gains == [getattr(result.gains, name) for name in GAINS]
    assert [result.previous_gains.kp, result.previous_gains.ki] == [PI["kp"], PI["ki"]]
    true = Loop(read_process("1/((0.4s+1)(0.1s+1))*exp(-0.015s)"), Fopid(*gains))
    assert stability(true).stable
    assert margins(true).ms < 2.5
    phases = [f.phase for f in loop.feedback]
    heard = sorted(set(phases) - {"measuring"}, key=phases.index)  # which is over soon after a rest
    assert heard == ["exciting", "identifying", "tuning", "verifying", "applying", "watching"]
    assert loop.added[-1].value == 0.0
    assert loop.graph.get("fopid_tuner", "process") == [result.model.process]
    told = loop.graph.listen(TuningResult, "fopid_tuner/result", latched_qos())
    loop.graph.until(lambda: told, "the result")
    assert told[0].applied
    (used,) = [one for one in result.proposals if one.gains == result.gains]
    assert told[0].two_degrees == used.two_degrees
    loop.until_at_rest()


@pytest.mark.slow
@pytest.mark.parametrize("excitation", ["relay", "step"])
def test_each_kind_of_experiment_tells_enough(loops: Any, excitation: str) -> None:
    loop = loops("reversed", {"kp": -0.5, "ki": -1.0})
    result = loop.outcome(loop.autotune(excitation=excitation, deviation_max=0.2, duration=8.0)).result
    assert result.success, result.message
    true = Loop(read_process("-1.5/((0.4s+1)(0.1s+1))*exp(-0.015s)"), Fopid(*loop.gains()))
    assert stability(true).stable
    assert margins(true).ms < 2.5
    announced = [f.remaining for f in loop.feedback if f.phase == "exciting" and f.message.startswith(excitation)]
    assert max(announced) == pytest.approx(8.0, rel=0.3)  # a relay's is the longest it may take


def test_cancelling_puts_everything_back(loops: Any) -> None:
    loop = loops("saturating", PI)
    before = loop.gains()
    handle = loop.autotune(deviation_max=0.3, duration=30.0)
    loop.graph.until(lambda: loop.feedback and loop.feedback[-1].phase == "exciting", "the experiment")
    loop.graph.until(lambda: any(m.value for m in loop.added), "the excitation")
    loop.graph.result(handle.cancel_goal_async())
    done = loop.outcome(handle)
    assert done.status == GoalStatus.STATUS_CANCELED
    assert not done.result.applied
    assert loop.gains() == before
    assert loop.added[-1].value == 0.0
    loop.until_at_rest()


@pytest.mark.slow
def test_moves_that_are_too_large_shrink_before_the_measurement_leaves_its_band(loops: Any) -> None:
    loop = loops("saturating", PI)
    handle = loop.autotune(amplitude=1.0, deviation_max=0.2, duration=8.0)
    loop.graph.until(lambda: any(m.value for m in loop.added), "the excitation")
    began = len(loop.sensed)
    loop.outcome(handle)
    assert max(abs(value - 1.0) for value in loop.sensed[began:]) < 0.2
    assert {round(abs(m.value), 3) for m in loop.added} > {0.0, 0.5, 1.0}
    assert loop.added[-1].value == 0.0


@pytest.mark.slow
def test_a_tuner_that_is_stopped_takes_its_excitation_back(loops: Any) -> None:
    loop = loops("saturating", PI)
    loop.autotune(deviation_max=0.3, duration=30.0)
    loop.graph.until(lambda: any(m.value for m in loop.added), "the excitation")
    loop.tuner.terminate()
    loop.tuner.wait(20)
    loop.graph.until(lambda: loop.added[-1].value == 0.0, "the excitation is taken back")
    assert loop.tuner.returncode == 0
    assert "Traceback" not in loop.tuner.log.read_text()


BAD_GOALS = [
    ({"excitation": "kick"}, "excitation = 'kick'"),
    ({"amplitude": -1.0}, "amplitude = -1.0"),
    ({"duration": float("nan")}, "duration = nan"),
    ({"method": "magic"}, "'magic'"),
    ({"template_name": "nioptd7"}, "nioptd7"),
]


def test_what_cannot_be_done_is_named_and_nothing_moves(loops: Any) -> None:
    loop = loops("saturating", PI)
    for goal, named in BAD_GOALS:
        done = loop.outcome(loop.autotune(**goal))
        assert done.status == GoalStatus.STATUS_ABORTED
        assert named in done.result.message
    loop.graph.node.create_publisher(ScalarStamped, "feedforward", 1)
    loop.graph.spin(1.0)
    assert "feedforward is published by /tester" in loop.outcome(loop.autotune()).result.message
    loop.graph.node.create_publisher(Temperature, "actuator", 1)
    loop.graph.spin(1.0)
    refused = loop.outcome(loop.autotune()).result.message
    assert "control is published by /fopid_controller and /tester; allowed: one publisher each" in refused
    assert not any(m.value for m in loop.added)


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("kind", "gains", "process"),
    [
        ("tank", PI, "4/((2s+1)(0.05s+1))"),
        ("quantised", PI, "2/((0.3s+1)(0.1s+1))"),
        ("dead_band", PI, "1/((0.3s+1)(0.08s+1))"),
        ("integrating", {"kp": 2.0, "ki": 0.4}, "1/(s(0.1s+1))"),
        ("oscillating", {"kp": 0.02, "ki": 0.6}, "36/(s^2+0.96s+36)"),
        ("delayed", {"kp": 0.2, "ki": 0.8}, "1/(0.05s+1)*exp(-0.5s)"),
        ("reversed", {"kp": -0.5, "ki": -1.0}, "-1.5/((0.4s+1)(0.1s+1))"),
    ],
)
def test_a_plant_unlike_the_models_is_tuned_well_or_refused(loops: Any, kind: str, gains: dict, process: str) -> None:
    loop = loops(kind, gains)
    before = loop.gains()
    result = loop.outcome(loop.autotune(deviation_max=0.15, duration=8.0)).result
    assert result.message
    if result.applied:
        true = Loop(read_process(process).delayed(0.015), Fopid(*loop.gains()))
        assert stability(true).stable
        assert margins(true).ms < 3.0
    else:
        assert not result.success
        assert loop.gains() == before
    assert loop.added[-1].value == 0.0
    loop.until_at_rest()


@pytest.mark.long
@pytest.mark.timeout(900)
def test_a_plant_that_integrates_has_a_second_round_and_what_ran_before_the_first_is_told(loops: Any) -> None:
    """The start gains hold back what is tried first; in the plan, the feedback and the result it is one tuning."""
    began = {"kp": 0.5, "ki": 0.1}
    loop = loops("integrating", began)
    handle = loop.autotune(method="", deviation_max=0.15)
    result = loop.outcome(handle, patience=600.0 * FACTOR).result
    assert result.success, result.message
    assert result.applied
    assert "second round" in result.message
    assert "once more with the new gains" in result.plan[-1]
    phases = [f.phase for f in loop.feedback]
    turns = [phase for before, phase in zip(["", *phases[:-1]], phases, strict=True) if phase != before]
    assert turns.count("exciting") >= 2
    assert turns.count("watching") >= 1
    begins = {"": 0.0, "second round": 0.5, "proof": 0.95}
    rounds = [next(name for name in reversed(begins) if f.message.startswith(name)) for f in loop.feedback]
    assert [name for name, _ in itertools.groupby(rounds)] == list(begins)
    assert all(f.progress >= begins[name] for f, name in zip(loop.feedback, rounds, strict=True))
    assert [result.previous_gains.kp, result.previous_gains.ki] == list(began.values())
    assert loop.gains() == [getattr(result.gains, name) for name in GAINS]
    true = Loop(read_process("1/(s(0.1s+1))").delayed(0.015), Fopid(*loop.gains()))
    assert stability(true).stable
    assert loop.added[-1].value == 0.0


@pytest.mark.slow
def test_a_plant_that_does_not_answer_is_refused(loops: Any) -> None:
    loop = loops("stuck", PI)
    result = loop.outcome(loop.autotune(deviation_max=0.2, duration=5.0)).result
    assert not result.success
    assert "off the setpoint" in result.message


@pytest.mark.long
@pytest.mark.timeout(600)
def test_gains_are_handed_over_with_a_proof_for_all_that_the_record_leaves_possible(loops: Any) -> None:
    loop = loops("reversed", {"kp": -0.5, "ki": -1.0}, **{"verify.region": "ellipsoid", "verify.worst_ms_max": 2.5})
    loop.until_at_rest()
    result = loop.outcome(loop.autotune(deviation_max=0.2, duration=8.0)).result
    assert result.applied, result.message
    [proof] = loop.graph.get("fopid_controller", "gains.certificate")
    assert check(proof) == ""
    proved = json.loads(proof)
    assert proved["gains"] == loop.gains()
    assert proved["region"] == "ball"
    assert proved["claims"]["stable"]
    assert proved["claims"]["share"] == 1.0
    assert proved["claims"]["ms_max"] == pytest.approx(2.5, rel=2e-6)
    true = Loop(read_process("-1.5/((0.4s+1)(0.1s+1))*exp(-0.015s)"), Fopid(*loop.gains()))
    assert stability(true).stable
    assert margins(true).ms < 2.5
