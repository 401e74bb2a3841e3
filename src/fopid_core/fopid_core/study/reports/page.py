"""The page that reports are: one HTML file that needs nothing else."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from html import escape
from importlib import resources
from string import Template

from fopid_core.study.reports.plotly_parts import Figure


def page(title: str, content: str, figures: Mapping[str, Figure], style: str = "") -> str:
    """The page as text.

    Parameters
    ----------
    title : str
    content : str
        HTML; a place for a figure is made by ``report_parts.plot``.
    figures : mapping
        By the names of their places.
    style : str
        CSS beyond what all pages have.

    Examples
    --------
    >>> "<p>hello</p>" in page("A title", "<p>hello</p>", {})
    True
    """
    return Template(_file("report_page.html")).substitute(
        title=escape(title),
        style=_file("report_page.css") + style,
        content=content,
        figures=json.dumps(figures, allow_nan=False, separators=(",", ":")).replace("</", "<\\/"),
        plotly=_plotly(),
        script=_file("report_page.js"),
    )


def _file(name: str) -> str:
    return resources.files("fopid_core.study.reports").joinpath(name).read_text(encoding="utf-8")


@cache
def _plotly() -> str:
    return resources.files("plotly").joinpath("package_data", "plotly.min.js").read_text(encoding="utf-8")
