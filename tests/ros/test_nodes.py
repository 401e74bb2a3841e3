"""The nodes are ordinary ROS 2 nodes, and every bad input ends well."""

from __future__ import annotations

import importlib
import math
import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Temperature
from std_msgs.msg import Float64
from std_srvs.srv import SetBool

from fopid_msgs.msg import FopidState, ScalarStamped
from fopid_msgs.srv import Advance

from .conftest import BIN, Graph, LockstepLoop
from .node_process import MODULES

CONFIG = Path(__file__).parents[2] / "config"


@pytest.mark.parametrize(
    ("executable", "parameter", "named"),
    [
        ("fopid_controller", "kpp:=1.0", ["no parameter 'kpp'", "'kp'"]),
        ("fopid_controller", "kp:=abc", ["kp = 'abc'", "a number"]),
        ("fopid_controller", "kp:=.nan", ["kp = nan"]),
        ("fopid_controller", "lam:=2.5", ["lam = 2.5", "0 to 2"]),
        ("fopid_controller", "sample_time:=0.0", ["sample_time = 0.0"]),
        ("fopid_controller", "band.low:=1e6", ["band.low = 1000000.0"]),
        ("fopid_controller", "mode:=automatic", ["'automatic'", "auto, manual"]),
        ("fopid_controller", "measurement.type:=foo/msg/Bar", ["'foo/msg/Bar'"]),
        ("fopid_controller", "measurement.field:=temperature", ["'temperature'", "value"]),
        ("plant_simulator", "process:='9/((s+1)(s^2+2s+9)'", ["character 19", "')'"]),
        ("plant_simulator", "process:='1/(s+x)'", ["character 6", "'x'"]),
        ("plant_simulator", "process:=''", ["empty"]),
        ("plant_simulator", "process:='s/1'", ["not proper"]),
        ("plant_simulator", "process:='1/(s*exp(-s)+1)'", ["advanced type"]),
        ("plant_simulator", "pade_order:=0", ["pade_order = 0"]),
        ("plant_simulator", "noise_std:=-1.0", ["noise_std = -1.0"]),
        ("fopid_tuner", "process:='1/(s+x)'", ["character 6"]),
        ("fopid_tuner", "method:=guess", ["'guess'", "frequency, time, rule"]),
    ],
)
def test_a_bad_start_is_one_line_that_names_the_input(
    graph: Graph, executable: str, parameter: str, named: list
) -> None:
    ended = subprocess.run([BIN / executable, "--ros-args", "-p", parameter], env=graph.environment, timeout=100,
                           capture_output=True, text=True, check=False)  # fmt: skip
    assert ended.returncode == 2
    (line,) = [line for line in ended.stderr.splitlines() if line.startswith("error: ")]
    assert all(word in line for word in named), line
    assert "Traceback" not in ended.stderr


