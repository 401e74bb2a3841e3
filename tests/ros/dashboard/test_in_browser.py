"""The live page in a real browser, against the real nodes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import pytest

from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import read_process
from fopid_msgs.msg import FopidState

from ...chromium import NEEDS_BROWSER, Browser, Page
from ..conftest import Graph, own_graph
from .live_page import Dashboard

pytestmark = NEEDS_BROWSER

GAINS = ("kp", "ki", "kd", "lam", "mu")
START = {"kp": 0.68, "ki": 0.29}
TUNER = {"process": "P1", "phase_margin": math.radians(80), "crossover": 0.3}

INK = """(plot, red, green, blue) => {
  const shown = document.querySelector(`#${plot} canvas`);
  const copy = new OffscreenCanvas(shown.width, shown.height).getContext("2d", { willReadFrequently: true });
  copy.drawImage(shown, 0, 0);
  const { data } = copy.getImageData(0, 0, shown.width, shown.height);
  let count = 0;
  for (let i = 0; i < data.length; i += 4) {
    const off = Math.abs(data[i] - red) + Math.abs(data[i + 1] - green) + Math.abs(data[i + 2] - blue);
    if (data[i + 3] > 100 && off < 40) count++;
  }
  return count;
}"""
CURVES = {
    "plot-loop": [(134, 144, 155), (47, 127, 193)],
    "plot-control": [(43, 154, 102)],
    "plot-parts": [(47, 127, 193), (43, 154, 102), (142, 107, 191)],
}
"""The colours of each plot's curves."""


