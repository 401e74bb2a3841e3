"""One command: a loop over ROS 2, tuned twice while it runs, recorded, with a report; interrupted at any moment."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
import pytest

from fopid_core.model.fopid import Fopid
from fopid_core.model.process import read_process
from fopid_core.runtime.controller import ControllerSettings, FopidController
from fopid_core.runtime.plant import Plant, PlantSettings
from fopid_core.runtime.simulation import simulate
from fopid_core.study.bags.bag import read_bag
from fopid_core.study.experiments.demonstration import demo_experiment
from fopid_ros.experiment.with_nodes import only_demonstration

from ...patience import FACTOR
from ..conftest import BIN, Graph, own_domain


def environment(domain: int) -> dict[str, str]:
    return {**os.environ, "ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


@pytest.mark.slow
@pytest.mark.parametrize("process", ["P1", "9/((s+1)(s^2+2s+9)) * exp(-0.1s)"])
def test_demo_tunes_twice_records_and_reports(tmp_path: Path, process: str) -> None:
    out = tmp_path / "run"
    with own_domain() as domain:
        ended = subprocess.run([BIN / "fopid_demo", "--process", process, "--out", out], env=environment(domain),
                               capture_output=True, text=True, timeout=250, check=False)  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    for word in ("frequency", "time", "IAE", "ITAE", "Ms", "report.html"):
        assert word in ended.stdout, ended.stdout
    page = (out / "report.html").read_text()
    assert len(page) > 10_000
    assert not re.search(r"""<(?:script|link|img|iframe)[^>]*(?:src|href)=["']?https?:""", page)

    run = read_bag(out / "bag")
    experiment = demo_experiment(process)
    assert [phase.name for phase in run.phases] == [phase.name for phase in experiment.phases]
    assert [tuning.method for tuning in run.tunings] == ["time", "frequency"]
    assert all(tuning.applied for tuning in run.tunings)
    samples = round(experiment.duration / experiment.sample_time)
    for name in ("measurement", "control"):  # nothing was lost at full speed
        assert sorted(set(run.signals[name].time)) == [
            k * round(1e9 * experiment.sample_time) / 1e9 for k in range(samples)
        ]
    # On a busy machine the plant asks again, and the same sample is recorded twice.
    _, first = np.unique(run.signals["measurement"].time, return_index=True)
    assert run.signals["measurement"].value[first].tolist() == replayed(experiment, run.tunings, samples)


def replayed(experiment, tunings, samples: int) -> list[float]:
    """The same experiment offline, with the designs the tuner applied at the same samples."""
    h = experiment.sample_time
    settings = ControllerSettings(Fopid(**experiment.gains), sample_time=h)
    controller = FopidController(settings)
    plant = Plant(PlantSettings(read_process(experiment.process), sample_time=h, delay_model="exact"))
    setpoint, disturbance, actions, start = {}, {}, {}, 0.0
    applied = iter(tunings)
    for phase in experiment.phases:
        k = round(start / h)
        setpoint[k], disturbance[k] = phase.setpoint, phase.disturbance
        if phase.tune:
            tuning = next(applied)
            settings = replace(settings, gains=tuning.gains, measurement_filter_order=tuning.filter.order,
                               measurement_filter_time=tuning.filter.time)  # fmt: skip
            if tuning.method == "time":
                settings = replace(settings, setpoint_weight=tuning.weights.proportional,
                                   derivative_setpoint_weight=tuning.weights.derivative)  # fmt: skip
            actions[k] = lambda c, _, s=settings: c.reconfigure(s)
        start += phase.duration

    def held(changes: dict) -> list[float]:
        value, out = 0.0, []
        for k in range(samples):
            if changes.get(k) is not None:
                value = changes[k]
            out.append(value)
        return out

    trace = simulate(controller, plant, samples, held(setpoint).__getitem__,
                     held(disturbance).__getitem__, actions)  # fmt: skip
    return list(trace.measurement)


@pytest.mark.parametrize(
    ("number", "after"),
    [
        (signal.SIGINT, 3.5),
        *[
            pytest.param(number, after, marks=pytest.mark.slow)
            for number in (signal.SIGINT, signal.SIGTERM)
            for after in (0.3, 2.0, 3.5, 5.0)
            if (number, after) != (signal.SIGINT, 3.5)
        ],
    ],
)
def test_an_interrupt_leaves_no_process_and_a_bag_that_opens(tmp_path: Path, number: int, after: float) -> None:
    out = tmp_path / "run"
    with own_domain() as domain:
        demo = subprocess.Popen([BIN / "fopid_demo", "--out", out], env=environment(domain), stderr=subprocess.PIPE,
                                stdout=subprocess.PIPE, text=True)  # fmt: skip
        time.sleep(after)
        children = psutil.Process(demo.pid).children(recursive=True)
        demo.send_signal(number)
        _, errors = demo.communicate(timeout=30 * FACTOR)
    _, alive = psutil.wait_procs(children, timeout=5)
    assert not alive
    assert demo.returncode in (130, -number, 1)  # the latter two while Python itself was starting
    if after > 1.0:
        assert demo.returncode == 130
        assert "Traceback" not in errors, errors
    if (out / "bag").exists():
        read_bag(out / "bag", needed=())


