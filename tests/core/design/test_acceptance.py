"""Nothing is handed to a running controller that is not known to fulfil every condition."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from fopid_core.design.acceptance import rejection_reason
from fopid_core.design.sampled_loop import Running
from fopid_core.design.specification import Achieved, TuningResult
from fopid_core.model.fopid import Fopid

GOOD = TuningResult(
    success=True, message="", method="time", controller=Fopid(1.0, 0.5),
    achieved=Achieved(phase_margin=1.0, crossover=1.0, phase_slope=0.0, gain_margin_db=9.0, delay_margin=0.02, ms=4.0,
                      mt=1.3),
    stable=True, unstable_poles=0, unmet=(), cost=1.0, evaluations=1, elapsed=0.1, running=Running(True, ms=4.0),
)  # fmt: skip
TICK = 0.01


def test_a_design_on_the_very_bounds_is_taken() -> None:
    assert rejection_reason(GOOD, TICK) == ""


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"controller": None}, "no stable design"),
        ({"stable": False}, "no stable design"),
        ({"success": False}, "the specification is not met"),
        ({"achieved": None}, "Ms = nan is above verify.ms_max = 4"),
        ({"running": None}, "not known to be stable: not looked at"),
        (
            {"running": Running(None, ms=1.0, reason="too close")},
            "ticks of 0.01 s, is not known to be stable: too close",
        ),
        ({"running": Running(False, ms=1.0)}, "not known to be stable"),
        ({"running": Running(True, ms=4.01)}, "Ms = 4.01 of the loop as it runs"),
        ({"running": Running(True, ms=math.nan)}, "Ms = nan of the loop as it runs"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_each_condition_alone_refuses_a_design(changed: dict, told: str) -> None:
    assert told in rejection_reason(replace(GOOD, **changed), TICK)


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("ms", 4.01, "Ms = 4.01 is above verify.ms_max = 4"),
        ("ms", math.nan, "Ms = nan"),
        ("ms", math.inf, "Ms = inf"),
        ("delay_margin", 0.0199, "delay margin 0.0199 s is below 0.02 s (verify.ticks)"),
        ("delay_margin", math.nan, "delay margin nan s"),
    ],
)
def test_a_number_beyond_its_bound_or_no_number_refuses_a_design(name: str, value: float, told: str) -> None:
    result = replace(GOOD, achieved=replace(GOOD.achieved, **{name: value}))
    assert told in rejection_reason(result, TICK)


def test_the_bounds_are_those_given() -> None:
    assert "verify.ms_max = 3.9" in rejection_reason(GOOD, TICK, ms_max=3.9)
    assert "is below 0.03 s" in rejection_reason(GOOD, TICK, ticks=3.0)
    assert rejection_reason(GOOD, TICK, ms_max=math.inf, ticks=0.0) == ""
