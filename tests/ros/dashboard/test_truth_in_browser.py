"""The live page tells the truth: what is dead is red, what is not known is a dash, what is huge is told as such."""

from __future__ import annotations

import itertools
import json
import time

import pytest

from fopid_msgs.msg import FopidState

from ...chromium import NEEDS_BROWSER, Browser, Page, until
from ..conftest import Graph
from .live_page import Dashboard

pytestmark = NEEDS_BROWSER

LEVEL = "document.querySelector('#health').dataset.level"


def ticks(page: Page, place: str) -> list[str]:
    """The numbers along the y axis of a plot, as its ticks are made."""
    script = f"""import("/page/plots.js").then((plots) => JSON.stringify(plots.axisLabels({place!r})))"""
    return json.loads(page.run(script))


class ToldLoop:
    """A controller that tells whatever a test wants, without being there."""

    def __init__(self, graph: Graph) -> None:
        self._graph, self._second = graph, 100.0
        self._publisher = graph.node.create_publisher(FopidState, "fopid_controller/state", 100)
        graph.until(self._publisher.get_subscription_count, "the dashboard")

    def tell(self, seconds: float = 0.1, **signals: float) -> None:
        """One tick, so many seconds after the one before."""
        self._second += seconds
        state = FopidState(sample_interval=0.1, **{"kp": 1.0, **signals})
        state.header.stamp.sec, state.header.stamp.nanosec = int(self._second), int(self._second % 1 * 1e9)
        self._publisher.publish(state)
        self._graph.spin(0.02)

    def tell_until(self, page: Page, script: str, what: str, **signals: float) -> None:
        """Go on telling until the page has it: a second after the last tick nothing of a loop is known any more."""

        def told() -> bool:
            self.tell(**signals)
            return bool(page.run(script))

        until(told, what)


def test_nothing_is_known_of_a_loop_that_is_not_there(graph: Graph, browser: Browser) -> None:
    page = browser.open(Dashboard(graph).address)
    page.until("document.querySelector('#connection').textContent.startsWith('no controller')", "a word on it")
    now = page.run("[...document.querySelectorAll('.now b')].map((value) => value.textContent)")
    assert set(now) == {"–"}
    assert page.run(LEVEL) in ("unknown", "warn")
    assert page.complaints() == []
    page.close()


@pytest.mark.parametrize("victim", ["plant", "controller"])
def test_what_dies_is_red_within_a_second_of_its_timeout(graph: Graph, browser: Browser, victim: str) -> None:
    nodes = {
        "plant": graph.start("plant_simulator", {"process": "P1"}),
        "controller": graph.start("fopid_controller", {"kp": 0.68, "ki": 0.29, "measurement_timeout": 0.5}),
    }
    dashboard = Dashboard(graph)
    page = browser.open(dashboard.address)
    graph.until(lambda: dashboard.ask("signal", {"signal": "setpoint", "value": 1.0})[0] == 200, "a setpoint")
    page.until("Number(document.querySelector('#now-measurement').textContent) > 0.01", "a loop that runs")
    nodes[victim].kill()
    killed = time.monotonic()
    page.until(f"{LEVEL} === 'error'", "red")
    # Held to a second by test_health, whose clock no neighbour can keep waiting.
    print(f"{victim} killed: red after {time.monotonic() - killed:.2f} s")
    # Of a loop without a controller the page reads the sensor itself.
    missing = {"plant": "measurement", "controller": "control"}[victim]
    page.until(f"document.querySelector('#now-{missing}').textContent === '–'", f"no present {missing}")
    word = {"plant": "stale", "controller": "no tick"}[victim]
    page.until(f"document.querySelector('#health-text').textContent.includes('{word}')", "the reason")
    page.complaints()
    page.close()


