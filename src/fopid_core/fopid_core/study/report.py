"""The report: one HTML page that needs nothing else, and its main figure as PNG."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from html import escape
from importlib import resources
from pathlib import Path
from string import Template

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.stability import stability
from fopid_core.study.loop_figures import loop_figures
from fopid_core.study.plotly_parts import Figure
from fopid_core.study.report_image import write_image
from fopid_core.study.run import Run, Tuning
from fopid_core.study.segment_table import COLUMNS, number
from fopid_core.study.segments import Retuning, Segment, retunings, segments
from fopid_core.study.signal_figures import comparison_figure, signals_figure

MOST_TUNINGS = 12
"""Tunings shown with figures; of more, the last ones."""

_CAPTIONS = {
    "bode": "Open loop L = C P",
    "sensitivity": "Sensitivity S and complementary sensitivity T",
    "nyquist": "L(jω) and the circle of the largest sensitivity around −1",
    "isodamping": "Iso-damping: the process's gain is off by a factor",
}


def write_report(runs: Sequence[Run], out: Path) -> tuple[Path, Path]:
    """Write the report of one or more runs.

    Parameters
    ----------
    runs : sequence of Run
    out : Path
        The HTML page; the PNG gets the same name with ``.png``.

    Returns
    -------
    page, image : Path

    Raises
    ------
    InputError
        Without runs, or when a file cannot be written.
    """
    if not runs:
        raise InputError("runs = (); allowed: at least one")
    image = out.with_suffix(".png")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(render(runs), encoding="utf-8")
        write_image(runs, image)
    except OSError as error:
        raise InputError(f"report {str(out)!r} cannot be written: {error.strerror}") from None
    return out, image
