"""How results show themselves in a notebook."""

from __future__ import annotations

import re
from collections.abc import Mapping
from html import escape
from typing import Any


def table(title: str, rows: Mapping[str, Any]) -> str:
    """A table in HTML.

    Examples
    --------
    >>> table("Gains", {"kp": 0.123456})
    '<table><caption>Gains</caption><tr><th>kp</th><td>0.12346</td></tr></table>'
    """
    body = "".join(f"<tr><th>{escape(name)}</th><td>{escape(_text(value))}</td></tr>" for name, value in rows.items())
    return f"<table><caption>{escape(title)}</caption>{body}</table>"


def _text(value: Any) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def latex(text: str) -> str:
    """A polynomial in s, as this package writes it, for a formula.

    Examples
    --------
    >>> latex("0.8 s^2.2 + exp(-0.5s)"), latex("s^2 + 1e-07")
    ('0.8 s^{2.2} + e^{-0.5s}', 's^{2} + 10^{-7}')
    """
    text = re.sub(r"\^(-?[\d.]+(?:e-?\d+)?)", r"^{\1}", text)
    text = re.sub(r"exp\(([^)]*)\)", r"e^{\1}", text)
    text = re.sub(r"\b1e([-+]?)0*(\d+)", r"10^{\1\2}", text)
    return re.sub(r"(?<=\d)e([-+]?)0*(\d+)", r" \\cdot 10^{\1\2}", text)
