"""What the page without ROS can ask for: each request a mapping in, a mapping out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

from fopid_core.design import defaults
from fopid_core.errors import InputError
from fopid_core.model.process import Process
from fopid_core.model.stability import process_stability
from fopid_core.study.explore.designs import EFFORT_RANGE, MS_RANGE, STRUCTURES, Designs, described
from fopid_core.study.explore.learning import learn_upload
from fopid_core.study.explore.taking import report, take
from fopid_core.study.json_values import jsonable
from fopid_core.study.page.prediction import answer, natural_frequency
from fopid_core.study.page.requests import number, typed_process

Work = Callable[[Mapping[str, Any]], dict[str, Any]]

SLIDER_REACH = 20.0
"""The sliders of the gains reach so many times the gain of practice."""

FIRST = (("pi", 1.4, 2.0), ("pid", 1.4, 2.0), ("pid", 1.6, 20.0), ("fopid", 2.0, 20.0))
"""Structure, max |S| and effort of the design a process begins with: the first that there is."""


def about_process(fields: Mapping[str, Any]) -> dict[str, Any]:
    """What the page needs to know of a process: its text, what it is like, how far the sliders go, a first design.

    Examples
    --------
    >>> known = about_process({"process": "2/(s+1)^3"})
    >>> known["nature"], known["sign"], known["effort_unit"]
    ('stable', 1.0, 0.5)
    """
    process = _process(fields)
    designs = _designs(process, _sample_time(fields))
    w, size = natural_frequency(process), SLIDER_REACH * designs.effort_unit
    verdict = process_stability(process)
    return {
        "process": str(process), "delay": process.delay, "sign": defaults.gain_sign(process), "crossover": w,
        "ranges": {"kp": size, "ki": size * w, "kd": size / w, "lam": 2.0, "mu": 2.0},
        "effort_unit": designs.effort_unit, "ms_range": MS_RANGE, "effort_range": EFFORT_RANGE,
        "nature": "integrating" if process.integrating_order > 0 else verdict.reason,
        "first": _first(designs),
    }  # fmt: skip


def _first(designs: Designs) -> dict[str, Any]:
    for structure, ms_max, effort in FIRST:
        try:
            design = designs.of(structure, ms_max, effort)
        except InputError as refusal:  # no search on such a process
            return {**described(structure, ms_max, None), "reason": str(refusal)}
        if design is not None and design.met:
            return {**described(structure, ms_max, design), "reason": ""}
    return {**described("pi", FIRST[0][1], None), "reason": "no design with little control was found"}


def designs_for(fields: Mapping[str, Any]) -> dict[str, Any]:
    """The best PI, PID and FOPID for two wishes, ``ms_max`` and ``effort``."""
    process, sample_time = _process(fields), _sample_time(fields)
    ms_max = number("ms_max", fields.get("ms_max"), *MS_RANGE)
    effort = number("effort", fields.get("effort"), EFFORT_RANGE[0] / 2.0, 1e6)
    designs = _designs(process, sample_time)
    return {"designs": [described(name, ms_max, designs.of(name, ms_max, effort)) for name in STRUCTURES]}


def fronts(fields: Mapping[str, Any]) -> dict[str, Any]:
    """The trade-off front of each structure for one ``effort``: the cost over max |S|."""
    effort = number("effort", fields.get("effort"), EFFORT_RANGE[0] / 2.0, 1e6)
    designs = _designs(_process(fields), _sample_time(fields))
    return {"fronts": {name: designs.front(name, effort) for name in STRUCTURES}}


def _process(fields: Mapping[str, Any]) -> Process:
    text = fields.get("process")
    if not isinstance(text, str):
        raise InputError("process missing; allowed: a text such as 1/(s+1)^3")
    return typed_process(text)


def _sample_time(fields: Mapping[str, Any]) -> float:
    return number("sample_time", fields.get("sample_time", 0.01), 1e-9, 1e9)


@lru_cache(16)
def _designs(process: Process, sample_time: float) -> Designs:
    return Designs(process, sample_time)


def comparison(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Every method and structure on the process, as ``fopid compare --json`` has it."""
    from fopid_core.design.comparison.compare import compare, comparison_request
    from fopid_core.study.comparison_rows import comparison_rows

    process = _process(fields)
    found: dict[str, Any] = jsonable(comparison_rows(process, compare(comparison_request(process))))
    return found


AT_THE_HAND: Mapping[str, Work] = {"predict": answer, "take": take}
"""Answers that a hand waits for."""

SEARCHES: Mapping[str, Work] = {"process": about_process, "designs": designs_for, "fronts": fronts}
"""What a search on the process answers, in fractions of a second."""

LONG_WORK: Mapping[str, Work] = {"compare": comparison, "learn": learn_upload, "report": report}
"""What takes seconds."""
