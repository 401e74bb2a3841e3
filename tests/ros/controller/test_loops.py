"""Many single loops in one process: each in its namespace, each a node by itself."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from rclpy.qos import QoSProfile

from fopid_msgs.msg import ScalarStamped

from ..conftest import BIN, Graph

NODE = "fopid_controller"


@pytest.mark.slow
def test_loops_of_one_process_are_apart(graph: Graph, tmp_path: Path) -> None:
    file = tmp_path / "loops.yaml"
    file.write_text(
        "/**/fopid_controller:\n  ros__parameters: {kp: 2.0, setpoint.initial: 1.0}\n"
        "/right/fopid_controller:\n  ros__parameters: {kp: 3.0}\n"
    )
    controls = {side: graph.listen(ScalarStamped, f"{side}/control") for side in ("left", "right")}
    sensors = {side: graph.node.create_publisher(ScalarStamped, f"{side}/measurement", QoSProfile(depth=1))
               for side in controls}  # fmt: skip
    process = graph.start("fopid_loops", {}, "--params-file", str(file), "--", "left", "right")
    for side, value in (("left", 0.5), ("right", 0.0)):
        graph.until(sensors[side].get_subscription_count, f"the loop {side}")
        graph.node.create_timer(0.01, lambda side=side, value=value: sensors[side].publish(ScalarStamped(value=value)))
    for side, value in (("left", 1.0), ("right", 3.0)):
        graph.until(lambda side=side, value=value: controls[side] and controls[side][-1].value == value, side)
    assert graph.set(f"left/{NODE}", kp=4.0).successful
    graph.until(lambda: controls["left"][-1].value == 1.0, "no jump of the control")
    assert graph.get(f"right/{NODE}", "kp") == [3.0]
    process.terminate()
    graph.until(lambda: process.poll() is not None, "its end")
    assert process.returncode == 0
    assert controls["right"][-1].value == 0.0  # the safe control


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ([], "namespaces = []; allowed: one and more"),
        (["left", "/left"], "namespace '/left' is given twice"),
        (["left", "--kp", "2"], "argument '--kp'; allowed: --help, namespaces, and parameters"),
        (["--ros-args", "left"], "error: "),
        (["left", "--ros-args", "-p", "kp:=0.0"], "kp = ki = kd = 0; allowed: a gain that is not 0"),
    ],
)
@pytest.mark.slow
def test_a_bad_start_is_one_line(graph: Graph, arguments: list[str], told: str) -> None:
    ended = subprocess.run([BIN / "fopid_loops", *arguments], env=graph.environment, timeout=100, capture_output=True,
                           text=True, check=False)  # fmt: skip
    assert (ended.returncode, ended.stderr.count("\n")) == (2, 1)
    assert told in ended.stderr
