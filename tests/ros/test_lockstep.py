"""In lockstep the loop over ROS is the offline simulation, bit for bit."""

from __future__ import annotations

import pytest

from fopid_core.model.fopid import Fopid
from fopid_core.model.process import read_process
from fopid_core.runtime.controller import ControllerSettings, FopidController, with_gains
from fopid_core.runtime.convolved_plant import plant_of
from fopid_core.runtime.plant import Plant, PlantSettings
from fopid_core.runtime.simulation import simulate
from tests.cases import slow

from .conftest import Graph, LockstepLoop

ITAE = {"kp": 2.9692, "ki": 0.8028, "kd": 1.3394, "lam": 1.0138, "mu": 0.6074}
TABLE_3 = {"kp": 0.9116, "ki": 0.2526, "kd": 0.2023, "lam": 1.1577, "mu": 0.9973}
H = 0.01


def offline(process: str, samples: int, change_at: int, disturb_at: int, **plant: object):
    simulated = Plant(PlantSettings(read_process(process), sample_time=H, **plant))
    settings = ControllerSettings(Fopid(**ITAE), sample_time=H)
    controller = FopidController(settings)
    actions = {change_at: lambda c, _: c.reconfigure(with_gains(settings, Fopid(**TABLE_3)))}
    return simulate(controller, simulated, samples, lambda k: 1.0 if k < change_at else 2.0,
                    lambda k: 0.0 if k < disturb_at else -0.25, actions)  # fmt: skip


@pytest.mark.parametrize(
    ("process", "plant"),
    [
        ("P1", {"noise_std": 0.01, "seed": 7}),
        *slow(
            ("2/((s+1)(0.3s+1)) * exp(-0.123s)", {"delay_model": "exact"}),
            ("(1-0.2s)/(s+1)^2 * exp(-0.5s)", {"delay_model": "pade", "pade_order": 4}),
        ),
    ],
)
def test_trace_equals_the_offline_simulation_bit_for_bit(graph: Graph, process: str, plant: dict) -> None:
    loop = LockstepLoop(graph, process, ITAE, H, plant=plant)
    loop.publish("setpoint", 1.0)
    loop.advance(400 * H)
    loop.publish("setpoint", 2.0)
    assert graph.set("fopid_controller", **TABLE_3).successful
    loop.advance(700 * H)
    loop.publish("disturbance", -0.25)
    loop.advance(1000 * H)

    expected = offline(process, 1000, 400, 700, **plant)
    assert [m.value for m in loop.measurements] == list(expected.measurement)
    assert [m.value for m in loop.controls] == list(expected.control)
    assert [s.setpoint for s in loop.states] == list(expected.setpoint)
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in loop.measurements]
    assert stamps == [k * 10_000_000 for k in range(1000)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("process", "holding"), [("1/(s+1+0.5*exp(-s))", 1.5), ("2/(s^1.4+1) * exp(-0.123s)", 0.5)], ids=["inner", "orders"]
)
def test_a_process_without_a_state_runs_in_the_loop_as_it_does_offline(
    graph: Graph, process: str, holding: float
) -> None:
    gains, h, samples = {"kp": 0.4, "ki": 0.4}, 0.05, 500
    loop = LockstepLoop(graph, process, gains, h)
    loop.publish("setpoint", 1.0)
    loop.advance(samples * h)

    controller = FopidController(ControllerSettings(Fopid(**gains), sample_time=h))
    expected = simulate(controller, plant_of(PlantSettings(read_process(process), h)), samples, lambda _: 1.0)
    assert [m.value for m in loop.measurements] == pytest.approx(list(expected.measurement), abs=1e-9)
    assert [m.value for m in loop.controls] == pytest.approx(list(expected.control), abs=1e-9)
    # At rest the control is the setpoint over the process's steady-state gain.
    assert loop.measurements[-1].value == pytest.approx(1.0, abs=0.02)
    assert loop.controls[-1].value == pytest.approx(holding, abs=0.02 * holding)


def test_the_plant_waits_for_a_controller_that_comes_late(graph: Graph) -> None:
    plant = {"trigger": "lockstep", "process": "P1", "advance_until": 1.0}
    graph.start("plant_simulator", plant)
    from fopid_msgs.msg import ScalarStamped

    # The plant's own samples: the loop may have run to its end before the controller's are heard here.
    measurements = graph.listen_once(ScalarStamped, "/measurement")
    graph.until(lambda: graph.node.count_publishers("/measurement"), "the plant")
    graph.spin(0.5)
    graph.start("fopid_controller", {"trigger": "lockstep", "kp": 1.0})
    graph.until(lambda: len(measurements) >= 100, "all 100 samples")


def test_reset_starts_the_same_run_anew(graph: Graph) -> None:
    from std_srvs.srv import Trigger

    loop = LockstepLoop(graph, "P1", ITAE, H, plant={"noise_std": 0.1, "seed": 3})
    loop.publish("setpoint", 1.0)
    loop.advance(1.0)
    assert graph.call(Trigger, "plant_simulator/reset").success
    graph.until(lambda: len(loop.controls) >= 200, "the second run")
    first, second = loop.controls[:100], loop.controls[100:200]
    assert [m.value for m in first] == [m.value for m in second]


@pytest.mark.slow
def test_two_namespaces_on_one_domain_do_not_touch(graph: Graph) -> None:
    left = LockstepLoop(graph, "P1", ITAE, H, namespace="left")
    right = LockstepLoop(graph, "P2", TABLE_3, H, namespace="right")
    left.publish("setpoint", 1.0)
    right.publish("setpoint", -3.0)
    left.advance(2.0)
    right.advance(2.0)
    for loop, process, gains, setpoint in ((left, "P1", ITAE, 1.0), (right, "P2", TABLE_3, -3.0)):
        controller = FopidController(ControllerSettings(Fopid(**gains), sample_time=H))
        plant = Plant(PlantSettings(read_process(process), sample_time=H))
        expected = simulate(controller, plant, 200, lambda _, value=setpoint: value)
        assert [m.value for m in loop.measurements] == list(expected.measurement)
