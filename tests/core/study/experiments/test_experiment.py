"""Experiments are checked before anything is started, and one can be made for any process."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import read_process
from fopid_core.model.stability import stability
from fopid_core.study.experiments.demonstration import demo_experiment
from fopid_core.study.experiments.experiment import parse_experiment, read_experiment

EXPERIMENTS = Path(__file__).parents[4] / "config" / "experiments"
MINIMAL = {"process": "P1", "phases": [{"name": "step", "duration": 5.0, "setpoint": 1.0}]}


@pytest.mark.parametrize(
    "process",
    [
        "P1", "P2", "P3", "P4", "9/((s+1)(s^2+2s+9))", "3.13/(433.33s+1)*exp(-50s)", "1/(s(s+1))", "-2/(s+1)^3",
        "1/(0.8s^2+0.5s+1)*exp(-s)", "(1-s)/(s+1)^2", "1/(0.001s+1)^2", "1/(s-0.2)",
    ],
)  # fmt: skip
def test_demo_starts_from_a_stable_loop_and_reads_back(process: str) -> None:
    experiment = demo_experiment(process)
    assert stability(Loop(read_process(process), Fopid(**experiment.gains))).stable
    assert parse_experiment(yaml.safe_load(experiment.to_yaml())) == experiment
    assert [bool(phase.tune) for phase in experiment.phases] == [False, False, True, False, True]
    assert 10_000 <= experiment.duration / experiment.sample_time <= 25_000


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"process": "1/(s+"}, "character 6"),
        ({"process": "1/(s*exp(-s)+1)"}, "advanced type"),
        ({"proces": "P1"}, "'proces'"),
        ({"sample_time": 0.0}, "sample_time = 0.0"),
        ({"sample_time": "fast"}, "'fast'"),
        ({"trigger": "now"}, "'now'"),
        ({"gains": {"kp": 1.0, "lambda": 1.0}}, "'lambda'"),
        ({"gains": {"kp": float("nan")}}, "kp = nan"),
        ({"plant": {"noise": 1.0}}, "'noise'"),
        ({"phases": []}, "at least one phase"),
        ({"phases": "none"}, "a list"),
        ({"phases": [{"name": "a"}]}, "'duration'"),
        ({"phases": [{"name": "a", "duration": -1.0}]}, "duration = -1.0"),
        ({"phases": [{"name": "a", "duration": 1.0, "setpoint": float("inf")}]}, "setpoint = inf"),
        ({"phases": [{"name": "a", "duration": 1.0, "tune": {"method": "frequency", "margin": 1}}]}, "'margin'"),
        ({"phases": [{"name": "a", "duration": 1.0, "tune": {"t_max_db": -20.0}}]}, "t_max_frequency = 0.0"),
        ({"phases": [{"name": "a", "duration": 0.004}]}, "phases[0].duration: duration = 0.004; allowed: one sample"),
        ({"phases": [{"name": "a", "duration": 1e9}]}, "phases of 1e+09 s together"),
        ({"phases": [{"name": "a", "duration": 1.0, "setpoint": [1.0]}]}, "a number, or one of steps, ramp, sine"),
        ({"controller": {"setpoint_timeout": 1.0}}, "controller.setpoint_timeout: there is no key"),
        ({"name": "../outside"}, "name = '../outside'"),
        ({"name": ""}, "name = ''"),
        ({"gains": {"kp": 10**400}}, "kp = 1000"),
    ],
)
def test_what_cannot_be_run_is_named(change: dict, named: str) -> None:
    with pytest.raises(InputError, match=re.escape(named)):
        parse_experiment({**MINIMAL, **change})


def test_files_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"missing\.yaml"):
        read_experiment(tmp_path / "missing.yaml")
    broken = tmp_path / "broken.yaml"
    broken.write_text("phases: [")
    with pytest.raises(InputError, match=r"broken\.yaml"):
        read_experiment(broken)


def test_a_process_file_is_read_so_that_the_experiment_stands_for_itself(tmp_path: Path) -> None:
    process, file = tmp_path / "p.yaml", tmp_path / "e.yaml"
    process.write_text("process: 2/(3s+1)*exp(-0.5s)\n")
    file.write_text(f"process: {process}\nphases:\n- {{name: a, duration: 1}}\n")
    experiment = read_experiment(file)
    process.unlink()
    assert read_process(experiment.process)(1j) == read_process("2/(3s+1)*exp(-0.5s)")(1j)
    assert parse_experiment(yaml.safe_load(experiment.to_yaml())) == experiment


@pytest.mark.parametrize("path", sorted(EXPERIMENTS.glob("*.yaml")), ids=lambda path: path.stem)
def test_shipped_experiments_can_be_read(path: Path) -> None:
    assert read_experiment(path).duration > 0.0
