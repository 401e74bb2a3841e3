"""One node for many joints: each as a controller of its own, bit for bit, and each as safe."""

from __future__ import annotations

import math
import os
import random
import signal
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Literal

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from std_srvs.srv import SetBool, Trigger

from fopid_core.model.fopid import Fopid
from fopid_core.runtime.controller import ControllerSettings, FopidController

from ...conftest import BIN, Graph
from .arm import JOINTS, NAME, PERIOD, Arm, joint_state

GAINS = {"shoulder": (2.0, 1.5, 0.1, 0.9, 0.7), "elbow": (1.0, 3.0, 0.0, 1.0, 1.0), "wrist": (3.0, 1.0, 0.3, 1.2, 0.8)}
PARAMETERS = {
    f"gains.{joint}.{name}": value
    for joint, gains in GAINS.items()
    for name, value in zip(("kp", "ki", "kd", "lam", "mu"), gains, strict=True)
}
LIMITS = {"gains.elbow.control_max": 0.8, "gains.elbow.control_min": -0.5, "gains.wrist.control_rate_max": 20.0,
          "gains.wrist.angle_wraparound": True}  # fmt: skip


class Twins:
    """The node in lockstep, and beside it a single controller for each joint that is told the same."""

    def __init__(self, graph: Graph) -> None:
        self.graph, self.chance = graph, random.Random(1)
        self.arm = Arm(graph, {**PARAMETERS, **LIMITS, "trigger": "lockstep"})
        limits = {
            "shoulder": {}, "elbow": {"control_max": 0.8, "control_min": -0.5},
            "wrist": {"control_rate_max": 20.0, "angle_wraparound": True},
        }  # fmt: skip
        self.alone = {
            joint: FopidController(ControllerSettings(Fopid(*GAINS[joint]), PERIOD, **limits[joint]))
            for joint in JOINTS
        }
        self.setpoints, self.added = dict.fromkeys(JOINTS, 0.0), dict.fromkeys(JOINTS, 0.0)
        self.manual = dict.fromkeys(JOINTS, math.nan)
        self.saturated = 0

    def set_some(self) -> None:
        chosen = {joint: self.chance.uniform(-3.0, 3.0) for joint in self.chance.sample(JOINTS, 2)}
        self.setpoints |= chosen
        self.arm.send("setpoint", joint_state(chosen))

    def set_all(self) -> None:
        self.setpoints = {joint: self.chance.uniform(-3.0, 3.0) for joint in JOINTS}
        self.arm.send("setpoint", joint_state(self.setpoints))

    def feed_forward(self) -> None:
        self.added["wrist"] = 0.25
        self.arm.send("feedforward", joint_state({"wrist": 0.25}, field="effort"))

    def tune(self) -> None:
        assert self.graph.set(NAME, gains__elbow__ki=0.5, gains__elbow__lam=0.8).successful
        elbow = self.alone["elbow"]
        elbow.reconfigure(replace(elbow.settings, gains=Fopid(1.0, 0.5, 0.0, 0.8, 1.0)))

    def set_mode(self, mode: Literal["auto", "manual"]) -> None:
        assert self.graph.call(SetBool, f"{NAME}/set_auto", SetBool.Request(data=mode == "auto")).success
        for one in self.alone.values():
            one.set_mode(mode)

    def steer(self) -> None:
        self.manual["shoulder"] = 0.7
        self.arm.send("manual_control", joint_state({"shoulder": 0.7}, field="effort"))

    def reset(self) -> None:
        assert self.graph.call(Trigger, f"{NAME}/reset").success
        for one in self.alone.values():
            one.reset()

    def tick(self, sample: int) -> None:
        measured = {joint: self.chance.uniform(-1.0, 1.0) for joint in self.chance.sample(JOINTS, 3)}
        expected = []
        for joint, one in self.alone.items():
            by_hand = one.state.control if math.isnan(self.manual[joint]) else self.manual[joint]
            expected.append(one.step(self.setpoints[joint], measured[joint], self.added[joint], by_hand))
            self.saturated += one.state.saturated
        assert self.arm.tick(sample, measured) == expected


def test_each_joint_is_a_controller_of_its_own(graph: Graph) -> None:
    """In lockstep: through saturation, partial setpoints in any order, feedforward, new gains, manual mode, a reset."""
    twins = Twins(graph)
    events = {
        1: twins.set_all, 10: twins.feed_forward, 15: twins.tune, 20: twins.set_some,
        30: lambda: twins.set_mode("manual"), 35: twins.steer, 40: lambda: twins.set_mode("auto"), 45: twins.set_some,
        50: twins.reset,
    }  # fmt: skip
    for k in range(1, 61):
        events.get(k, lambda: None)()
        twins.tick(k)
    assert twins.saturated > 10
    told, known = twins.arm.states["wrist"][-1], twins.alone["wrist"].state
    assert (told.control, told.setpoint, told.error) == (known.control, known.setpoint, known.error)