@pytest.mark.slow
def test_a_killed_demo_leaves_no_process(tmp_path: Path) -> None:
    with own_domain() as domain:
        demo = subprocess.Popen([BIN / "fopid_demo", "--out", tmp_path / "run"], env=environment(domain),
                                stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)  # fmt: skip
        deadline = time.monotonic() + 60.0
        while len(children := psutil.Process(demo.pid).children(recursive=True)) < 4:
            assert time.monotonic() < deadline, "plant, controller, tuner and experiment"
            time.sleep(0.1)
        demo.kill()
        demo.wait(10)
        _, alive = psutil.wait_procs(children, timeout=15)
    assert not alive


@pytest.mark.parametrize(
    ("process", "named"), [("1/(s+1", "character 7"), ("s^2/(s+1)", "not proper"), ("1/(s*exp(-s)+1)", "advanced type")]
)
def test_a_process_that_cannot_be_run_is_said_in_one_line(tmp_path: Path, process: str, named: str) -> None:
    ended = subprocess.run([BIN / "fopid_demo", "--process", process, "--out", tmp_path / "run"], capture_output=True,
                           text=True, timeout=60, check=False)  # fmt: skip
    assert ended.returncode == 2
    (line,) = ended.stderr.splitlines()
    assert line.startswith("error: ")
    assert named in line


def experiment_file(tmp_path: Path) -> Path:
    file = tmp_path / "experiment.yaml"
    file.write_text(demo_experiment("P4").to_yaml())
    return file


@pytest.mark.slow
def test_an_experiment_without_a_controller_says_so(graph: Graph, tmp_path: Path) -> None:
    graph.start("plant_simulator", {"process": "P4", "trigger": "lockstep", "advance_until": 0.0})
    ended = subprocess.run([BIN / "experiment", experiment_file(tmp_path), "--out", tmp_path / "run"],
                           env=graph.environment, capture_output=True, text=True, timeout=60, check=False)  # fmt: skip
    assert ended.returncode == 2
    assert "no controller to talk to" in ended.stderr
    assert f"domain {graph.domain}" in ended.stderr


@pytest.mark.slow
def test_a_domain_in_use_by_another_loop_is_said(graph: Graph, tmp_path: Path) -> None:
    for name in ("plant_simulator", "other_plant"):
        graph.start("plant_simulator", {"process": "P4", "trigger": "lockstep", "advance_until": 0.0},
                    "-r", f"__node:={name}")  # fmt: skip
    graph.start("fopid_controller", {"trigger": "lockstep"})
    graph.start("fopid_tuner", {"process": "P4"})
    graph.until(lambda: graph.node.count_publishers("/measurement") == 2, "both plants")
    ended = subprocess.run([BIN / "experiment", experiment_file(tmp_path), "--out", tmp_path / "run"],
                           env=graph.environment, capture_output=True, text=True, timeout=60, check=False)  # fmt: skip
    assert ended.returncode == 2
    assert f"domain {graph.domain} is in use" in ended.stderr
    assert "/other_plant" in ended.stderr


def test_a_second_demo_on_the_same_domain_starts_nothing(tmp_path: Path) -> None:
    with own_domain() as domain, only_demonstration(str(domain)):
        ended = subprocess.run([BIN / "fopid_demo", "--out", tmp_path / "run"], env=environment(domain),
                               capture_output=True, text=True, timeout=60, check=False)  # fmt: skip
    assert ended.returncode == 2
    assert ended.stderr.startswith(f"error: ROS_DOMAIN_ID = {domain} is in use by another demonstration")
    assert not (tmp_path / "run").exists()


@pytest.mark.long
def test_a_full_disk_ends_the_recording_and_not_the_run(tmp_path: Path) -> None:
    out = tmp_path / "run"
    demo = f'"{BIN / "fopid_demo"}" --process P4 --out "{out}"'
    # Files of 300 blocks at most; what measures coverage writes larger ones.
    limited = f"unset COVERAGE_PROCESS_CONFIG; ulimit -f 300; exec {demo}"
    with own_domain() as domain:
        ended = subprocess.run(["bash", "-c", limited], env=environment(domain), capture_output=True, text=True,
                               timeout=250, check=False)  # fmt: skip
    assert "recording stopped" in ended.stderr, ended.stderr
    assert "report" in ended.stderr.splitlines()[-1]  # it does not fit either, and that is said
    assert "Traceback" not in ended.stderr, ended.stderr
    run = read_bag(out / "bag")
    assert len(run.signals["measurement"].time) > 100
