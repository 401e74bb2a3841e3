"""The controller's parameters: described, checked as a whole, swapped between two ticks, saved."""

from __future__ import annotations

import math
from dataclasses import MISSING, fields
from pathlib import Path

import pytest
import yaml
from rcl_interfaces.srv import DescribeParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from std_srvs.srv import Trigger

from fopid_core.runtime.controller import ControllerSettings
from fopid_core.study.experiments.loop_parameters import controller_settings as offline_settings
from fopid_msgs.msg import ScalarStamped
from fopid_ros.common.parameter_file import write_parameter_file
from fopid_ros.common.signals import SignalType
from fopid_ros.controller.parameters import SPECS
from fopid_ros.controller.parameters import controller_settings as node_settings

from ...core.cli.runner import invoke
from ..conftest import Graph, LockstepLoop
from .fed import FedController, LockstepByHand

NAME = "fopid_controller"


def test_every_setting_of_the_core_is_a_parameter_with_the_same_default() -> None:
    specs = {spec.name: spec for spec in SPECS}
    for field in fields(ControllerSettings):
        if field.name == "gains":
            assert {"kp", "ki", "kd", "lam", "mu"} <= set(specs)
        elif field.name == "band":
            assert {"band.low", "band.high", "band.poles"} <= set(specs)
        elif field.name == "on_trial":
            assert (specs["gains.status"].default == "trial") == field.default
        else:
            assert field.default is not MISSING
            assert specs[field.name].default == field.default
            assert type(specs[field.name].default) is type(field.default)


@pytest.mark.parametrize(
    "given", [{"kp": 2.0}, {"horizon": 50.0}, {"band.low": 1e-7}, {"band.high": 30.0, "horizon": 900.0}]
)
def test_the_node_runs_the_settings_that_the_offline_simulation_takes_from_the_same_names(given: dict) -> None:
    values = {spec.name: spec.default for spec in SPECS} | given
    assert node_settings(values, SignalType()) == offline_settings(given, values["sample_time"])


def test_every_parameter_is_described_with_what_is_allowed(graph: Graph) -> None:
    graph.start(NAME, {})
    names = [spec.name for spec in SPECS]
    request = DescribeParameters.Request(names=names)
    described = graph.call(DescribeParameters, f"{NAME}/describe_parameters", request).descriptors
    told = dict(zip(names, described, strict=True))
    assert all(descriptor.description for descriptor in described)
    (orders,) = told["lam"].floating_point_range
    assert (orders.from_value, orders.to_value) == (0.0, 2.0)
    (poles,) = told["band.poles"].integer_range
    assert (poles.from_value, poles.to_value) == (0, 60)
    (gain,) = told["kp"].floating_point_range
    assert (gain.from_value, gain.to_value) == (-10.0, 10.0)
    assert graph.set(NAME, kp=25.0).successful
    request = DescribeParameters.Request(names=["kp"])
    ((gain,),) = (d.floating_point_range for d in graph.call(DescribeParameters, f"{NAME}/describe_parameters",
                                                             request).descriptors)  # fmt: skip
    assert gain.from_value < 25.0 < gain.to_value
    assert "0 to inf" in told["control_rate_max"].additional_constraints
    assert "-1 to 1e+09" in told["measurement_timeout"].additional_constraints
    assert "hold, safe, manual" in told["on_stale"].additional_constraints
    assert "unconfigured" in told["sample_time"].additional_constraints
    assert not told["sample_time"].read_only


def test_a_rejected_set_changes_nothing_says_why_and_the_loop_runs_on(graph: Graph) -> None:
    loop = LockstepLoop(graph, "P1", {"kp": 1.0, "ki": 0.4})
    loop.publish("setpoint", 1.0)
    loop.advance(1.0)
    for changes, told in (
        ({"kp": 3.0, "lam": 2.5}, "lam = 2.5; allowed: 0 to 2"),
        ({"kp": math.nan}, "kp = nan; allowed"),
        ({"kp": "3"}, "kp = '3'; allowed: a number"),
        ({"kp": 3.0, "control_min": 5.0, "control_max": 1.0}, "control_min = 5.0, control_max = 1.0"),
        ({"kp": 3.0, "safe_control": 5.0, "control_max": 1.0}, "safe_control = 5.0"),
        ({"kp": 3.0, "control_rate_max": 0.0}, "control_rate_max = 0.0"),
        ({"kp": 3.0, "band__low": 10.0, "band__high": 1.0}, "band"),
        ({"kp": 3.0, "sample_time": 0.1}, "sample_time = 0.1; allowed: 0.01 until the node is cleaned up"),
        ({"kp": 3.0, "autostart": False}, "read-only parameter: autostart"),
        ({"kp": 3.0, "kpp": 1.0}, "no parameter 'kpp'; did you mean 'kp'"),
        ({"kp": 3.0, "antiwindup": "clamp"}, "antiwindup = 'clamp'; allowed: none, back_calculation"),
    ):
        answer = graph.set(NAME, **changes)
        assert not answer.successful
        assert told in answer.reason
        assert graph.get(NAME, "kp") == [1.0]
    loop.advance(2.0)
    assert len(loop.controls) == 200
    assert {state.kp for state in loop.states} == {1.0}


