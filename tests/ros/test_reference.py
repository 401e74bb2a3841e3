"""The page of topics, services and actions says what the running nodes say."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from rclpy.action import get_action_server_names_and_types_by_node

from .conftest import Graph

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "topics.md"
pytestmark = pytest.mark.slow

RCLPY = ("/parameter_events", "/rosout")


def rows(columns: int) -> list[tuple[str, ...]]:
    """The rows of the page's tables with so many columns, without their marks."""
    found = [tuple(cell.strip(" `") for cell in line.strip("|").split("|")) for line in PAGE.read_text().splitlines()
             if line.startswith("| `")]  # fmt: skip
    return [row for row in found if len(row) == columns]


def resolved(node: str, name: str) -> str:
    return f"/{node}/{name[2:]}" if name.startswith("~/") else f"/{name.lstrip('/')}"


def test_the_page_and_the_nodes_agree(graph: Graph) -> None:
    graph.start("plant_simulator", {"trigger": "lockstep", "advance_until": 0.0})
    graph.start("fopid_controller", {"trigger": "lockstep", "tracking.enabled": True})
    graph.start("fopid_tuner", {"process": "P1"})
    table = rows(4)
    topics = {row for row in table if row[1] in ("subscribes", "publishes")}
    served = {row[:3] for row in table if row[1] not in ("subscribes", "publishes")}
    nodes = sorted({row[0] for row in topics})

    def told(node: str) -> set[tuple[str, str, str]]:
        names = graph.node.get_subscriber_names_and_types_by_node(node, "/")
        out = graph.node.get_publisher_names_and_types_by_node(node, "/")
        found = {("subscribes", name, kind) for name, (kind,) in names} | {
            ("publishes", name, kind) for name, (kind,) in out
        }
        return {row for row in found if row[1] not in RCLPY and "lifecycle" not in row[2] and "/_action/" not in row[1]}

    def asked(node: str) -> set[tuple[str, str, str]]:
        later = ("publishes", "/feedforward")  # the tuner's, during ~/autotune alone
        rows = {(way, resolved(node, name), kind) for owner, way, name, kind in topics if owner == node}
        return {row for row in rows if node != "fopid_tuner" or row[:2] != later}

    def services(node: str) -> set[tuple[str, str]]:
        names = graph.node.get_service_names_and_types_by_node(node, "/")
        actions = get_action_server_names_and_types_by_node(graph.node, node, "/")
        found = {(name, kind) for name, (kind,) in [*names, *actions]}
        return {row for row in found if not re.match(r"(rcl_interfaces|lifecycle_msgs|type_description)", row[1])
                and "/_action/" not in row[0]}  # fmt: skip

    graph.until(lambda: set(nodes) <= set(graph.node.get_node_names()), "all nodes")
    graph.until(lambda: all(asked(node) <= told(node) for node in nodes), "all topics")
    graph.spin(0.5)
    for node in nodes:
        assert told(node) == asked(node)
        assert services(node) == {(resolved(owner, name), kind) for owner, name, kind in served if owner == node}