def test_a_silent_joint_holds_and_the_others_go_on(graph: Graph) -> None:
    arm = Arm(graph, {**PARAMETERS, "measurement_timeout": 0.3})
    everywhere = dict.fromkeys(JOINTS, 0.5)
    arm.send("setpoint", joint_state(dict.fromkeys(JOINTS, 1.0)))
    sent = dict(everywhere)
    graph.node.create_timer(PERIOD, lambda: arm.send("measurement", joint_state(sent)))
    graph.until(lambda: all(states and not states[-1].stale for states in arm.states.values()), "all joints controlled")

    del sent["wrist"]
    graph.until(lambda: arm.states["wrist"][-1].stale, "the watchdog of the wrist")
    held = arm.controls[-1].data[2]
    begun = len(arm.controls)
    graph.until(lambda: len(arm.controls) > begun + 30, "controls")
    since = [list(message.data) for message in arm.controls[begun:]]
    assert {controls[2] for controls in since} == {held}
    assert since[-1][1] > since[0][1]  # the elbow's integral goes on
    assert not arm.states["elbow"][-1].stale
    graph.until(lambda: "measurement of wrist stale" in arm.told, "its diagnosis")
    assert arm.diagnostics[-1].status[0].level == DiagnosticStatus.ERROR
    assert "no 'wrist' in name; allowed: shoulder, elbow; refused" in graph.logs()

    sent["wrist"] = math.nan  # refused: the wrist stays as it is
    graph.until(lambda: "measurement of wrist = nan; allowed: finite numbers" in graph.logs(), "the refusal")
    assert arm.controls[-1].data[2] == held
    sent["wrist"] = 0.5
    graph.until(lambda: not arm.states["wrist"][-1].stale, "the wrist back")
    assert abs(arm.states["wrist"][-1].control - held) < 0.05

    assert not graph.set(NAME, gains__wrist__lam=5.0, gains__elbow__kp=9.0).successful
    assert graph.get(NAME, "gains.elbow.kp") == [1.0]
    graph.set(NAME, gains__elbow__safe_control=0.1)
    graph.call(SetBool, f"{NAME}/set_auto", SetBool.Request(data=False))
    graph.until(lambda: arm.states["elbow"][-1].mode == arm.states["elbow"][-1].MANUAL, "manual mode")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("parameters", "told"),
    [
        (["dof_names:=[elbow, elbow]"], "dof_names[1] = 'elbow'; allowed: each name once"),
        (["dof_names:=['left arm']"], "dof_names[0] = 'left arm'; allowed: letters, digits and _"),
        (["dof_names:=[elbow]", "gains.wrist.kp:=1.0"], "no parameter 'gains.wrist.kp'; did you mean 'gains.elbow.kp'"),
        (["dof_names:=[elbow]", "gains.elbow.lam:=3.0"], "gains.elbow.lam = 3.0; allowed: 0 to 2"),
        (["dof_names:=[elbow]"], "gains.elbow: kp = ki = kd = 0; allowed: a gain that is not 0"),
        (["dof_names:=[elbow]", "gains.elbow.kp:=1.0", "gains.elbow.control_min:=inf"],
         "gains.elbow: control_min = inf, control_max = inf; allowed: min < max"),
        (["dof_names:=[elbow]", "control.field:=data[0]"], "control.field = 'data[0]'; allowed: the name of an array"),
        (["dof_names:=[elbow]", "reference_and_state_dof_names:=[a, b]"], "has 2 names; allowed: 1, as in dof_names"),
    ],
)  # fmt: skip
def test_a_bad_start_is_one_line(graph: Graph, parameters: list[str], told: str) -> None:
    given = [item for parameter in parameters for item in ("-p", parameter)]
    ended = subprocess.run([BIN / NAME, "--ros-args", *given], env=graph.environment, timeout=100,
                           capture_output=True, text=True, check=False)  # fmt: skip
    assert (ended.returncode, ended.stderr.count("\n")) == (2, 1)
    assert told in ended.stderr


@pytest.mark.slow
def test_a_joints_gains_on_trial_end_with_their_author_and_its_verified_ones_outlive_the_process(
    graph: Graph, tmp_path: Path
) -> None:
    given = {"dof_names": ["shoulder", "elbow"], "gains.shoulder.kp": 1.0, "gains.elbow.kp": 2.0}
    kept = {**given, "retain": True, "directory": str(tmp_path), "gains_file": "arm.yaml", "trial_timeout": 0.5}
    process = graph.start(NAME, kept)
    assert graph.set(NAME, gains__elbow__kp=3.0, gains__elbow__status="verified", gains__elbow__origin="x").successful
    assert graph.set(NAME, gains__elbow__kp=9.0, gains__elbow__status="trial", gains__elbow__origin="y").successful
    assert graph.set(NAME, gains__shoulder__kp=4.0).successful  # a person, at another joint meanwhile
    names = [f"gains.{dof}.{name}" for dof in ("shoulder", "elbow") for name in ("kp", "status", "origin")]
    before = [4.0, "set", "", 3.0, "verified", "x"]
    graph.until(lambda: graph.get(NAME, *names) == before, "the gains before the trial", 5.0)
    assert graph.call(Trigger, f"{NAME}/save_gains").success
    assert "gains.elbow.kp: 3.0" in (tmp_path / "arm.yaml").read_text()

    os.kill(process.pid, signal.SIGKILL)
    graph.start(NAME, kept)
    graph.await_restarted(NAME)
    assert graph.get(NAME, *names) == before
