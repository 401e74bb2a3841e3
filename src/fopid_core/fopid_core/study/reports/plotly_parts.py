"""What the report's figures are made of, as plotly.js takes it.

Colours of text, axes and grid come from the page, which has a light and a dark look.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

Figure = dict[str, Any]
"""``{"data": [...], "layout": {...}}``, or a part of it."""

BLUE, RED, GREEN, VIOLET, GREY = "#2f7fc1", "#d1582a", "#2b9a66", "#8e6bbf", "#86909b"
"""Each stands out on white and on black alike."""

_DIGITS = 6


def numbers(values: ArrayLike) -> list[float | None]:
    """Numbers for JSON, to six digits; what is not finite becomes a gap.

    Examples
    --------
    >>> numbers([1.23456789, float("nan")])
    [1.23457, None]
    """
    flat = np.asarray(values, dtype=float).ravel()
    return [float(f"{value:.{_DIGITS}g}") if np.isfinite(value) else None for value in flat.tolist()]


def line(x: ArrayLike, y: ArrayLike, name: str, colour: str, shape: str = "linear", **more: Any) -> Figure:
    """A curve; ``shape`` is ``hv`` for one that holds its value until the next point."""
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": numbers(x),
        "y": numbers(y),
        "line": {"color": colour, "width": 1.6, "shape": shape, "simplify": False},
        "hovertemplate": "%{y:.5g}",
        **more,
    }


def segment(x: tuple[float, float], y: tuple[float, float], colour: str, **more: Any) -> Figure:
    """A straight mark from one point to another."""
    mark = {"type": "line", "x0": x[0], "x1": x[1], "y0": y[0], "y1": y[1], "line": {"color": colour, "width": 1.2}}
    return {**mark, **more}


def note(x: float, y: float, text: str, **more: Any) -> Figure:
    """A text beside a point; on a logarithmic axis ``x`` is the power of ten."""
    return {
        "x": x,
        "y": y,
        "text": text,
        "showarrow": False,
        "xanchor": "left",
        "yanchor": "bottom",
        "xshift": 3,
        **more,
    }


def legend_above() -> Figure:
    """A legend in one row above the axes."""
    return {"orientation": "h", "x": 0, "y": 1.0, "yanchor": "bottom"}
