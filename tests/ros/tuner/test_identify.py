"""The tuner learns the process from the signals of the running loop."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np
import pytest

from fopid_core.model.fopid import Fopid
from fopid_core.model.process import read_process
from fopid_core.runtime.controller import ControllerSettings, FopidController
from fopid_core.runtime.plant import Plant, PlantSettings
from fopid_core.runtime.simulation import simulate
from fopid_msgs.srv import Identify, Tune

from ..conftest import Graph, LockstepLoop, own_graph

GAINS = {"kp": 0.5, "ki": 0.3}


def step(graph: Graph, process: str, **more: Mapping[str, object]) -> None:
    """A setpoint step in a loop that the tuner listens to, and knows nothing about."""
    graph.start("fopid_tuner", {"use_sim_time": True})
    graph.parameters("fopid_tuner")
    loop = LockstepLoop(graph, process, GAINS, sample_time=0.05, **more)
    loop.publish("setpoint", 0.0)
    begin = 1.0
    loop.advance(begin)
    while "not been heard" in graph.call(Identify, "fopid_tuner/identify").message:
        begin += 1.0
        loop.advance(begin)
    loop.publish("setpoint", 1.0)
    loop.advance(begin + 40.0)


@pytest.fixture(scope="module")
def stepped(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Graph]:
    """A loop with P1 that has made its step; what is asked of it in this module leaves it as it is."""
    with own_graph(tmp_path_factory.mktemp("stepped")) as graph:
        step(graph, "P1")
        yield graph


def learnt_as(graph: Graph, process: str, template: str) -> None:
    answer = graph.call(Identify, "fopid_tuner/identify", Identify.Request(template_name=template))
    assert answer.success, answer.message
    best = answer.models[0]
    assert best.fit_pct > 99.0
    assert len(best.names) == len(best.values) == len(best.deviations)
    w = 1j * np.geomspace(0.1, 1.0, 20)
    learnt, true = read_process(best.process)(w), read_process(process)(w)
    assert np.abs(learnt / true - 1.0).max() < 0.05


def test_a_setpoint_step_of_the_running_loop_shows_the_process(stepped: Graph) -> None:
    learnt_as(stepped, "P1", "all")


@pytest.mark.slow
@pytest.mark.parametrize(("process", "template"), [("P2", "rational:3/0"), ("2/(3s+1)*exp(-0.5s)", "foptd")])
def test_so_do_other_processes_with_a_template_of_their_kind(graph: Graph, process: str, template: str) -> None:
    step(graph, process)
    learnt_as(graph, process, template)


@pytest.mark.parametrize(
    ("request_", "named"),
    [(Identify.Request(template_name="nioptd9"), "nioptd9"), (Identify.Request(duration=0.5), "samples")],
)
def test_what_cannot_be_done_is_named(stepped: Graph, request_: Identify.Request, named: str) -> None:
    answer = stepped.call(Identify, "fopid_tuner/identify", request_)
    assert not answer.success
    assert named in answer.message
    assert math.isfinite(answer.elapsed)


def test_a_loop_at_rest_shows_nothing_and_that_is_said(stepped: Graph) -> None:
    answer = stepped.call(Identify, "fopid_tuner/identify", Identify.Request(duration=3.0))
    assert not answer.success
    assert answer.message
    assert stepped.get("fopid_tuner", "process") == [""]


def test_what_was_learnt_can_be_tuned_for(stepped: Graph) -> None:
    refused = stepped.call(Tune, "fopid_tuner/tune", Tune.Request(phase_margin=1.2, crossover=0.4))
    assert "process = ''" in refused.message
    assert stepped.call(Identify, "fopid_tuner/identify", Identify.Request(adopt=True)).success
    tuned = stepped.call(Tune, "fopid_tuner/tune", Tune.Request(phase_margin=1.2, crossover=0.4, apply=True))
    assert tuned.applied, tuned.message


@pytest.mark.slow
def test_a_tuning_in_time_takes_noise_limits_and_sample_time_from_the_loop(graph: Graph) -> None:
    """Judged by the noise in the control of the loop that then runs, not by what the answer says."""
    noise, room = 0.05, 4.0
    step(graph, "P1", plant={"noise_std": noise, "seed": 3}, controller={"control_min": 0.0, "control_max": room})
    wanted = Tune.Request(process="P1", method="time", index="iae", structure="pid", apply=True)
    answer = graph.call(Tune, "fopid_tuner/tune", wanted)
    assert answer.applied, answer.message
    assert "sample time 0.05 s" in answer.message
    assert "1 % of the range 4" in answer.message
    gains, two = answer.gains, answer.two_degrees
    controller = Fopid(gains.kp, gains.ki, gains.kd, gains.lam, gains.mu)
    slow = {name: getattr(two, name) for name in ("measurement_filter_order", "measurement_filter_time")}
    settings = ControllerSettings(controller, sample_time=0.05, **slow)
    plant = Plant(PlantSettings(read_process("P1"), sample_time=0.05, noise_std=noise, seed=11))
    control = np.array(simulate(FopidController(settings), plant, 4000, lambda _: 0.0).control)
    assert np.std(control[1000:]) < 1.15 * 0.01 * room  # an estimate of the noise from 400 samples
    others = graph.call(Tune, "fopid_tuner/tune", Tune.Request(process="P2", method="frequency"))
    assert "from the loop" not in others.message  # it is about another process than the loop's


def test_a_tuner_that_keeps_no_history_says_so(graph: Graph) -> None:
    graph.start("fopid_tuner", {"history": 0.0})
    answer = graph.call(Identify, "fopid_tuner/identify")
    assert not answer.success
    assert "history" in answer.message