def test_a_set_is_in_force_from_the_next_tick_on_whole(graph: Graph) -> None:
    loop = LockstepByHand(graph, {"kp": 1.0, "bumpless": False})
    loop.send("setpoint", 1.0)
    assert loop.tick(0, 0.5) == 0.5
    assert graph.set(NAME, kp=4, control_max=1.5).successful  # a whole number serves as a number
    assert loop.tick(1, 0.5) == 1.5
    assert (loop.states[-1].kp, loop.states[-1].control_unlimited, loop.states[-1].saturated) == (4.0, 2.0, True)


def test_changes_are_told_to_standard_tools_and_a_rejected_one_to_the_diagnostics(graph: Graph) -> None:
    fed = FedController(graph, {"kp": 1.0})
    changes = graph.changes(NAME)
    assert graph.set(NAME, kp=2.0, ki=0.5).successful
    graph.until(lambda: {"kp": 2.0, "ki": 0.5} in changes, "one event with both")
    assert not graph.set(NAME, lam=3.0).successful
    graph.until(lambda: "lam = 3.0" in fed.facts.get("last rejected parameter set", ""), "a diagnosis")


def test_saved_gains_and_everything_else_are_read_by_a_restart(graph: Graph, tmp_path: Path) -> None:
    file = tmp_path / "gains.yaml"
    place = {"directory": str(tmp_path), "gains_file": file.name}
    started = graph.start(NAME, {"kp": 1.0, **place, "qos_overrides./hall/control.publisher.depth": 3},
                          "-r", "__ns:=/hall")  # fmt: skip
    name = f"/hall/{NAME}"
    changes = {"kp": 2.5, "ki": 0.25, "lam": 1.25, "control_max": 7.0, "on_stale": "safe", "band.poles": 12}
    assert graph.set(name, **{key.replace(".", "__"): value for key, value in changes.items()}).successful
    answer = graph.call(Trigger, f"{name}/save_gains")
    assert (answer.success, answer.message) == (True, file.name)
    every = [spec.name for spec in SPECS]
    before = graph.get(name, *every)
    started.terminate()
    assert started.wait(10) == 0
    graph.until(lambda: not graph.node.count_publishers("/hall/control"), "its end")

    graph.start(NAME, {}, "--params-file", str(file), "-r", "__ns:=/hall")
    graph.until(lambda: graph.node.count_publishers("/hall/control"), "the restart")
    graph.spin(0.3)
    assert graph.get(name, *every) == before
    assert graph.get(name, *changes) == list(changes.values())
    assert graph.get(name, "qos_overrides./hall/control.publisher.depth") == [3]


def test_a_dump_is_loaded_as_a_whole_or_not_at_all(graph: Graph, tmp_path: Path) -> None:
    """As ``ros2 param dump`` and ``ros2 param load`` do it: the same call of rclpy, and the same request."""
    graph.start(NAME, {"kp": 1e-05, "ki": 2.0, "control_rate_max": 1e22, "setpoint.initial": 1.0})
    client = graph.parameters(NAME)
    names = list(graph.result(client.list_parameters()).result.names)
    assert {"autostart", "use_sim_time", "control_max", "qos_overrides./control.publisher.depth"} <= set(names)
    before = graph.get(NAME, *names)

    def load(**changes: object) -> list:
        file, values = tmp_path / "dump.yaml", dict(zip(names, before, strict=True)) | changes
        file.write_text(yaml.safe_dump({f"/{NAME}": {"ros__parameters": values}}))
        return list(graph.result(client.load_parameter_file(str(file))).results)

    assert all(result.successful for result in load())
    assert graph.get(NAME, *names) == before
    # Neither limit is allowed beside the other's old value, whichever comes first.
    assert graph.set(NAME, control_min=-1.0, control_max=1.0).successful
    assert all(result.successful for result in load(control_min=-9.0, control_max=-2.0, safe_control=-3.0, kp=25.0))
    limits = ("control_min", "control_max", "safe_control", "kp")
    assert graph.get(NAME, *limits) == [-9.0, -2.0, -3.0, 25.0]
    refused = load(kp=3.0, lam=5.0, sample_time=0.01)
    assert [result.reason for result in refused] == ["lam = 5.0; allowed: 0 to 2"] * len(names)
    assert graph.get(NAME, *limits) == [-9.0, -2.0, -3.0, 25.0]
    assert not any(result.successful for result in load(autostart=False, kp=3.0))


