"""The tuner reparameterises the running controller, and changes nothing when it should not."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action import ActionClient

from fopid_core.design.certificate.checker import check
from fopid_core.design.specification import STRUCTURES
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import read_process
from fopid_core.model.two_degrees import MeasurementFilter, SetpointWeights
from fopid_core.runtime.controller import ControllerSettings, FopidController
from fopid_msgs.action import Autotune
from fopid_msgs.msg import TuningResult
from fopid_msgs.srv import Compare, Reduce, Tune
from fopid_ros.common.managed_node import latched_qos

from ..conftest import Graph, LockstepLoop, own_graph

PI = {"kp": 0.68, "ki": 0.29}
GAINS = ("kp", "ki", "kd", "lam", "mu")
FILTER = ("measurement_filter_order", "measurement_filter_time")
WEIGHTS = ("setpoint_weight", "derivative_setpoint_weight")


def start_tuner(graph: Graph, **parameters: object) -> None:
    graph.start("fopid_tuner", {"process": "P1", **parameters})


def test_frequency_tuning_is_applied_and_does_what_was_asked(graph: Graph) -> None:
    graph.start("fopid_controller", PI)
    start_tuner(graph)
    changes = graph.changes("fopid_controller")
    request = Tune.Request(method="frequency", phase_margin=math.radians(80), crossover=0.3, apply=True)
    answer = graph.call(Tune, "fopid_tuner/tune", request)
    assert answer.success, answer.message
    assert answer.applied
    gains = graph.get("fopid_controller", *GAINS)
    assert gains == [getattr(answer.gains, name) for name in GAINS]
    measured = margins(Loop(read_process("P1"), Fopid(*gains)))
    assert measured.phase_margin == pytest.approx(math.radians(80), abs=1e-6)
    assert measured.crossover == pytest.approx(0.3, abs=1e-6)
    graph.until(lambda: changes, "the parameter event")

    results = graph.listen(TuningResult, "fopid_tuner/result", latched_qos())
    graph.until(lambda: results, "the result for those who come late")
    assert results[0].applied
    assert results[0].previous_gains.kp == PI["kp"]
    assert [getattr(results[0].gains, name) for name in GAINS] == gains


@pytest.mark.slow
def test_with_verify_certify_the_controller_gets_the_proof_with_its_gains(graph: Graph) -> None:
    graph.start("fopid_controller", PI)
    start_tuner(graph, **{"verify.certify": True})
    request = Tune.Request(process="2/(3s+1)*exp(-0.5s)", method="rule", rule="simc-pi", apply=True)
    answer = graph.call(Tune, "fopid_tuner/tune", request)
    assert answer.applied, answer.message
    *gains, document = graph.get("fopid_controller", *GAINS, "gains.certificate")
    assert check(document) == ""
    assert json.loads(document)["gains"] == gains


@pytest.mark.slow
def test_gains_are_judged_at_the_ticks_of_the_controller_that_runs_them(graph: Graph) -> None:
    """Fine at the tuner's 10 ms, unstable at the controller's 0.5 s."""
    graph.start("fopid_controller", PI | {"sample_time": 0.5})
    start_tuner(graph, **{"verify.ticks": 0.0})
    request = Tune.Request(process="1/(0.1s+1)^2", method="rule", rule="simc-pi", apply=True)
    answer = graph.call(Tune, "fopid_tuner/tune", request)
    assert not answer.applied
    assert "with ticks of 0.5 s, is not known to be stable" in answer.message
    assert graph.get("fopid_controller", "kp") == [PI["kp"]]


@pytest.mark.long
def test_a_box_that_the_gains_do_not_bear_keeps_them_from_being_applied(graph: Graph) -> None:
    graph.start("fopid_controller", PI)
    start_tuner(graph, **{"verify.box": "K=1.5,2.5 L=0.4,0.6", "verify.ms_max": 2.5})
    request = Tune.Request(process="2/(3s+1)*exp(-0.5s)", method="rule", rule="simc-pi", apply=True)
    answer = graph.call(Tune, "fopid_tuner/tune", request)
    assert answer.applied, answer.message
    (document,) = graph.get("fopid_controller", "gains.certificate")
    assert [row[0] for row in json.loads(document)["parameters"]] == ["K", "L"]
    graph.set("fopid_tuner", **{"verify.box": "K=1.5,8 L=0.4,2"})
    answer = graph.call(Tune, "fopid_tuner/tune", request)
    assert not answer.applied
    assert "no certificate" in answer.message
    graph.set("fopid_tuner", **{"verify.box": "T=1,0"})
    assert "not applied: verify.box" in graph.call(Tune, "fopid_tuner/tune", request).message


@pytest.mark.slow
def test_time_tuning_keeps_its_bound_on_ms(graph: Graph) -> None:
    graph.start("fopid_controller", PI)
    start_tuner(graph)
    answer = graph.call(Tune, "fopid_tuner/tune", Tune.Request(method="time", index="itae", ms_max=1.6, apply=True))
    assert answer.applied, answer.message
    loop = Loop(read_process("P1"), Fopid(*graph.get("fopid_controller", *GAINS)))
    assert margins(loop).ms <= 1.6 * (1 + 1e-6)


@pytest.mark.slow
def test_a_joint_design_is_applied_with_its_filter_and_weights_at_once(graph: Graph) -> None:
    graph.start("fopid_controller", PI)
    start_tuner(graph)
    changes = graph.changes("fopid_controller")
    results = graph.listen(TuningResult, "fopid_tuner/result", latched_qos())
    request = Tune.Request(
        method="time",
        index="iae",
        input="both",
        structure="pid",
        mt_max=1.3,
        noise_max=10.0,
        filter_order=2,
        apply=True,
    )
    answer = graph.call(Tune, "fopid_tuner/tune", request)
    assert answer.applied, answer.message
    assert answer.structure == "pid"
    names = (*GAINS, *FILTER, *WEIGHTS)
    *gains, order, time, b, c = graph.get("fopid_controller", *names)
    told = answer.two_degrees
    assert [order, time, b, c] == [getattr(told, name) for name in (*FILTER, *WEIGHTS)]
    assert order == 2
    assert time > 0.0
    loop = Loop(read_process("P1"), Fopid(*gains), MeasurementFilter(order, time), SetpointWeights(b, c))
    w = np.geomspace(1e-4, math.pi / 0.01, 200_000)
    opened = loop(1j * w)
    assert np.abs(1.0 / (1.0 + opened)).max() == pytest.approx(answer.achieved.ms, rel=1e-5)
    assert np.abs(opened / (1.0 + opened)).max() <= 1.3 * (1.0 + 1e-5)
    noise = np.abs(opened / loop.process(1j * w) / (1.0 + opened)).max()
    assert noise <= 10.0 * (1.0 + 1e-5)
    assert answer.achieved.noise_gain == pytest.approx(noise, rel=1e-4)
    assert answer.achieved.running_stable
    graph.until(lambda: changes, "the parameter event")
    assert {"kp", *FILTER} <= set(changes[0]), "one change for all of it"

    # A design without a filter was verified without one: it takes the filter away, and says so.
    plain = graph.call(Tune, "fopid_tuner/tune", Tune.Request(phase_margin=1.2, crossover=0.4, apply=True))
    assert plain.applied, plain.message
    assert "now passes no filter" in plain.message
    assert graph.get("fopid_controller", *FILTER, *WEIGHTS) == [0, 0.0, b, c], "the weights are not in the loop"
    graph.until(lambda: len(results) == 2, "both results")
    assert results[1].previous_two_degrees == results[0].two_degrees == told


@pytest.mark.long
def test_compare_tells_every_design_and_which_to_take(graph: Graph) -> None:
    graph.start("fopid_controller", PI)
    start_tuner(graph)
    before = graph.get("fopid_controller", *GAINS)
    answer = graph.call(Compare, "fopid_tuner/compare", Compare.Request(process="2/(3s+1)*exp(-0.5s)", ms_max=1.5), 120)
    assert answer.success, answer.message
    taken = answer.rows[answer.recommended]
    assert taken.within
    assert taken.structure in answer.message
    assert {row.structure for row in answer.rows if row.method == "time iae"} == set(STRUCTURES)
    for row in answer.rows:
        assert row.ms <= 1.5 * (1.0 + 1e-6) or not row.within
    process = read_process("2/(3s+1)*exp(-0.5s)")
    filtered = MeasurementFilter(taken.two_degrees.measurement_filter_order, taken.two_degrees.measurement_filter_time)
    loop = Loop(process, Fopid(*(getattr(taken.gains, name) for name in GAINS)), filtered)
    w = np.geomspace(1e-4, 1e4, 100_000)
    assert np.abs(1.0 / (1.0 + loop(1j * w))).max() == pytest.approx(taken.ms, rel=1e-5)
    assert graph.get("fopid_controller", *GAINS) == before
    refused = graph.call(Compare, "fopid_tuner/compare", Compare.Request(prefer="cheap"))
    assert "'cheap'" in refused.message
    assert refused.recommended == -1


@pytest.mark.parametrize(
    ("fields", "named"),
    [
        ({"method": "time", "structure": "pidd"}, "'pidd'"),
        ({"method": "time", "input": "noise"}, "'noise'"),
        ({"method": "time", "filter_order": 3}, "filter_order = 3"),
        ({"method": "time", "mt_max": -1.0}, "mt_max = -1.0"),
        ({"method": "time", "noise_max": math.nan}, "noise_max = nan"),
        ({"method": "time", "setpoint_weights": "some"}, "'some'"),
        ({"method": "frequency", "crossover": -1.0}, "crossover = -1.0"),
        ({"method": "frequency", "crossover": math.nan}, "crossover = nan"),
        ({"method": "frequency", "phase_margin": 4.0}, "phase_margin = 4.0"),
        ({"method": "magic"}, "'magic'"),
        ({"method": "time", "index": "iaee"}, "'iaee'"),
        ({"method": "time", "ms_max": 0.5}, "ms_max = 0.5"),
        ({"method": "rule", "rule": "folklore"}, "'folklore'"),
        ({"process": "1/(s+"}, "character 6"),
        ({"process": "P9"}, "'P9'"),
        ({"t_max_db": -40.0}, "t_max_frequency"),
    ],
)
def test_bad_specifications_are_named_and_change_nothing(shared_graph: Graph, fields: dict, named: str) -> None:
    before = shared_graph.get("fopid_controller", *GAINS)
    answer = shared_graph.call(Tune, "fopid_tuner/tune", Tune.Request(apply=True, **fields))
    assert not answer.success
    assert not answer.applied
    assert named in answer.message, answer.message
    assert shared_graph.get("fopid_controller", *GAINS) == before


def test_a_design_that_cannot_be_stable_is_never_applied(shared_graph: Graph) -> None:
    before = shared_graph.get("fopid_controller", *GAINS)
    request = Tune.Request(
        process="1/(s-1) * exp(-3s)", method="frequency", phase_margin=1.0, crossover=2.0, apply=True
    )  # no controller holds an unstable pole behind so long a delay
    answer = shared_graph.call(Tune, "fopid_tuner/tune", request)
    assert not answer.applied
    assert not answer.success
    assert shared_graph.get("fopid_controller", *GAINS) == before


def test_a_design_too_fast_for_the_tick_is_never_applied(shared_graph: Graph) -> None:
    """Stable in continuous time, with a margin of less than a tick."""
    before = shared_graph.get("fopid_controller", *GAINS)
    answer = shared_graph.call(Tune, "fopid_tuner/tune", Tune.Request(process="1/(0.03s+1)", apply=True))
    assert answer.achieved.stable
    assert not answer.applied
    assert "s is below 0.02 s (verify.ticks)" in answer.message
    assert shared_graph.get("fopid_controller", *GAINS) == before


def test_without_apply_nothing_is_changed(shared_graph: Graph) -> None:
    before = shared_graph.get("fopid_controller", *GAINS)
    request = Tune.Request(method="frequency", phase_margin=1.2, crossover=0.4)
    answer = shared_graph.call(Tune, "fopid_tuner/tune", request)
    assert answer.success
    assert not answer.applied
    assert shared_graph.get("fopid_controller", *GAINS) == before


def test_reduce_names_the_template_it_prefers(shared_graph: Graph) -> None:
    answer = shared_graph.call(Reduce, "fopid_tuner/reduce", Reduce.Request(process="P2"))
    assert answer.success, answer.message
    errors = {model.template_name: model.h2_error for model in answer.models}
    assert answer.preferred == min(errors, key=errors.get) == "nioptd2"


@pytest.mark.slow
def test_while_busy_others_are_answered_and_a_second_tuning_is_refused(graph: Graph) -> None:
    start_tuner(graph)
    client = graph.client(Tune, "fopid_tuner/tune")
    graph.parameters("fopid_tuner")
    slow = Tune.Request(method="time", index="istes", process="1/(s+1)^8 * exp(-2s)")
    autotune = ActionClient(graph.node, Autotune, "fopid_tuner/autotune")
    graph.until(autotune.server_is_ready, "the action")
    first = client.call_async(slow)
    goal = autotune.send_goal_async(Autotune.Goal())
    plan = autotune.send_goal_async(Autotune.Goal(plan_only=True))
    second = client.call_async(slow)
    third = client.call_async(slow)
    assert graph.get("fopid_tuner", "controller") == ["fopid_controller"]
    answers = [graph.result(future, 60) for future in (first, second, third)]
    refused = [a for a in answers if "busy" in a.message]
    assert len(refused) == 2, [a.message for a in answers]
    assert not graph.result(goal).accepted
    assert graph.result(plan).accepted  # it leaves the loop alone, and keeps nobody from working
    assert "goal rejected: busy" in graph.logs()
    for answer in refused:  # what is not known is no number
        known = [getattr(answer.gains, name) for name in GAINS] + [answer.achieved.ms, answer.achieved.phase_margin]
        assert all(math.isnan(value) for value in known)
        assert answer.achieved.unstable_poles == -1


@pytest.mark.slow
def test_no_controller_is_said(graph: Graph) -> None:
    start_tuner(graph)
    answer = graph.call(Tune, "fopid_tuner/tune", Tune.Request(phase_margin=1.2, crossover=0.4, apply=True))
    assert not answer.success
    assert "no controller 'fopid_controller'" in answer.message


@pytest.mark.slow
def test_new_gains_are_taken_without_a_bump(graph: Graph) -> None:
    loop = LockstepLoop(graph, "P1", PI)
    start_tuner(graph)
    loop.publish("setpoint", 1.0)
    loop.advance(12.0)  # the loop still moves: a change here would show
    request = Tune.Request(method="frequency", phase_margin=math.radians(80), crossover=0.3, apply=True)
    answer = graph.call(Tune, "fopid_tuner/tune", request)
    assert answer.applied, answer.message
    loop.advance(13.0)

    gains = Fopid(*(getattr(answer.gains, name) for name in GAINS))
    always_new = FopidController(ControllerSettings(gains))
    would_be = [always_new.step(1.0, m.value) for m in loop.measurements]
    control = [m.value for m in loop.controls]
    # From the change on, each step of the control is the one that a controller with the new gains all along takes.
    for k in range(1200, 1300):
        assert control[k] - control[k - 1] == pytest.approx(would_be[k] - would_be[k - 1], abs=1e-9)


@pytest.fixture(scope="module")
def shared_graph(tmp_path_factory: pytest.TempPathFactory):
    with own_graph(tmp_path_factory.mktemp("graph")) as graph:
        graph.start("fopid_controller", PI)
        start_tuner(graph)
        yield graph


def test_the_tuner_tells_of_its_health(graph: Graph) -> None:
    start_tuner(graph)
    heard = graph.listen(DiagnosticArray, "/diagnostics")
    graph.until(lambda: heard, "diagnostics of the tuner")
    status = heard[0].status[0]
    assert status.name == "/fopid_tuner"
    assert status.message == "idle"
    assert {pair.key: pair.value for pair in status.values}["process"] == "P1"