@pytest.mark.parametrize(
    ("executable", "arguments", "said"),
    [
        (
            "fopid_controller",
            ["--kp", "2"],
            "argument '--kp'; allowed: --help, and parameters as in --ros-args -p kp:=V",
        ),
        ("plant_simulator", ["P1", "--ros-args", "-p", "seed:=1"], "argument 'P1'"),
        ("fopid_tuner", ["--ros-args", "--", "--process=P1"], "-p process:=VALUE"),
        ("fopid_controller", ["--ros-args", "kp:=2.0"], "['kp:=2.0'] behind --ros-args; allowed: -p NAME:=VALUE"),
    ],
)
def test_an_argument_that_a_node_does_not_have_is_refused(
    executable: str, arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert importlib.import_module(MODULES[executable]).main(arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line


@pytest.mark.parametrize("domain", ["233", "abc"])
def test_a_domain_that_cannot_be_used_is_named(graph: Graph, domain: str) -> None:
    environment = {**graph.environment, "ROS_DOMAIN_ID": domain}
    ended = subprocess.run([BIN / "plant_simulator"], env=environment, timeout=100, capture_output=True, text=True,
                           check=False)  # fmt: skip
    assert ended.returncode == 2
    assert "ROS_DOMAIN_ID" in ended.stderr
    assert "Traceback" not in ended.stderr


@pytest.mark.parametrize(
    ("changes", "argument", "told"),
    [
        ({"HOME": None, "ROS_LOG_DIR": None, "ROS_HOME": None}, "kp:=1.0", "as HOME or as ROS_LOG_DIR"),
        ({"HOME": "/proc/1", "ROS_LOG_DIR": None, "ROS_HOME": None}, "kp:=1.0", "as HOME or as ROS_LOG_DIR"),
        ({"LC_ALL": "POSIX", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}, "directory:=/tmp/Maß", "LC_ALL=C.UTF-8"),
    ],
    ids=["no home", "a home that cannot be written", "a locale without umlauts"],
)
def test_surroundings_that_do_not_do_are_told_in_one_line(
    graph: Graph, changes: dict[str, str | None], argument: str, told: str
) -> None:
    environment = {name: value for name, value in {**graph.environment, **changes}.items() if value is not None}
    command = [BIN / "fopid_controller", "--ros-args", "-p", argument]
    ended = subprocess.run(command, env=environment, timeout=100, capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    (line,) = [line for line in ended.stderr.splitlines() if line.startswith("error: ")]
    assert told in line
    assert "Traceback" not in ended.stderr


@pytest.mark.parametrize("executable", sorted(MODULES))
def test_help_tells_what_can_be_set(executable: str, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    main = importlib.import_module(MODULES[executable]).main
    for asked in ("-h", "--help"):
        monkeypatch.setattr(sys, "argv", [executable, asked])
        with suppress(SystemExit):  # with code 0, by argparse
            assert main() == 0
        assert "usage" in capsys.readouterr().out.lower()


@pytest.mark.parametrize("name", ["P1", *[pytest.param(name, marks=pytest.mark.slow) for name in ("P2", "P3", "P4")]])
def test_parameter_files_serve_all_three_nodes_in_any_namespace(graph: Graph, name: str) -> None:
    more = ["--params-file", str(CONFIG / f"{name}.yaml"), "-r", "__ns:=/hall/seven"]
    for executable in ("plant_simulator", "fopid_controller", "fopid_tuner"):
        graph.start(executable, {}, *more)
    assert graph.get("/hall/seven/plant_simulator", "process") == [name]
    assert graph.get("/hall/seven/fopid_tuner", "process") == [name]
    assert graph.get("/hall/seven/fopid_controller", "kp")[0] > 0.3
    states = graph.listen(FopidState, "/hall/seven/fopid_controller/state")
    setpoint = graph.node.create_publisher(ScalarStamped, "/hall/seven/setpoint", 1)
    graph.until(setpoint.get_subscription_count, "the controller")
    setpoint.publish(ScalarStamped(value=1.0))
    graph.until(lambda: states and states[-1].measurement > 0.01, "a loop that moves")


def test_names_and_topics_can_be_remapped(graph: Graph) -> None:
    graph.start(
        "fopid_controller", {"kp": 2}, "-r", "__node:=temperature_controller", "-r", "measurement:=oven/reading"
    )
    assert graph.get("temperature_controller", "kp") == [2.0]
    graph.until(lambda: graph.node.count_subscribers("/oven/reading"), "the remapped topic")


@pytest.mark.slow
def test_realtime_keeps_its_sample_time(graph: Graph) -> None:
    graph.start("plant_simulator", {"process": "P4"})
    graph.start("fopid_controller", {"kp": 1.4, "ki": 2.6})
    states = graph.listen(FopidState, "fopid_controller/state")
    setpoint = graph.node.create_publisher(ScalarStamped, "setpoint", 1)
    graph.until(setpoint.get_subscription_count, "the controller")
    setpoint.publish(ScalarStamped(value=1.0))
    graph.until(lambda: len(states) > 300, "three seconds of ticks")
    stamps = [state.header.stamp.sec + state.header.stamp.nanosec * 1e-9 for state in (states[0], states[-1])]
    periods, ticks = (stamps[1] - stamps[0]) / 0.01, len(states) - 1
    assert ticks <= periods + 1.0
    assert ticks + states[-1].overruns - states[0].overruns >= 0.9 * periods  # however busy the machine is
    graph.until(lambda: abs(states[-1].measurement - 1.0) < 0.3, "a measurement that follows")


def test_values_that_are_not_finite_never_reach_the_output(graph: Graph) -> None:
    graph.start("fopid_controller", {"kp": 1.0, "ki": 0.4})
    diagnostics = graph.listen(DiagnosticArray, "/diagnostics")
    controls = graph.listen(ScalarStamped, "control")
    states = graph.listen(FopidState, "fopid_controller/state")
    measurement = graph.node.create_publisher(ScalarStamped, "measurement", 10)
    setpoint = graph.node.create_publisher(ScalarStamped, "setpoint", 1)
    graph.until(lambda: measurement.get_subscription_count() and setpoint.get_subscription_count(), "the controller")

    def answered() -> bool:
        measurement.publish(ScalarStamped(value=0.5))
        setpoint.publish(ScalarStamped(value=1.0))
        return bool(controls) and controls[-1].value > 0.5

    graph.until(answered, "a control")
    graph.until(lambda: states, "a state")
    for publisher, value in [(measurement, math.nan), (measurement, math.inf), (measurement, -math.inf),
                             (setpoint, math.nan)]:  # fmt: skip
        before = states[-1].refused

        def refused(publisher=publisher, value=value, before=before) -> bool:
            publisher.publish(ScalarStamped(value=value))
            return states[-1].refused > before

        graph.until(refused, f"{value} of {publisher.topic_name} is refused")

    def counted() -> bool:
        values = {v.key: v.value for v in diagnostics[-1].status[0].values} if diagnostics else {}
        return values.get("other values refused") == str(states[-1].refused)

    graph.until(counted, "diagnostics that count them")
    assert controls
    assert all(math.isfinite(message.value) for message in controls)
    assert controls[-1].value > 0.5


def test_any_message_type_serves_as_a_signal(graph: Graph) -> None:
    graph.start("fopid_controller", {
        "kp": 2.0, "measurement.type": "sensor_msgs/msg/Temperature", "measurement.field": "temperature",
        "control.type": "std_msgs/msg/Float64", "control.field": "data",
    })  # fmt: skip
    controls = graph.listen(Float64, "control")
    measurement = graph.node.create_publisher(Temperature, "measurement", 1)
    setpoint = graph.node.create_publisher(ScalarStamped, "setpoint", 1)
    graph.until(lambda: measurement.get_subscription_count() and setpoint.get_subscription_count(), "the controller")

    def answered() -> bool:
        measurement.publish(Temperature(temperature=20.0))
        setpoint.publish(ScalarStamped(value=25.0))
        return bool(controls) and controls[-1].data == pytest.approx(10.0)

    graph.until(answered, "2 * (25 - 20)")


def test_manual_and_back_without_a_jump(graph: Graph) -> None:
    loop = LockstepLoop(graph, "P1", {"kp": 1.0, "ki": 0.4})
    manual = graph.node.create_publisher(ScalarStamped, "manual_control", 1)
    graph.until(manual.get_subscription_count, "the controller")
    loop.publish("setpoint", 1.0)
    loop.advance(10.0)
    assert graph.call(SetBool, "fopid_controller/set_auto", SetBool.Request(data=False)).success
    manual.publish(ScalarStamped(value=0.8))
    graph.spin(0.3)
    loop.advance(20.0)
    assert loop.controls[-1].value == 0.8
    assert loop.states[-1].mode == FopidState.MANUAL
    assert graph.call(SetBool, "fopid_controller/set_auto", SetBool.Request(data=True)).success
    loop.advance(20.01)
    assert abs(loop.controls[-1].value - 0.8) < 0.01


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("executable", ["plant_simulator", "fopid_controller", "fopid_tuner"])
def test_a_node_ends_in_good_order_when_told_to(graph: Graph, executable: str, number: int) -> None:
    process = graph.start(executable, {})
    graph.until(lambda: (executable, "/") in graph.node.get_node_names_and_namespaces(), "the node")
    os.kill(process.pid, number)
    assert process.wait(10) == 0
    assert "Traceback" not in graph.logs()


def test_a_simulated_clock_is_told_to_who_comes_while_the_loop_stands(graph: Graph) -> None:
    graph.start("plant_simulator", {"trigger": "lockstep", "advance_until": 0.0})
    graph.until(lambda: graph.node.count_publishers("/clock"), "the plant")
    graph.spin(0.5)
    clocks = graph.listen(Clock, "/clock", qos_profile_sensor_data)
    graph.until(lambda: len(clocks) >= 2, "the clock", patience=10.0)
    assert {(one.clock.sec, one.clock.nanosec) for one in clocks} == {(0, 0)}


def test_gains_that_are_accepted_are_logged_from_old_to_new_with_who_set_them(graph: Graph) -> None:
    graph.start("fopid_controller", {"kp": 1.0})
    assert graph.set("fopid_controller", kp=2.0).successful
    assert graph.set("fopid_controller", kp=2.0).successful  # no change, no line
    assert graph.set("fopid_controller", ki=0.5, gains__origin="by hand, by Ada").successful
    lines = [line for line in graph.logs().splitlines() if "gains from" in line]
    assert len(lines) == 2
    assert "gains from 1 + 0 s^-1 + 0 s^1 to 2 + 0 s^-1 + 0 s^1, set by: a client that does not say" in lines[0]
    assert "to 2 + 0.5 s^-1 + 0 s^1, set by: by hand, by Ada" in lines[1]


@pytest.mark.slow
def test_advance_is_answered_when_the_loop_is_there_or_stands(graph: Graph) -> None:
    loop = LockstepLoop(graph, "P1", {"kp": 1.0}, controller={"setpoint.initial": 1.0})
    answer = graph.call(Advance, "plant_simulator/advance", Advance.Request(until=3.0))
    assert (answer.success, answer.message, answer.time) == (True, "reached", 3.0)
    graph.until(lambda: len(loop.measurements) == 300, "its samples")
    past = graph.call(Advance, "plant_simulator/advance", Advance.Request(until=1.0))
    assert "allowed: the present time 3 s or later" in past.message
    loop.controller.terminate()
    assert loop.controller.wait(10) == 0
    farther = graph.client(Advance, "plant_simulator/advance").call_async(Advance.Request(until=9.0))
    graph.spin(0.5)
    assert not farther.done()
    nearer = graph.client(Advance, "plant_simulator/advance").call_async(Advance.Request(until=5.0))
    assert graph.result(farther).message == "another request has the loop stop at 5 s"
    assert not graph.result(nearer).success
    assert nearer.result().message == "the loop stands at 3 s: is there a controller?"
