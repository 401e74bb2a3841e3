"""What a tuning hands out is proved, or it is said why it is not."""

from __future__ import annotations

from dataclasses import replace

from fopid_core.design.certified_tuning import certify_tuning, uncertified_reason
from fopid_core.design.tuner import TuningRequest, tune
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import read_process

REQUEST = TuningRequest(read_process("2/(3s+1)*exp(-0.5s)"), method="rule", rule="simc-pi", ms_max=2.0)


def test_a_design_is_proved_with_the_bounds_that_were_asked_for() -> None:
    found = certify_tuning(REQUEST, tune(REQUEST))
    assert found is not None
    assert found.certified is True
    assert "max |S| <= 2" in found.reason


def test_a_design_that_breaks_a_bound_or_is_unstable_is_not_applied() -> None:
    result = tune(REQUEST)
    assert uncertified_reason(REQUEST, result, 4.0) == ""
    assert "max |S| is above 1.2" in uncertified_reason(REQUEST, result, 1.2)
    assert "no certificate" in uncertified_reason(REQUEST, replace(result, controller=Fopid(100.0)), 4.0)
    assert "no design" in uncertified_reason(REQUEST, replace(result, controller=None), 4.0)