def test_a_loop_that_has_diverged_is_no_green_zero(graph: Graph, browser: Browser) -> None:
    page = browser.open(Dashboard(graph).address)
    loop = ToldLoop(graph)
    lost = {"setpoint": 1.0, "control": float("nan"), "proportional": 1e300, "integral": -1e300}
    for step in range(40):
        loop.tell(measurement=(-7.0) ** step, **lost)
    red = f"{LEVEL} === 'error' && document.querySelector('#health-text').innerText.includes('diverged')"
    loop.tell_until(page, red, "red, and why", measurement=(-7.0) ** 40, **lost)
    shown = "['measurement', 'control'].map((name) => document.querySelector(`#now-${name}`).textContent)"
    huge = f"(([measurement, control]) => measurement.includes('e+') && control === '–')({shown})"
    loop.tell_until(page, huge, "a huge number, and a dash for none", measurement=(-7.0) ** 40, **lost)
    until(lambda: any("e" in label for label in ticks(page, "plot-loop")), "an axis that tells powers of ten")
    until(lambda: len(ticks(page, "plot-parts")) >= 2, "an axis")
    assert page.complaints() == []
    page.close()


def test_rounding_noise_is_not_magnified_and_kicks_do_not_hide_the_rest(graph: Graph, browser: Browser) -> None:
    page = browser.open(Dashboard(graph).address)
    loop = ToldLoop(graph)
    loop.tell_until(page, "document.querySelector('#now-measurement').textContent === '1'", "a first tick",
                    setpoint=1.0, measurement=1.0, control=2.0)  # fmt: skip
    for step in range(300):
        noise = 1e-9 * (-1) ** step
        kick = 900.0 if step == 150 else 0.0
        loop.tell(setpoint=1.0, measurement=1.0 + noise, control=2.0 + 0.3 * (step % 10) + kick, derivative=kick)
    clipped = "document.querySelector('figure:has(#plot-control) .clipped').innerText.includes('902')"
    page.until(clipped, "a word on the kick")
    lowest, highest = (float(ticks(page, "plot-loop")[end]) for end in (0, -1))
    assert highest - lowest > 1e-3
    assert float(ticks(page, "plot-control")[-1]) < 20.0
    assert page.complaints() == []
    page.close()


def test_units_latest_values_zoom_cursor_and_files(graph: Graph, browser: Browser) -> None:
    units = ("-p", "measurement.unit:=°C", "-p", "control.unit:=V")
    page = browser.open(Dashboard(graph, "--ros-args", *units).address)
    loop = ToldLoop(graph)
    steps = itertools.count()

    def newest() -> bool:
        loop.tell(setpoint=20.0, measurement=float(next(steps)), control=0.5)
        return bool(
            page.run("""
            parseFloat(document.querySelector('#show-measurement').innerText.match(/[\\d.]+ °C/)) >= 49
            && document.querySelector('#show-control').innerText.includes('0.5 V')""")
        )

    until(newest, "the newest in the legend")
    page.run("document.querySelector('#plot-loop').focus()")
    for _ in range(4):
        page.call("Input.dispatchKeyEvent", type="keyDown", key="+", text="+")
    page.until("!document.querySelector('#live').disabled", "a stretch of the past")
    box = page.run("""(({ x, y, width, height }) => ({ x: x + width / 2, y: y + height / 2 }))(
        document.querySelector('#plot-loop .u-over').getBoundingClientRect())""")
    page.call("Input.dispatchMouseEvent", type="mouseMoved", **box)
    page.until("document.querySelectorAll('.legend .when')[2].textContent.startsWith('at ')", "one cursor in all plots")
    page.click("#live")
    saved = page.run("""Promise.all([import("/page/save.js"), import("/page/plots.js")]).then(
        async ([save, plots]) => ({
            text: save.csv(plots.shownData()), picture: (await save.picture(plots.canvases())).size }))""")
    lines = saved["text"].splitlines()
    assert lines[0].startswith("time [s],setpoint [°C],measurement [°C],control [V],proportional [V]")
    measured = [float(line.split(",")[2]) for line in lines[1:]]  # thinned out to what the page draws
    assert measured == sorted(set(measured))
    assert 49.0 <= measured[-1] < next(steps)
    assert len(measured) > 10
    assert saved["picture"] > 5000
    assert page.complaints() == []
    page.close()