class Loop3:
    """Plant, controller and tuner with a dashboard, all in processes of their own."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        graph.start("plant_simulator", {"process": "P1"})
        self.controller = graph.start("fopid_controller", START)
        graph.start("fopid_tuner", TUNER)
        self.dashboard = Dashboard(graph)
        states = graph.listen(FopidState, "fopid_controller/state")
        graph.until(lambda: self._begin() and states, "a loop that runs")

    def _begin(self) -> bool:
        return self.dashboard.ask("signal", {"signal": "setpoint", "value": 1.0})[0] == 200

    def gains(self) -> list[float]:
        return self.graph.get("fopid_controller", *GAINS)

    def restore(self) -> None:
        """The gains at the start."""
        first = {"kp": 0.68, "ki": 0.29, "kd": 0.0, "lam": 1.0, "mu": 1.0, "mode": "auto"}
        self.graph.until(lambda: self.dashboard.ask("parameters", first)[0] == 200, "the gains at the start")


@pytest.fixture(scope="module")
def module_loop(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Loop3]:
    with own_graph(tmp_path_factory.mktemp("graph")) as graph:
        yield Loop3(graph)


@pytest.fixture
def loop(module_loop: Loop3) -> Loop3:
    module_loop.graph.parameters("fopid_controller")
    module_loop.restore()
    return module_loop


@pytest.fixture
def page(loop: Loop3, browser: Browser) -> Iterator[Page]:
    page = browser.open(loop.dashboard.address)
    ready(page)
    yield page
    assert page.complaints() == []
    page.close()


def ready(page: Page) -> None:
    page.until("!document.querySelector('#kp').disabled && !document.querySelector('#tune-start').disabled", "a page")
    for name, value in (("kp", "0.68"), ("ki", "0.29"), ("lam", "1")):
        page.until(f"document.querySelector('#{name}-value').value === '{value}'", "the gains")
    page.until("document.querySelector('#prediction-of').textContent.startsWith('On the')", "the tuner's process")


def ink(page: Page, plot: str, colour: tuple[int, int, int]) -> int:
    return page.run(f"({INK})({plot!r}, {', '.join(map(str, colour))})")


def test_curves_appear_and_move(page: Page) -> None:
    page.write("#setpoint-value", "1.5")
    page.click("#setpoint button")
    page.until("document.querySelector('#now-setpoint').textContent === '1.5'", "the setpoint")
    for plot, colours in CURVES.items():
        for colour in colours:
            page.until(f"({INK})({plot!r}, {', '.join(map(str, colour))}) > 15", f"a curve in {plot}")
    before = page.run("document.querySelector('#plot-loop canvas').toDataURL()")
    page.until(f"document.querySelector('#plot-loop canvas').toDataURL() !== {before!r}", "a curve that moves")
    page.until("Number(document.querySelector('#now-measurement').textContent) > 0.1", "a measurement that rises")


@pytest.mark.slow
def test_a_paused_page_stands_still_and_goes_on(page: Page) -> None:
    page.until(f"({INK})('plot-loop', 47, 127, 193) > 15", "a curve")
    page.click("#pause")
    page.run("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    before = page.run("document.querySelector('#plot-loop canvas').toDataURL()")
    page.run("new Promise((done) => setTimeout(done, 300))")
    assert page.run("document.querySelector('#plot-loop canvas').toDataURL()") == before
    page.click("#pause")
    page.until(f"document.querySelector('#plot-loop canvas').toDataURL() !== {before!r}", "a curve that moves")


def test_sliders_reach_the_controller_when_applied_and_not_before(page: Page, loop: Loop3) -> None:
    page.run("document.querySelector('#kp').focus()")
    page.press("ArrowRight")
    page.run("document.querySelector('#lam').focus()")
    page.press("End")
    moved = float(page.run("document.querySelector('#kp-value').value"))
    assert moved > 0.68
    assert loop.gains() == [0.68, 0.29, 0.0, 1.0, 1.0]
    page.click("#apply")  # on the tuner's process these would not hold the loop: it takes a second word
    page.until("document.querySelector('#gains-answer').textContent.includes('would be unstable')", "a warning")
    assert loop.gains() == [0.68, 0.29, 0.0, 1.0, 1.0]
    page.click("#apply")
    page.until("document.querySelector('#gains-answer').textContent.includes('lam = 2')", "the answer")
    assert loop.gains() == [moved, 0.29, 0.0, 2.0, 1.0]
    page.until(f"document.querySelector('#kp-note').textContent.includes('runs with {moved:g}')", "the new gain")
    page.until("document.querySelector('#apply').disabled", "nothing more to apply")


def test_sliders_stay_within_what_the_controller_allows(page: Page) -> None:
    for name, ends in (("lam", (0.0, 2.0)), ("mu", (0.0, 2.0)), ("kp", (0.068, 6.8)), ("kd", (0.0, 1.0))):
        for key, end in zip(("Home", "End"), ends, strict=True):
            page.run(f"document.querySelector('#{name}').focus()")
            page.press(key)
            assert float(page.run(f"document.querySelector('#{name}-value').value")) == pytest.approx(end)
    page.click("#discard")
    assert page.run("document.querySelector('#kp-value').value") == "0.68"


def test_a_set_that_is_rejected_is_shown_with_its_reason(page: Page, loop: Loop3) -> None:
    page.write("#kp-value", "3")
    page.write("#lam-value", "2.5")
    # The browser itself logs the refusal; that is no fault of the page.
    page.click("#apply")
    page.until("document.querySelector('#gains-answer').textContent.includes('lam = 2.5')", "the reason")
    assert loop.gains() == [0.68, 0.29, 0.0, 1.0, 1.0]
    page.events = [e for e in page.events if "409" not in str(e)]
    page.click("#discard")


def tune(page: Page, title: str) -> None:
    """Press the button, and wait for this title of the result, with what was answered where it does not come."""
    page.click("#tune-start")
    answered = "document.querySelector('#tune-answer').textContent"
    page.until(f"{answered} !== ''", "an answer", 120.0)
    assert page.run(answered) == "Done"
    page.until(f"document.querySelector('#result-title').innerText === '{title}'", "the result")


def test_tuning_is_applied_shown_and_taken_back(page: Page, loop: Loop3) -> None:
    tune(page, "Tuned by frequency, applied")
    gains = loop.gains()
    reached = margins(Loop(read_process("P1"), Fopid(*gains)))
    assert reached.phase_margin == pytest.approx(math.radians(80), abs=1e-6)
    page.until(f"document.querySelector('#result-measures').innerText.includes('{gains[0]:.6g}')", "its measures")
    measures = page.text("#result-measures")
    assert "80.0°" in measures
    assert f"{reached.ms:.3f}" in measures
    page.until(f"document.querySelector('#kp-value').value === '{gains[0]:.6g}'", "the new gains on the sliders")
    page.click("#rollback")
    page.until("document.querySelector('#kp-value').value === '0.68'", "the gains from before")
    assert loop.gains() == [0.68, 0.29, 0.0, 1.0, 1.0]


def test_tuning_in_time_without_applying_leaves_the_gains_and_can_be_taken_over(page: Page, loop: Loop3) -> None:
    page.run("document.querySelector('#tune-method').value = 'time'")
    page.run("document.querySelector('#tune-method').dispatchEvent(new Event('change'))")
    assert page.run("document.querySelector('#tune-crossover').offsetParent === null")
    page.write("#tune-ms_max", "1.6")
    page.click("#tune-apply")
    tune(page, "Tuned by time, not applied")
    assert loop.gains() == [0.68, 0.29, 0.0, 1.0, 1.0]
    page.until("!document.querySelector('#result-take').disabled", "the button")
    page.click("#result-take")
    page.click("#apply")
    page.until("document.querySelector('#gains-answer').textContent.includes('kp = ')", "the answer")
    assert margins(Loop(read_process("P1"), Fopid(*loop.gains()))).ms <= 1.6 * (1 + 1e-4)  # six digits are shown


@pytest.mark.slow
def test_mode_and_control_by_hand(page: Page, loop: Loop3) -> None:
    page.click("input[value=manual]")
    page.until("document.querySelector('#manual').offsetParent !== null", "the field for the control")
    page.write("#manual-value", "0.4")
    page.click("#manual button")
    page.until("document.querySelector('#now-control').textContent === '0.4'", "the control")
    page.click("input[value=auto]")
    page.until("document.querySelector('#connection').textContent.includes('auto')", "automatic mode")
    assert loop.graph.get("fopid_controller", "mode") == ["auto"]


@pytest.mark.slow
def test_two_browsers_show_the_same(page: Page, loop: Loop3, browser: Browser) -> None:
    other = browser.open(loop.dashboard.address)
    ready(other)
    page.write("#ki-value", "0.31")
    page.click("#apply")
    other.until("document.querySelector('#ki-value').value === '0.31'", "the other page's gain")
    assert other.complaints() == []
    other.close()


def test_without_the_token_the_page_only_reads(loop: Loop3, browser: Browser) -> None:
    page = browser.open(loop.dashboard.read_only_address)
    page.until("document.querySelector('#access').textContent.startsWith('Read only')", "a word on it")
    page.until(f"({INK})('plot-loop', 47, 127, 193) > 15", "a curve")
    page.until("document.querySelector('#kp-value').value === '0.68'", "the gains")
    changing = "#gains input, #mode, #setpoint input, #setpoint button, #tune input, #tune-start, #apply, #rollback"
    assert page.run(f"[...document.querySelectorAll('{changing}')].every((part) => part.disabled)")
    assert page.complaints() == []
    page.close()


def test_a_wrong_token_is_refused_and_forgotten(loop: Loop3, browser: Browser) -> None:
    page = browser.open(f"{loop.dashboard.read_only_address}#token=wrong")
    page.until("document.querySelector('#access').textContent.startsWith('Read only')", "a word on it")
    page.until("sessionStorage.length === 0", "it")
    refusals = page.complaints()
    assert refusals
    assert all("401" in text for text in refusals)
    page.close()


def test_the_token_stays_neither_in_the_address_nor_in_requests(page: Page, loop: Loop3) -> None:
    assert page.run("location.href") == loop.dashboard.read_only_address
    requested = page.requested()
    assert all(address.startswith(loop.dashboard.read_only_address) for address in requested), requested
    assert not any(loop.dashboard.token in address.partition("#")[0] for address in requested)


@pytest.mark.parametrize(("width", "dark"), [(1280, True), (400, False)])
def test_everything_fits_in_light_and_dark(loop: Loop3, browser: Browser, width: int, dark: bool) -> None:
    page = browser.open(loop.dashboard.address, width, 900, dark=dark)
    ready(page)
    assert page.run("document.documentElement.scrollWidth") <= width
    assert page.run("""[...document.querySelectorAll("input, button, select, canvas")]
        .filter((element) => element.offsetParent)
        .map((element) => element.getBoundingClientRect())
        .every(({ left, right }) => left >= 0 && right <= document.documentElement.clientWidth + 0.5)""")
    paper = page.run("getComputedStyle(document.body).backgroundColor")
    assert paper == ("rgb(20, 23, 26)" if dark else "rgb(255, 255, 255)")
    assert page.complaints() == []
    page.close()


def test_everything_that_can_be_used_has_a_name_for_those_who_do_not_see(page: Page) -> None:
    roles = {"button", "slider", "spinbutton", "combobox", "textbox", "checkbox", "radio", "image"}
    page.call("Accessibility.enable")
    nodes = page.call("Accessibility.getFullAXTree")["nodes"]
    used = [n for n in nodes if not n.get("ignored") and n["role"]["value"] in roles]
    assert {n["role"]["value"] for n in used} >= {"button", "slider", "spinbutton", "combobox", "radio"}
    nameless = [n["role"]["value"] for n in used if not n.get("name", {}).get("value")]
    assert nameless == []
    assert sum(n["role"]["value"] == "slider" for n in used) == 5


@pytest.mark.slow
def test_everything_can_be_reached_with_the_keyboard(page: Page) -> None:
    page.write("#kp-value", "0.7")  # so that Apply and Discard can be used
    wanted = set(
        page.run("""[...document.querySelectorAll("input, button, select")]
        .filter((element) => element.offsetParent && !element.disabled)
        .filter((element) => element.type !== "radio" || element.checked)
        .map((element) => element.id || element.name || element.innerText)""")
    )
    page.run("document.activeElement.blur()")
    reached = set()
    for _ in range(2 * len(wanted) + 20):  # plots and headings can be reached as well
        page.call("Input.dispatchKeyEvent", type="keyDown", key="Tab", code="Tab", windowsVirtualKeyCode=9)
        page.call("Input.dispatchKeyEvent", type="keyUp", key="Tab", code="Tab", windowsVirtualKeyCode=9)
        reached.add(page.run("((e) => e.id || e.name || e.innerText)(document.activeElement)"))
    assert wanted <= reached


@pytest.mark.slow
def test_the_page_outlives_controller_and_server(graph: Graph, browser: Browser) -> None:
    graph.environment["FOPID_DASHBOARD_TOKEN"] = "a token for two lives"
    controller = graph.start("fopid_controller", START)
    first = Dashboard(graph)
    page = browser.open(f"{first.address}#token=a%20token%20for%20two%20lives")
    page.until("document.querySelector('#kp-value').value === '0.68'", "the gains")
    controller.terminate()
    page.until("document.querySelector('#connection').textContent.startsWith('no controller')", "a word on its end")
    graph.start("fopid_controller", {"kp": 0.9})
    page.until("document.querySelector('#kp-value').value === '0.9'", "the second controller's gains")
    first.process.terminate()
    assert first.process.wait(10) == 0
    page.until("document.querySelector('#connection').textContent.startsWith('no connection')", "a word on it")
    Dashboard(graph, port=first.port)
    page.until("document.querySelector('#connection').textContent.startsWith('/fopid_controller')", "the connection")
    page.until("!document.querySelector('#kp').disabled", "the right to change")
    page.close()


def test_a_complaint_would_be_noticed(browser: Browser, tmp_path: Path) -> None:
    (tmp_path / "loud.html").write_text(
        "<script>console.error('oh'); nothing.here</script><img src='http://127.0.0.1:9/'>"
    )
    page = browser.open((tmp_path / "loud.html").as_uri())
    page.until("true", "it")
    assert len(page.complaints()) >= 2
    page.close()
