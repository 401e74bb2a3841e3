"""Indices, margins and peaks of random loops with delay, of fractional ones and of both, beside their oracles.

``python -m tests.core.model.index_campaign FILE --seed 1 --loops 500`` writes a line of JSON for each loop.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from pathlib import Path
from typing import Any

from fopid_core.errors import InputError, UnknownResponseError
from fopid_core.model.margins import margins
from fopid_core.model.response import step_response
from fopid_core.model.response_indices import response_indices

from .extreme_loops import ExtremeGenerator
from .frequency_oracle import faults
from .index_oracles import delay_free_indices, delayed_indices
from .random_loops import RandomLoop

KINDS = (
    "delayed_fractional", "fractional", "delayed_any_order", "fractional_neutral", "fractional_resonant",
    "delayed", "neutral", "unstable_delayed",
)  # fmt: skip
WELL_KNOWN = 1e-4  # relative: an oracle with a larger error of its own tells nothing


def loops(seed: int, count: int) -> list[RandomLoop]:
    generator = ExtremeGenerator(seed)
    return [getattr(generator, KINDS[i % len(KINDS)])() for i in range(count)]


def judged(case: RandomLoop) -> dict[str, Any]:
    """What is wrong with the indices and margins of a loop, and how many indices could be told."""
    row: dict[str, Any] = {"kind": case.kind, "loop": str(case), "wrong": [], "told": 0, "refused": ""}
    row["wrong"] = faults(case, margins(case.loop))
    began = time.process_time()
    try:
        response = step_response(case.loop, case.horizon)
    except (UnknownResponseError, InputError) as refusal:
        return row | {"refused": str(refusal)}
    found, claimed = response_indices(response.time, response.error, response.uncertainty)
    row["seconds"] = time.process_time() - began
    exact = delayed_indices(case) if case.delay else delay_free_indices(case)
    for name, (value, own) in (exact or {}).items():
        if not own <= WELL_KNOWN * value:
            continue
        row["told"] += 1
        off, allowed = abs(getattr(found, name) - value), getattr(claimed, name)
        row["largest"] = max(row.get("largest", 0.0), off / (allowed + own))
        if off > allowed + own and not math.isnan(off):
            row["wrong"].append(f"{name} off by {off:.3g} within {allowed:.3g}, oracle {value!r} within {own:.2g}")
    return row


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("file", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--loops", type=int, default=500)
    asked = parser.parse_args()
    with asked.file.open("a", encoding="utf-8") as out:
        for case in loops(asked.seed, asked.loops):
            out.write(json.dumps(judged(case)) + "\n")
            out.flush()


if __name__ == "__main__":
    main()
