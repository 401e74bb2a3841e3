"""The page without ROS in a real browser."""

from __future__ import annotations

import math
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import read_process

from ....axe import problems
from ....chromium import NEEDS_BROWSER, Browser, Page

pytestmark = [*NEEDS_BROWSER, pytest.mark.timeout(300)]

FOPID = Path(sys.executable).with_name("fopid")
WIDE, NARROW = (1280, 900), (400, 850)


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    command = [FOPID, "explore", "--port", "0", "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        yield re.search(r"http://\S+", server.stdout.readline())[0]
        server.terminate()
        assert server.wait(20) == 0
        assert server.stderr is not None
        assert server.stderr.read() == ""


@pytest.fixture
def page(browser: Browser, address: str) -> Iterator[Page]:
    page = opened(browser, address)
    yield page
    assert page.complaints() == []
    page.close()


def opened(browser: Browser, address: str, size: tuple[int, int] = WIDE, dark: bool = False) -> Page:
    page = browser.open(address, *size, dark)
    # A search for the page before, which has been left, is brought to its end first.
    page.until("document.querySelector('.badge').textContent === 'Stable'", "the verdict", 120.0)
    page.until("document.querySelectorAll('#front circle').length >= 12", "the front", 120.0)
    return page


def slide(page: Page, name: str, place: float) -> None:
    page.run(f"""(() => {{
        const slider = document.querySelector('#{name}');
        slider.value = {place};
        slider.dispatchEvent(new Event('input', {{ bubbles: true }}));
    }})()""")


def gains(page: Page) -> list[float]:
    names = ("kp", "ki", "kd", "lam", "mu")
    return [float(page.run(f"document.querySelector('#{name}-value').value")) for name in names]


def measured(page: Page, row: str) -> str:
    return page.run(f"""[...document.querySelectorAll('.measures tr')]
        .find((row) => row.firstChild.textContent.startsWith({row!r}))?.lastChild.textContent ?? ''""")


def set_gains(page: Page, **values: float) -> None:
    for name, value in values.items():
        page.write(f"#{name}-value", str(value))


def test_the_page_begins_with_the_papers_first_process_and_a_picture(page: Page) -> None:
    assert page.run("document.querySelector('#process').value") == "P1"
    assert page.text("#process-note").startswith("P(s) = 1/(s3 + 3 s2 + 3 s + 1)")
    assert page.run("document.querySelectorAll('.charts canvas').length") == 6


def test_what_is_shown_of_new_gains_is_the_exact_value(page: Page) -> None:
    set_gains(page, kp=1.5, ki=0.5, kd=0.8, lam=1.05, mu=0.9)
    exact = margins(Loop(read_process("P1"), Fopid(1.5, 0.5, 0.8, 1.05, 0.9)))
    shown = f"{exact.ms:.3f}"
    page.until(f"[...document.querySelectorAll('.measures td')].some((td) => td.textContent === '{shown}')", "Ms")
    assert measured(page, "phase margin") == f"{math.degrees(exact.phase_margin):.1f}°"
    assert page.text(".badge") == "Stable"


def test_the_border_of_stability_is_where_routh_has_it(page: Page) -> None:
    set_gains(page, ki=0, kp=7.9)
    page.until("document.querySelector('.badge').textContent === 'Stable'", "stable at 7.9")
    set_gains(page, kp=8.1)
    page.until("document.querySelector('.badge').textContent === 'Unstable'", "unstable at 8.1")
    assert page.text(".why") == "2 unstable poles"
    assert measured(page, "Ms") == "–"


def test_a_slider_reaches_zero_and_changes_no_sign(page: Page) -> None:
    slide(page, "kp", 0)
    assert gains(page)[0] == 0.0
    slide(page, "kp", 600)
    assert gains(page)[0] > 0.0
    page.click("#kp-value")
    page.click(".five .sign")
    assert gains(page)[0] < 0.0
    slide(page, "kp", 300)
    assert gains(page)[0] < 0.0
    page.until("document.querySelector('.badge').textContent.length > 0", "a verdict")


def test_the_picture_follows_the_hand(page: Page) -> None:
    """How quickly, `make bench` measures: here other tests run beside it."""
    for move, place in enumerate(range(300, 500, 20)):
        slide(page, "kp", place)
        page.until(f"performance.getEntriesByName('hand to picture').length > {move}", "a picture")
    times = page.run("performance.getEntriesByName('hand to picture').map((entry) => entry.duration)")
    print(f"hand to picture: median {np.median(times):.0f} ms, quickest {min(times):.0f} ms")


def test_two_wishes_give_the_best_of_each_structure(page: Page) -> None:
    slide(page, "robustness", 45)
    slide(page, "speed", 80)
    page.until("document.querySelectorAll('#structures button').length === 3", "structures")
    page.until("document.querySelector('#structures').getAttribute('aria-busy') === 'false'", "the designs at rest")
    wanted = float(page.text("#robustness-text").split()[-1])
    page.until(f"""(() => {{
        const all = [...document.querySelectorAll('#structures tr')].slice(1).map((row) => +row.cells[4].textContent);
        return all.length === 3 && all.every((ms) => Math.abs(ms - {wanted}) < 0.02);
    }})()""", "three designs on the bound")  # fmt: skip
    costs = page.run(
        "[...document.querySelectorAll('#structures tr')].slice(1).map((row) => +row.cells[5].textContent)"
    )
    assert costs[0] >= costs[1] >= costs[2]
    page.click("#structures [data-structure=fopid]")
    page.until("document.querySelector('[data-structure=fopid]').getAttribute('aria-pressed') === 'true'", "taken")
    exact = margins(Loop(read_process("P1"), Fopid(*gains(page))))
    assert exact.ms == pytest.approx(wanted, abs=0.02)
    page.until("document.querySelectorAll('.sets li').length === 4", "baseline, PI, PID and new in one picture")


def test_a_point_of_the_front_is_taken_with_the_keyboard(page: Page) -> None:
    before = gains(page)
    page.run("[...document.querySelectorAll('#front circle')].at(-1).focus()")
    page.press("Enter")
    page.until(f"document.querySelector('#kp-value').value !== '{before[0]}'", "other gains")
    assert page.run("document.querySelectorAll('#front .taken').length") == 1


def test_the_present_effort_is_matched(page: Page) -> None:
    page.click("#match")
    page.until("document.querySelector('#structures [aria-pressed=true]') !== null", "a design")
    peak = float(page.run("[...document.querySelectorAll('.measures tr')].at(-1).cells[1].textContent"))
    effort = "[...document.querySelectorAll('#structures tr')][2].cells[3].textContent"
    page.until(f"Math.abs({effort} - {peak}) < {0.1 * peak}", "the same effort")


def test_an_error_in_the_process_is_pointed_at(page: Page) -> None:
    page.write("#process", "1/(s+1)^^3")
    page.click("#process-form [type=submit]")
    page.until("!document.querySelector('#process-error').hidden", "the error")
    text, pointer = page.run("document.querySelector('#process-error').textContent").split("\n")
    assert text == "1/(s+1)^^3"
    assert pointer.index("^") == 8
    page.events[:] = [event for event in page.events if "400" not in str(event)]


@pytest.mark.parametrize("process", ["P2", "P3", "P4"])
def test_the_papers_processes_are_one_click_away(page: Page, process: str) -> None:
    page.click(f"[data-process={process}]")
    page.until(f"document.querySelector('#process').value === '{process}'", "the process")
    page.until("document.querySelector('.badge').textContent === 'Stable'", "the verdict")


def test_gains_can_be_taken_as_yaml_python_and_c(page: Page) -> None:
    set_gains(page, kp=1.25)
    page.until("document.querySelector('#code').textContent.includes('kp: 1.25')", "yaml")
    page.click("[data-take=python]")
    page.until("document.querySelector('#code').textContent.includes('Fopid(kp=1.25')", "python")
    python = page.run("document.querySelector('#code').textContent")
    done = subprocess.run([sys.executable, "-c", python], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("stable")
    page.click("[data-take=c]")
    page.until("document.querySelector('#code').textContent.includes('fopid_controller_step')", "C")


def test_all_methods_are_compared_and_one_is_taken(page: Page) -> None:
    page.click("#compare")
    page.until("document.querySelectorAll('#comparison tr').length > 10", "the table", 120.0)
    assert page.text("#compare-answer").startswith("Take ")
    before = gains(page)
    page.click("#comparison .taken button")
    assert gains(page) != before


def test_a_process_is_learnt_from_a_file(page: Page, tmp_path: Path) -> None:
    time = np.arange(0.0, 40.0, 0.05)
    output = 2.0 * -np.expm1(-np.maximum(time - 1.0, 0.0) / 3.0)
    table = np.column_stack([time, time > 0.0, output])
    np.savetxt(tmp_path / "record.csv", table, delimiter=",", header="time,control,measurement", comments="")
    root = page.call("DOM.getDocument")["root"]["nodeId"]
    box = page.call("DOM.querySelector", nodeId=root, selector="#record")["nodeId"]
    page.call("DOM.setFileInputFiles", nodeId=box, files=[str(tmp_path / "record.csv")])
    page.click("#learn [type=submit]")
    page.until("document.querySelectorAll('#models tr').length > 2", "models", 120.0)
    page.until("document.querySelector('#process').value.includes('exp')", "the process in use")
    learnt = read_process(page.run("document.querySelector('#process').value"))
    assert learnt.steady_state_gain == pytest.approx(2.0, rel=0.01)
    assert learnt.delay == pytest.approx(1.0, abs=0.06)


def test_everything_is_reached_without_a_mouse(page: Page) -> None:
    page.run("document.activeElement.blur()")
    seen = set()
    for _ in range(90):
        page.press("Tab")
        seen.add(page.run("document.activeElement.id || document.activeElement.dataset.take || ''"))
    assert {"process", "kp", "kp-value", "mu", "keep", "back", "robustness", "speed", "match", "compare"} <= seen
    assert {"record", "columns", "yaml", "c", "copy", "save", "report", "span"} <= seen


def test_without_the_token_there_is_a_word_on_it(browser: Browser, address: str) -> None:
    page = browser.open(address.partition("#")[0])
    page.until("document.querySelector('#access').textContent.includes('token')", "the word")
    page.close()


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("size", [WIDE, NARROW], ids=["wide", "narrow"])
def test_nothing_is_cut_off_and_axe_finds_no_serious_problem(
    browser: Browser, address: str, size: tuple[int, int], dark: bool
) -> None:
    page = opened(browser, address, size, dark)
    assert page.run("document.documentElement.scrollWidth") <= size[0]
    assert problems(page) == []
    assert page.complaints() == []
    page.close()
