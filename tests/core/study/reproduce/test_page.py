"""The page is one file that needs nothing else and shows all that was computed; a real browser agrees."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from fopid_core.study.reproduce.page import Reproduction, render

from ..browser import NEEDS_BROWSER, open_in_browser
from ..reports.test_report import Outline
from .parts import small_reproduction

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def found() -> Reproduction:
    return small_reproduction()


@pytest.fixture(scope="module")
def page(found: Reproduction) -> str:
    return render(found)


def test_the_page_refers_to_nothing_outside_itself_and_is_well_formed(page: str) -> None:
    outline = Outline(page)
    assert outline.open == []
    for tag, attributes in outline.elements:
        for name in ("src", "href", "data", "srcset"):
            assert (attributes.get(name) or "data:").startswith(("data:", "#")), (tag, attributes)
    ids = [a["id"] for _, a in outline.elements if "id" in a]
    assert len(ids) == len(set(ids))
    links = {a["href"][1:] for t, a in outline.elements if t == "a"}
    assert links <= set(ids)
    assert len(links) == 4


def test_each_place_for_a_figure_has_its_figure(page: str, found: Reproduction) -> None:
    places = [a["data-figure"] for _, a in Outline(page).elements if "data-figure" in a]
    assert len(places) == len(set(places)) == sum(len(figure.panels) for figure in found.figures)
    figures = re.search(r'id="figures">(.*?)</script>', page, re.DOTALL)[1]
    assert all(f'"{place}":' in figures for place in places)


def test_tables_claims_and_errata_are_there(page: str, found: Reproduction) -> None:
    text = Outline(page).text
    for table in found.all_tables:
        assert table.title in text
    for erratum in found.errata:
        assert erratum.place in text
        assert " ".join(erratum.right.split()) in text
    for words in ("not for P2", "GL differs from print", "open loop", "whose index GL gives within 2.5 % 2"):
        assert words.lower() in text.lower(), words


class TestInBrowser:
    pytestmark = NEEDS_BROWSER

    @pytest.mark.parametrize("width", [1280, 400])
    def test_everything_is_drawn_within_the_page_without_complaint_or_request(
        self, page: str, tmp_path: Path, width: int
    ) -> None:
        (tmp_path / "index.html").write_text(page, encoding="utf-8")
        seen, console = open_in_browser(tmp_path, width, page="index.html")
        assert console == []
        assert seen["fetched"] == []
        assert seen["width"] <= width
        assert max(seen["spilt"]) <= 1.0
        assert any(seen["scrolled"]) == (width == 400)
        assert len(seen["plots"]) == 10
        for plot in seen["plots"]:
            assert plot["curves"] >= 2
            assert plot["titles"] == 2
            assert len(plot["legend"]) >= 2
            assert plot["width"] == pytest.approx(plot["place"], abs=1.0)
        assert seen["plots"][-1]["legend"] == ["IAE", "ISE", "ITAE", "ITSE", "ISTES", "ISTSE", "SUM", "dotted: GL"]
        assert seen["ink"] == "rgb(28, 33, 38)"

    def test_the_page_is_dark_for_those_who_want_it_dark(self, page: str, tmp_path: Path) -> None:
        (tmp_path / "index.html").write_text(page, encoding="utf-8")
        seen, console = open_in_browser(tmp_path, 800, "--blink-settings=preferredColorScheme=0", page="index.html")
        assert console == []
        assert seen["ink"] == "rgb(230, 233, 236)"
