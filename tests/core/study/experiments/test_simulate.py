"""Experiments without ROS, beside a loop written out by hand; and recorded ones again."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

from fopid_core.design.tuner import Bound, TuningRequest, tune
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import read_process
from fopid_core.runtime.controller import ControllerSettings, FopidController
from fopid_core.runtime.plant import Plant, PlantSettings
from fopid_core.study.experiments.experiment import Experiment, Phase, read_experiment
from fopid_core.study.experiments.profiles import Bag, Ramp, Steps
from fopid_core.study.experiments.simulate import replayed, simulate_experiment
from fopid_core.study.experiments.stored import read_simulated, write_simulated
from fopid_core.study.experiments.tune_call import TuneCall
from fopid_core.study.reports.segments import segments

from ...cli.runner import invoke
from ..recording import Recording, record_loop

TOUR = Path(__file__).parents[4] / "config" / "experiments" / "tour.yaml"
H = 0.02
GAINS = {"kp": 1.0, "ki": 0.4, "kd": 0.3, "lam": 1.1, "mu": 0.9}
EXPERIMENT = Experiment(
    "P1",
    (
        Phase("ramp", 4.0, setpoint=Ramp(to=1.0, over=2.0)),
        Phase("load and gains", 4.0, disturbance=Steps(((1.0, -0.3),)), gains={"kp": 2.0}),
        Phase("limits and plant", 4.0, controller={"control_max": 0.5}, gain_factor=1.4),
        Phase("by hand", 2.0, controller={"mode": "manual"}),
        Phase("tuned", 6.0, controller={"mode": "auto", "control_max": 9.0}, tune=TuneCall("frequency", crossover=0.5)),
    ),
    sample_time=H,
    gains=GAINS,
    plant={"noise_std": 0.01, "seed": 3},
)


def by_hand() -> list[tuple[float, float]]:
    """The same written out sample by sample: measurement and control."""
    settings = ControllerSettings(Fopid(**GAINS), sample_time=H)
    controller = FopidController(settings)
    plant = Plant(PlantSettings(read_process("P1"), sample_time=H, noise_std=0.01, seed=3))
    rows = []
    for k in range(1000):
        if k == 200:
            settings = replace(settings, gains=replace(settings.gains, kp=2.0))
            controller.reconfigure(settings)
        if k == 400:
            settings = replace(settings, control_max=0.5)
            controller.reconfigure(settings)
            plant.gain_factor = 1.4
        if k == 600:
            controller.reconfigure(settings)
            controller.set_mode("manual")
        if k == 700:
            design = tune(TuningRequest(read_process("P1"), crossover=0.5, sample_time=H)).controller
            assert design is not None
            controller.reconfigure(replace(settings, gains=design))
            controller.reconfigure(replace(settings, gains=design, control_max=9.0))
            controller.set_mode("auto")
        setpoint = min(k * H / 2.0, 1.0) if k < 200 else 1.0
        measurement = plant.measurement
        control = controller.step(setpoint, measurement, manual=controller.state.control)
        rows.append((measurement, control))
        plant.step(control, -0.3 if k >= 250 else 0.0)
    return rows


def test_an_experiment_is_the_loop_written_out_by_hand_bit_for_bit() -> None:
    trace = simulate_experiment(EXPERIMENT).trace
    assert list(zip(trace.measurement.tolist(), trace.control.tolist(), strict=True)) == by_hand()


def test_the_tour_reads_back_and_its_profiles_are_what_it_says() -> None:
    tour = read_experiment(TOUR)
    setpoint, load = tour.signal("setpoint"), tour.signal("disturbance")
    assert setpoint[[0, 999, 1150, 1300, 2100]].tolist() == pytest.approx([1.0, 1.0, 1.5, 2.0, 2.5])
    assert load[[0, 2000, 2500, 3250, 3500]].tolist() == pytest.approx([0.0, 0.1, -0.1, 0.05, 0.2])


@pytest.mark.slow
def test_a_tuning_that_finds_nothing_to_apply_is_told_and_changes_nothing() -> None:
    never = TuneCall("time", ms_max=1.0001, u_max=1e-3)
    phases = (Phase("a", 1.0, setpoint=1.0), Phase("b", 1.0, tune=never))
    found = simulate_experiment(Experiment("P1", phases, gains={"kp": 1.0}))
    assert len(found.not_applied) == 1
    assert found.gains[-1].tolist() == [1.0, 0.0, 0.0, 1.0, 1.0]


@pytest.mark.parametrize(
    ("process", "sample_time", "call", "reason", "handed_over"),
    [
        ("1/(s(s+1))", 0.01, TuneCall("rule", rule="simc-pi"), "its H2 norm is infinite", 0),
        ("1/((s+1)(0.1s+1))", 0.2, TuneCall("frequency", phase_margin_deg=60.0, crossover=3.0), "(verify.ticks)", 1),
    ],
)
def test_what_the_tuner_refuses_leaves_the_loop_as_it_is(
    process: str, sample_time: float, call: TuneCall, reason: str, handed_over: int
) -> None:
    """A margin of 60 deg at 3 rad/s is a delay of 0.35 s: less than two ticks of 0.2 s."""
    phases = (Phase("a", 2.0, setpoint=1.0), Phase("b", 2.0, tune=call))
    found = simulate_experiment(Experiment(process, phases, sample_time=sample_time, gains={"kp": 0.3}))
    (line,) = found.not_applied
    assert reason in line
    assert len(found.tunings) == handed_over
    assert found.gains[-1].tolist() == [0.3, 0.0, 0.0, 1.0, 1.0]


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    folder = tmp_path / "bag"
    recording = Recording(folder, StoragePlugin.MCAP)
    record_loop(recording)
    recording.writer.close()
    return folder


def test_a_bags_setpoint_and_disturbance_stand_in_for_profiles(bag: Path) -> None:
    from fopid_core.study.bags.bag import read_bag

    plan = Experiment("P1", tuple(Phase(f"{i}", 30.0) for i in range(4)), sample_time=0.05, gains={"kp": 1.0})
    again = replayed(plan, read_bag(bag))
    expected = np.repeat([1.0, 2.0, 2.0, 3.0], 600)
    assert again.signal("setpoint").tolist() == expected.tolist()
    assert again.signal("disturbance").tolist() == np.repeat([0.0, 0.0, -0.5, -0.5], 600).tolist()
    whole = Experiment("P1", (Phase("all", 120.0, setpoint=Bag(str(bag))),), sample_time=0.05, gains={"kp": 1.0})
    assert whole.signal("setpoint").tolist() == expected.tolist()


def test_the_verb_writes_the_same_numbers_as_json_and_csv(tmp_path: Path) -> None:
    file = tmp_path / "e.yaml"
    file.write_text(EXPERIMENT.to_yaml())
    ended = invoke(["simulate", str(file), "--json", "--out", str(tmp_path / "out")])
    assert ended.exit_code == 0, ended.output
    data = json.loads(ended.stdout)
    expected = by_hand()
    assert list(zip(data["measurement"], data["control"], strict=True)) == expected
    with (tmp_path / "out" / "trace.csv").open() as text:
        rows = list(csv.DictReader(text))
    assert [(float(row["measurement"]), float(row["control"])) for row in rows] == expected
    assert (tmp_path / "out" / "report.html").stat().st_size > 10_000
    assert [segment["name"] for segment in data["segments"]][-1] == "tuned"
    again = json.loads(invoke(["report", str(tmp_path / "out"), "--json"]).stdout)
    assert again["runs"][0]["segments"] == data["segments"]


def test_a_simulated_run_is_read_back_as_it_was(tmp_path: Path) -> None:
    phase = Phase("both", 5.0, setpoint=1.0, tune=TuneCall("rule", rule="simc-pi"))
    found = simulate_experiment(replace(EXPERIMENT, phases=(*EXPERIMENT.phases, phase)))
    write_simulated(found, tmp_path)
    then, now = found.as_run(tmp_path), read_simulated(tmp_path)
    assert repr(segments(now)) == repr(segments(then))
    assert now.tunings[-1].gains == then.tunings[-1].gains
    assert now.tunings[-1].loop(read_process("P1")) == then.tunings[-1].loop(read_process("P1"))
    assert now.process == then.process
    for name, signal in then.signals.items():
        assert now.signals[name].value.tolist() == signal.value.tolist()


@pytest.mark.parametrize(
    ("file", "text"),
    [("trace.csv", "time,kp\n0,x\n"), ("trace.csv", ""), ("tunings.json", "{"), ("tunings.json", '[{"gains": 3}]')],
)
def test_a_damaged_simulated_run_is_said_in_one_line(tmp_path: Path, file: str, text: str) -> None:
    write_simulated(simulate_experiment(EXPERIMENT), tmp_path)
    (tmp_path / file).write_text(text)
    ended = invoke(["report", str(tmp_path)])
    assert (ended.exit_code, len(ended.stderr.splitlines())) == (2, 1)
    assert str(tmp_path) in ended.stderr


@pytest.mark.parametrize(
    ("text", "named"),
    [("process: P1\nphases:\n- {name: a, duration: 5, setpiont: 1}\n", "line 3"), ("[", "cannot be read")],
)
def test_the_verb_names_the_line_of_what_it_cannot_read(tmp_path: Path, text: str, named: str) -> None:
    file = tmp_path / "e.yaml"
    file.write_text(text)
    ended = invoke(["simulate", str(file)])
    assert ended.exit_code == 2
    assert named in ended.stderr
    assert len(ended.stderr.splitlines()) == 1


def test_the_verb_needs_something_to_run() -> None:
    ended = invoke(["simulate"])
    assert ended.exit_code == 2
    assert "FILE is missing" in ended.stderr


def test_degrees_become_radians_and_a_bound_gets_its_frequency_in_the_tuners_request() -> None:
    call = TuneCall("frequency", phase_margin_deg=60.0, t_max_db=-20.0, t_max_frequency=10.0)
    request = call.request(read_process("P1"), 0.01)
    assert request.phase_margin == math.radians(60.0)
    assert (request.t_max, request.s_max) == (Bound(-20.0, 10.0), None)
    assert (request.crossover, request.index, request.via, request.rule) == (None, "itae", "none", None)
