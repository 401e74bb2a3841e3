"""The SROS2 policy allows what the running nodes use, and nothing that they do not use."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable, Iterable
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from rclpy.node import NodeNameNonExistentError

from .conftest import BIN, Graph
from .dashboard.live_page import Dashboard

CONFIG = Path(__file__).parents[2] / "src/fopid_ros/config"
POLICY = CONFIG / "sros2_policy.xml"
LOOP = ("plant_simulator", "fopid_controller", "fopid_tuner", "dashboard", "autotune")

SIGNALS = {("subscribe", name) for name in ("setpoint", "measurement", "control")}

Use = tuple[str, str]
"""What a node does (publish, subscribe, reply, request, execute, call), and the name of a topic, service or action."""

ACTION_SERVER = {"/_action/send_goal": "reply", "/_action/cancel_goal": "reply", "/_action/get_result": "reply",
                 "/_action/feedback": "publish", "/_action/status": "publish"}  # fmt: skip
ACTION_CLIENT = {"reply": "request", "publish": "subscribe"}


def allowed() -> dict[str, set[Use]]:
    """What the policy allows each node; each has an enclave of its own."""
    nodes = {}
    for enclave in ET.parse(POLICY).iter("enclave"):
        (profile,) = enclave.iter("profile")
        assert enclave.get("path") == f"/{profile.get('node')}"
        rules = nodes.setdefault(str(profile.get("node")), set())
        for group in profile:
            for use, permission in group.attrib.items():
                assert permission == "ALLOW"
                for one in group:
                    assert (use, str(one.text)) not in rules, f"{use} {one.text} twice"
                    rules.add((use, str(one.text)))
    return nodes


def with_actions(uses: Iterable[Use]) -> set[Use]:
    """Uses in which the five parts of an action are one."""
    plain = set(uses)
    for action in {name.partition("/_action/")[0] for _, name in uses if "/_action/" in name}:
        server = {(use, action + part) for part, use in ACTION_SERVER.items()}
        client = {(ACTION_CLIENT[use], name) for use, name in server}
        for parts, use in ((server, "execute"), (client, "call")):
            if parts <= plain:
                plain = plain - parts | {(use, action)}
    return plain


class Watch:
    """Keeps what the nodes of a graph have been seen to use; what is opened for a moment, too."""

    def __init__(self, graph: Graph) -> None:
        node = graph.node
        self._graph, self._seen = graph, {}
        self._kinds: dict[str, Callable[[str, str], list[tuple[str, list[str]]]]] = {
            "publish": node.get_publisher_names_and_types_by_node,
            "subscribe": node.get_subscriber_names_and_types_by_node,
            "reply": node.get_service_names_and_types_by_node,
            "request": node.get_client_names_and_types_by_node,
        }

    def saw(self, names: Iterable[str]) -> bool:
        """Look; whether nodes of these names have been seen by now."""
        self.look()
        return set(names) <= set(self._seen)

    def look(self) -> None:
        for name, namespace in self._graph.node.get_node_names_and_namespaces():
            for use, ask in self._kinds.items():
                try:
                    found = {(use, topic.removeprefix("/")) for topic, _ in ask(name, namespace)}
                except NodeNameNonExistentError:  # it has ended meanwhile
                    continue
                self._seen.setdefault(name, set()).update(found)

    def used(self, names: Iterable[str]) -> dict[str, set[Use]]:
        return {name: with_actions(self._seen[name]) for name in names}


@pytest.mark.slow
def test_the_policy_allows_what_the_nodes_of_a_loop_use_and_no_more(graph: Graph) -> None:
    watch = Watch(graph)
    page = Dashboard(graph)  # it reads the loop's own topics only while there is no controller
    graph.until(
        lambda: watch.saw(["dashboard"]) and watch.used(["dashboard"])["dashboard"] >= SIGNALS, "its subscriptions"
    )
    graph.start("plant_simulator", {"process": "1/((0.1s+1)(0.03s+1))"})
    graph.start("fopid_controller", {"kp": 0.8, "ki": 6.0, "setpoint.initial": 1.0, "tracking.enabled": True})
    graph.start("fopid_tuner", {})
    graph.until(lambda: graph.node.count_publishers("/control"), "the loop")
    asked = subprocess.Popen([str(BIN / "autotune"), "--deviation-max", "0.3"], env=graph.environment)
    graph.until(lambda: watch.saw(LOOP) and graph.node.count_publishers("/feedforward"), "the excitation")
    watch.look()
    assert page.ask("signal", {"signal": "setpoint", "value": 1.0})[0] == 200
    assert page.ask("signal", {"signal": "manual_control", "value": 1.0})[0] == 200
    graph.until(lambda: watch.look() or graph.node.count_publishers("/manual_control"), "the page's publisher")
    watch.look()
    asked.terminate()
    asked.wait(10)
    compare(watch.used(LOOP))


@pytest.mark.slow
def test_the_policy_allows_what_an_experiment_uses_and_no_more(graph: Graph, tmp_path: Path) -> None:
    watch = Watch(graph)
    file = tmp_path / "step.yaml"
    file.write_text("name: step\nprocess: P1\ngains: {kp: 1.0}\nphases: [{name: step, duration: 200, setpoint: 1}]\n")
    command = [str(BIN / "experiment"), str(file), "--start-nodes", "--no-report", "--out", str(tmp_path / "run")]
    running = subprocess.Popen(command, env=graph.environment, stdout=subprocess.DEVNULL)
    graph.until(lambda: watch.look() or running.poll() is not None, "the end of the experiment", 100.0)
    assert running.returncode == 0
    compare(watch.used(["experiment"]))


def compare(used: dict[str, set[Use]]) -> None:
    """Used and allowed must be the same; ``/clock`` is for simulated time, which not every run has."""
    rules = allowed()
    assert set(rules) == {*LOOP, "experiment"}
    for name, uses in used.items():
        clock = {("publish", "clock"), ("subscribe", "clock")}
        assert uses - rules[name] == set(), f"{name} uses what is not allowed"
        assert rules[name] - uses - clock == set(), f"{name} is allowed what it does not use"


def test_this_fast_dds_cannot_enforce_it(tmp_path: Path) -> None:
    """The wheels' Fast DDS is built without its security plugins: a node that is told to enforce does not start."""
    (tmp_path / "enclaves").mkdir()
    secured = {
        "ROS_SECURITY_ENABLE": "true",
        "ROS_SECURITY_STRATEGY": "Enforce",
        "ROS_SECURITY_KEYSTORE": str(tmp_path),
    }
    environment = {**os.environ, **secured}
    ended = subprocess.run(
        [str(BIN / "plant_simulator")], env=environment, capture_output=True, text=True, timeout=60, check=False
    )
    if "security libraries" not in ended.stderr:
        pytest.skip(f"another DDS, or one with security: {ended.stderr[-200:]}")
    assert ended.returncode == 2
