"""Published data: the tables of Das, Saha, Das and Gupta, and the test batch of Astrom and Hagglund."""

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


@cache
def test_batch() -> dict[str, str]:
    """The test batch of Astrom and Hagglund (2004): 134 processes as text, by names such as ``P6 T1=0.7 L1=0.3``.

    Nine families: lag with delay, double lag with delay, three lags, equal lags, spread lags, integrating with lag and
    delay, two lags with delay, non-minimum-phase, and oscillatory.

    Examples
    --------
    >>> len(test_batch()), test_batch()["P6 T1=0.7 L1=0.3"]
    (134, '1/(s*(0.7s+1))*exp(-0.3s)')
    """
    text = resources.files("fopid_core.data").joinpath("test_batch.json").read_text(encoding="utf-8")
    batch = {}
    for family in json.loads(text)["families"]:
        for row in family["parameters"]:
            name = " ".join([family["family"], *(f"{key}={value:g}" for key, value in row.items())])
            batch[name] = family["process"].format(**row)
    return batch
