"""Experiment files with the real nodes give the numbers of the simulation without ROS, bit for bit."""

from __future__ import annotations

import os
import subprocess
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rclpy

from fopid_core.design.acceptance import DELAY_MARGIN_TICKS, MS_MAX
from fopid_core.model.process import read_process
from fopid_core.study.bags.bag import read_bag
from fopid_core.study.experiments.experiment import Experiment, Phase
from fopid_core.study.experiments.loop_parameters import CONTROLLER_KEYS, PLANT_KEYS, SETTING_KEYS
from fopid_core.study.experiments.profiles import Bag, Ramp, Sine, Steps
from fopid_core.study.experiments.simulate import replayed, simulate_experiment
from fopid_core.study.experiments.tune_call import TuneCall
from fopid_core.study.reports.run import Signal
from fopid_ros.common.pending_values import PendingValues
from fopid_ros.controller.parameters import SPECS as CONTROLLER_SPECS
from fopid_ros.experiment.node import ExperimentNode, tune_request
from fopid_ros.experiment.with_nodes import node_parameters
from fopid_ros.plant.node import SPECS as PLANT_SPECS
from fopid_ros.tuner.messages import tuning_request
from fopid_ros.tuner.parameters import SPECS as TUNER_SPECS

from ..conftest import BIN, own_domain

EVERYTHING = Experiment(
    "2/((s+1)(0.3s+1)) * exp(-0.123s)",
    (
        Phase("wait", 1.0),
        Phase("ramp", 6.0, setpoint=Ramp(to=2.0, over=3.0)),
        Phase("sine", 12.0, setpoint=Sine(0.5, 2.0), disturbance=Steps(((0.0, 0.1), (2.0, -0.1), (2.004, 0.3)))),
        Phase("tuned", 6.0, tune=TuneCall("frequency"), disturbance=Sine(0.1, 3.0)),
        Phase("gain", 3.0, gain_factor=1.3, controller={"control_max": 3.0, "setpoint_weight": 0.5}),
        Phase("hand", 3.0, gains={"kp": 0.3, "mu": 0.5}, setpoint=1.0, disturbance=0.0),
        Phase("manual", 2.0, controller={"mode": "manual"}),
        Phase("auto", 4.0, controller={"mode": "auto"}, tune=TuneCall("time", index="iae")),
    ),
    sample_time=0.02,
    gains={"kp": 0.5, "ki": 0.5, "kd": 0.1, "lam": 0.9, "mu": 0.8},
    controller={"control_min": -2.0, "control_max": 1.2},
    plant={"noise_std": 0.01, "seed": 7, "delay_model": "exact"},
)


def once(signal: Signal) -> list[float]:
    """Its values: on a busy machine the plant asks again, and the same sample is recorded twice."""
    _, first = np.unique(signal.time, return_index=True)
    return signal.value[first].tolist()


def run(experiment: Experiment, folder: Path, *more: str) -> subprocess.CompletedProcess[str]:
    """With nodes of its own, on a domain of its own."""
    folder.mkdir(exist_ok=True)
    file = folder / "file.yaml"
    file.write_text(experiment.to_yaml())
    with own_domain() as domain:
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        return subprocess.run([BIN / "experiment", file, "--start-nodes", "--out", folder / "run", *more],
                              env=environment, capture_output=True, text=True, timeout=250, check=False)  # fmt: skip


@pytest.mark.slow
def test_everything_an_experiment_can_do_equals_the_simulation_and_replays(tmp_path: Path) -> None:
    namespace = ("--ros-args", "-r", "__ns:=/loop1", "-r", "/clock:=clock")
    ended = run(EVERYTHING, tmp_path, "--no-report", *namespace)
    assert ended.returncode == 0, ended.stderr
    recorded = read_bag(tmp_path / "run" / "bag")
    trace = simulate_experiment(EVERYTHING).trace
    assert once(recorded.signals["measurement"]) == trace.measurement.tolist()
    assert once(recorded.signals["control"]) == trace.control.tolist()
    assert recorded.state["setpoint"].tolist() == trace.setpoint.tolist()
    assert [phase.name for phase in recorded.phases] == [phase.name for phase in EVERYTHING.phases]
    again = simulate_experiment(replayed(EVERYTHING, recorded)).trace
    assert again.measurement.tolist() == trace.measurement.tolist()


@pytest.mark.long
def test_a_recorded_setpoint_is_replayed_through_the_nodes_and_only_what_is_asked_is_recorded(tmp_path: Path) -> None:
    first = Experiment("P1", (Phase("sine", 3.0, setpoint=Sine(1.0, 1.5)),), gains={"kp": 1.0, "ki": 0.3})
    ended = run(first, tmp_path / "first", "--no-report")
    assert ended.returncode == 0, ended.stderr
    bag = tmp_path / "first" / "run" / "bag"
    second = Experiment("P1", (Phase("again", 3.0, setpoint=Bag(str(bag))),), gains=first.gains,
                        record=("measurement", "setpoint"))  # fmt: skip
    ended = run(second, tmp_path / "second")
    assert ended.returncode == 0, ended.stderr
    recorded = read_bag(tmp_path / "second" / "run" / "bag", needed=())
    assert sorted(recorded.signals) == ["measurement", "setpoint"]
    assert once(recorded.signals["measurement"]) == once(read_bag(bag).signals["measurement"])


