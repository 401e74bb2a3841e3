"""The layouts for PlotJuggler and Foxglove name topics and fields that exist."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest
from std_srvs.srv import SetBool

from fopid_msgs.msg import FopidState
from fopid_msgs.srv import Tune
from fopid_ros.common.signals import SignalType

LAYOUTS = Path(__file__).parents[3] / "layouts"
TOPICS = {
    "/setpoint": "fopid_msgs/msg/ScalarStamped",
    "/measurement": "fopid_msgs/msg/ScalarStamped",
    "/control": "fopid_msgs/msg/ScalarStamped",
    "/fopid_controller/state": "fopid_msgs/msg/FopidState",
    "/fopid_tuner/result": "fopid_msgs/msg/TuningResult",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
SERVICES = {"/fopid_tuner/tune": Tune, "/fopid_controller/set_auto": SetBool}


def assert_number(topic: str, field: str) -> None:
    """The field is there and can be drawn."""
    if field == "saturated":  # PlotJuggler draws it as 0 and 1
        assert FopidState.get_fields_and_field_types()[field] == "boolean"
    else:
        SignalType(TOPICS[topic], field)  # raises where there is no number


@pytest.fixture(scope="module")
def foxglove() -> dict[str, Any]:
    return json.loads((LAYOUTS / "foxglove.json").read_text())


def panels_of(tree: Any) -> Iterator[str]:
    if isinstance(tree, str):
        yield tree
    else:
        assert set(tree) == {"direction", "first", "second", "splitPercentage"}
        assert tree["direction"] in ("row", "column")
        assert 0 < tree["splitPercentage"] < 100
        yield from panels_of(tree["first"])
        yield from panels_of(tree["second"])


def test_foxglove_layout_has_what_an_exported_one_has(foxglove: dict) -> None:
    assert set(foxglove) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    shown = list(panels_of(foxglove["layout"]))
    for name in list(shown):
        for tab in foxglove["configById"][name].get("tabs", []):
            shown += panels_of(tab["layout"])
    assert sorted(shown) == sorted(foxglove["configById"])
    kinds = {name.split("!")[0] for name in shown}
    assert kinds == {"Plot", "RawMessages", "Parameters", "CallService", "DiagnosticSummary", "Tab"}


def test_foxglove_plots_draw_fields_that_exist(foxglove: dict) -> None:
    paths = [path["value"] for config in foxglove["configById"].values() for path in config.get("paths", [])]
    assert {"/setpoint.value", "/measurement.value", "/control.value"} <= set(paths)
    for path in paths:
        topic, _, field = path.partition(".")
        assert_number(topic, field)


def test_foxglove_panels_name_topics_and_services_that_exist(foxglove: dict) -> None:
    configs = foxglove["configById"].values()
    topics = {config[key] for config in configs for key in ("topicPath", "topicToRender") if key in config}
    assert topics == {"/fopid_controller/state", "/fopid_tuner/result", "/diagnostics"}
    for config in configs:
        if "serviceName" in config:
            request = SERVICES[config["serviceName"]].Request()
            for name, value in json.loads(config["requestPayload"]).items():
                setattr(request, name, value)  # raises for a field that is not there, or of another type


@pytest.fixture(scope="module")
def plotjuggler() -> ET.Element:
    return ET.parse(LAYOUTS / "plotjuggler.xml").getroot()


def test_plotjuggler_layout_is_tabs_of_docked_plots(plotjuggler: ET.Element) -> None:
    assert plotjuggler.tag == "root"
    tabs = plotjuggler.findall("tabbed_widget[@parent='main_window']/Tab")
    plots = plotjuggler.findall("tabbed_widget/Tab/Container/DockSplitter/DockArea/plot")
    assert len(tabs) >= 3
    assert len(plots) == len(plotjuggler.findall(".//plot")) >= len(tabs)
    for splitter in plotjuggler.iter("DockSplitter"):
        sizes = [float(size) for size in splitter.get("sizes").split(";")]
        assert len(sizes) == int(splitter.get("count")) == len(splitter)
        assert sum(sizes) == pytest.approx(1.0, abs=1e-5)
    assert all(plot.findall("curve") for plot in plots)


def test_plotjuggler_curves_are_fields_that_exist(plotjuggler: ET.Element) -> None:
    streamer = plotjuggler.find("Plugins/plugin[@ID='ROS2 Topic Subscriber']")
    selected = streamer.find("selected_topics").get("value").split(";")
    assert set(selected) < set(TOPICS)
    assert plotjuggler.find("previouslyLoaded_Streamer").get("name") == streamer.get("ID")
    names = [curve.get("name") for curve in plotjuggler.iter("curve")]
    assert "/fopid_controller/state/setpoint" in names
    for name in names:
        topic = next(topic for topic in selected if name.startswith(f"{topic}/"))
        assert_number(topic, name.removeprefix(f"{topic}/").replace("/", "."))