def test_what_the_node_saves_is_what_the_export_reads(tmp_path: Path) -> None:
    values = {spec.name: spec.default for spec in SPECS} | {"kp": 2.0, "lam": 0.9, "band.poles": 9, "bumpless": False}
    always = {"use_sim_time": False, "start_type_description_service": True, "autostart": True}
    overrides = {"qos_overrides./control.publisher.depth": 3}
    write_parameter_file(tmp_path / "saved.yaml", "/loop/controller", always | values | overrides)
    arguments = ["export", "--params", str(tmp_path / "saved.yaml"), "--out", str(tmp_path)]
    result = invoke(arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.stderr
    assert "kp = 2.0, ki = 0.0, kd = 0.0, lam = 0.9" in (tmp_path / "fopid_controller.h").read_text()


def test_gains_that_cannot_be_saved_are_answered_and_the_old_file_stays(graph: Graph, tmp_path: Path) -> None:
    graph.start(NAME, {"kp": 1.0, "directory": str(tmp_path)})
    answer = graph.call(Trigger, f"{NAME}/save_gains")
    assert not answer.success
    assert "gains_file = ''" in answer.message
    assert graph.set(NAME, gains_file="gains.yaml").successful
    assert graph.call(Trigger, f"{NAME}/save_gains").success
    (tmp_path / "folder").mkdir()
    assert graph.set(NAME, gains_file="folder", kp=2.0).successful
    answer = graph.call(Trigger, f"{NAME}/save_gains")
    assert not answer.success
    assert "not a file" in answer.message
    assert yaml.safe_load((tmp_path / "gains.yaml").read_text())[f"/{NAME}"]["ros__parameters"]["kp"] == 1.0


def test_the_qos_of_each_loop_topic_can_be_overridden(graph: Graph) -> None:
    graph.start(NAME, {
        "qos_overrides./control.publisher.reliability": "best_effort",
        "qos_overrides./control.publisher.depth": 7,
        "qos_overrides./measurement.subscription.reliability": "reliable",
        "qos_overrides./fopid_controller/state.publisher.durability": "transient_local",
    })  # fmt: skip
    node = graph.node
    graph.until(lambda: node.count_publishers(f"/{NAME}/state") and node.count_subscribers("/measurement"), "it")
    (control,) = node.get_publishers_info_by_topic("/control")
    (measurement,) = node.get_subscriptions_info_by_topic("/measurement")
    (state,) = node.get_publishers_info_by_topic(f"/{NAME}/state")
    assert control.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    assert measurement.qos_profile.reliability == ReliabilityPolicy.RELIABLE
    assert state.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    named = [f"qos_overrides./{topic}.subscription.depth" for topic in ("setpoint", "feedforward", "manual_control")]
    assert graph.get(NAME, "qos_overrides./control.publisher.depth", *named) == [7, 1, 1, 1]


def test_what_the_actuators_message_can_hold_limits_the_control(graph: Graph) -> None:
    from std_msgs.msg import UInt8

    controls = graph.listen(UInt8, "control")
    graph.start(NAME, {"kp": 100.0, "ki": 10.0, "control.type": "std_msgs/msg/UInt8", "control.field": "data"})
    measurement = graph.node.create_publisher(ScalarStamped, "measurement", 1)
    setpoint = graph.node.create_publisher(ScalarStamped, "setpoint", 1)

    def answers(error: float, control: int) -> bool:
        measurement.publish(ScalarStamped(value=0.0))
        setpoint.publish(ScalarStamped(value=error))
        return bool(controls) and controls[-1].data == control

    graph.until(lambda: answers(9.0, 255), "the largest")
    graph.until(lambda: answers(-9.0, 0), "the smallest")
    answer = graph.set(NAME, safe_control=-1.0)
    assert not answer.successful
    assert "control_min to control_max, 0 to 255" in answer.reason


def test_what_the_actuator_did_is_taken_from_the_topic_tracking_when_told_to(graph: Graph) -> None:
    loop = LockstepByHand(graph, {"kp": 1.0, "control_rate_max": 10.0, "tracking.enabled": True})
    tracking = graph.node.create_publisher(ScalarStamped, "tracking", 1)
    graph.until(tracking.get_subscription_count, "the controller")
    graph.spin(0.3)
    loop.send("setpoint", 5.0)
    assert loop.tick(0, 0.0) == pytest.approx(0.1)  # from rest, at 10 per second
    tracking.publish(ScalarStamped(value=2.0))
    graph.spin(0.2)
    assert loop.tick(1, 0.0) == pytest.approx(2.1)  # from where the actuator is
    assert loop.states[-1].tracking == 2.0
    assert not graph.set(NAME, tracking__enabled=False).successful  # it is read at configure


def test_parameters_of_rclpy_itself_can_be_set_beside_ours(graph: Graph) -> None:
    graph.start(NAME, {"kp": 1.0})
    client = graph.parameters(NAME)
    changes = [Parameter("use_sim_time", value=True), Parameter("kp", value=2.0)]
    assert graph.result(client.set_parameters_atomically(changes)).result.successful
    assert graph.get(NAME, "kp", "use_sim_time") == [2.0, True]


def test_a_setpoint_given_as_parameter_holds_until_another_comes(graph: Graph) -> None:
    loop = LockstepLoop(graph, "P1", {"kp": 2.0, "setpoint.initial": 0.5})
    loop.advance(0.02)
    assert loop.controls[0].value == 1.0
    loop.publish("setpoint", 1.0)
    loop.advance(0.05)
    assert loop.controls[-1].value > 1.9