@pytest.mark.parametrize(
    "call",
    [
        TuneCall(), TuneCall("rule", rule="simc-pi"),
        TuneCall("time", index="iae", ms_max=1.5, u_max=3.0, horizon=20.0),
        TuneCall("frequency", 50.0, 0.4, t_max_db=-20.0, t_max_frequency=10.0, s_max_db=-15.0, s_max_frequency=0.01,
                 via="nioptd2"),
    ],
)  # fmt: skip
def test_the_tuners_node_makes_the_same_of_a_call_as_the_simulation(call: TuneCall) -> None:
    defaults = {spec.name: spec.default for spec in TUNER_SPECS} | {"process": "P1", "sample_time": 0.02}
    assert tuning_request(tune_request(call), defaults) == call.request(read_process("P1"), 0.02)
    assert (defaults["verify.ms_max"], defaults["verify.ticks"]) == (MS_MAX, DELAY_MARGIN_TICKS)


def test_in_lockstep_the_tuner_does_not_listen_to_the_loop() -> None:
    plan = Experiment("P1", (Phase("a", 1.0),))
    assert node_parameters(plan)["fopid_tuner"]["history"] == 0.0
    assert "history" not in node_parameters(replace(plan, trigger="realtime"))["fopid_tuner"]


@pytest.mark.slow
def test_a_change_that_a_node_refuses_ends_the_run_and_says_why(tmp_path: Path) -> None:
    wrong = Phase("wrong", 1.0, gain_factor=1e305)  # beyond what the node takes
    ended = run(Experiment("P1", (Phase("a", 1.0, setpoint=1.0), wrong), gains={"kp": 1.0}), tmp_path)
    assert ended.returncode == 2
    assert "plant_simulator refused a change: gain_factor = 1e+305" in ended.stderr


@pytest.mark.slow
def test_in_real_time_a_ramp_comes_at_its_times(tmp_path: Path) -> None:
    ramp = Phase("ramp", 2.0, setpoint=Ramp(to=1.0, over=1.5))
    plan = Experiment("P1", (ramp,), sample_time=0.05, trigger="realtime", gains={"kp": 1.0}, record=("setpoint",))
    ended = run(plan, tmp_path)
    assert ended.returncode == 0, ended.stderr
    setpoint = read_bag(tmp_path / "run" / "bag", needed=()).signals["setpoint"]
    assert setpoint.value.tolist()[-1] == 1.0
    assert (setpoint.value[1:] > setpoint.value[:-1]).all()
    assert set(setpoint.value) <= set(plan.signal("setpoint"))


OF_THE_EXPERIMENT = {"process", "model", "sample_time", "trigger", "advance_until", "publish_clock"}
OF_A_SCHEDULE = {"schedule_file", "schedule_by"}  # refused in an experiment: its gains stand in its own file


@pytest.mark.parametrize(("specs", "known"), [(CONTROLLER_SPECS, SETTING_KEYS), (PLANT_SPECS, PLANT_KEYS)])
def test_every_parameter_of_the_nodes_that_numbers_depend_on_can_be_written_in_an_experiment(specs, known) -> None:
    signals = tuple(spec.name.removesuffix("type") for spec in specs if spec.name.endswith(".type"))
    of_messages = {spec.name for spec in specs if spec.name.startswith(signals)}
    of_messages |= {spec.name for spec in specs if spec.name.endswith("_timeout")}
    of_messages |= {
        "clock_skew_max",
        "state_rate",
        "on_stale",
        "on_several_publishers",
        "directory",
        "gains_file",
        "retain",
    }
    of_messages |= {"gains.status", "gains.origin", "gains.certificate", "allow_zero_gains"}
    of_messages |= {"back_calculation.enabled", "pid_state.enabled", "controller_state.enabled"}
    assert {spec.name for spec in specs} - OF_THE_EXPERIMENT - OF_A_SCHEDULE - of_messages == set(known)


def test_the_core_knows_every_parameter_of_the_controllers_node() -> None:
    assert {spec.name for spec in CONTROLLER_SPECS} - OF_THE_EXPERIMENT - OF_A_SCHEDULE <= set(CONTROLLER_KEYS)


def test_values_that_come_ahead_wait_for_their_sample_and_others_do_not() -> None:
    ahead = PendingValues()
    wall_clock = 1_800_000_000 * 10**9
    assert not any(ahead.defer(stamp, 1.0) for stamp in (None, 0, wall_clock))
    assert all(ahead.defer(stamp, stamp / 10) for stamp in (10, 20, 30))
    assert list(ahead.due(5)) == []
    assert list(ahead.due(20)) == [1.0, 2.0]
    assert not ahead.defer(20, 7.0)
    assert list(ahead.due(100)) == [3.0]


def test_the_end_of_a_recording_that_comes_late_is_waited_for() -> None:
    samples, late = 150, 1.5
    with own_domain() as domain:
        rclpy.init(domain_id=domain)
        node = ExperimentNode(Experiment("P1", (Phase("all", samples * 0.01),), sample_time=0.01))
        come, last = time.monotonic() + late, (samples - 1) * 10_000_000
        node.recorded = lambda: last if time.monotonic() > come else last // 2
        try:
            node.drain(samples)
            assert node.recorded() == last
        finally:
            node.destroy_node()
            rclpy.shutdown()
