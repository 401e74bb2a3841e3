"""The tables of Das, Saha, Das and Gupta's paper as data, with exact figures beside the printed ones."""

from __future__ import annotations

import json
from functools import cache
from importlib import resources
from typing import Any


@cache
def paper_tables() -> dict[str, Any]:
    """The paper's tables.

    Returns
    -------
    dict
        ``processes``: the test bench as text. ``specification``: the bounds of section 3.3 [dB] and [rad/s].
        ``search_box`` and ``horizon`` [s]: of section 4. ``best_time_index``: the designs that section 5 compares.
        ``table1_table2``: reduced models. ``table3``: frequency-domain designs. ``table4_to_7``: time-domain
        designs. ``notes``: what the printed figures are and where they err.
        Beside the paper's figures stand ``exact`` ones and, for tables 4 to 7, those of first-order
        Gruenwald-Letnikov differences at 0.01 s.

    Examples
    --------
    >>> paper_tables()["table3"][0]["kp"]
    0.9116
    """
    text = resources.files("fopid_core.data").joinpath("paper_tables.json").read_text(encoding="utf-8")
    tables: dict[str, Any] = json.loads(text)
    return tables
