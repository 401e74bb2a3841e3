"""What a tuning hands out is proved, or it is said why it is not."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from fopid_core.design.certificate.checker import check
from fopid_core.design.certified_tuning import certificate_or_refusal, certify_tuning
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
    document, refusal = certificate_or_refusal(REQUEST, result, 4.0)
    assert (check(document), refusal) == ("", "")
    assert "max |S| is above 1.2" in certificate_or_refusal(REQUEST, result, 1.2)[1]
    unstable = certificate_or_refusal(REQUEST, replace(result, controller=Fopid(100.0)), 4.0)
    assert unstable[0] == ""
    assert "no certificate" in unstable[1]
    assert "no design" in certificate_or_refusal(REQUEST, replace(result, controller=None), 4.0)[1]


@pytest.mark.slow
def test_a_bound_that_is_in_force_by_default_is_proved_too() -> None:
    request = TuningRequest(read_process("1/(s+1)^2"), method="time")
    result = tune(request)
    found = certify_tuning(request, result)
    assert found is not None
    assert (found.certified, found.bounds.ms_max) == (True, pytest.approx(1.6))
    sharper = replace(result, controller=Fopid(30.0, 30.0))  # stable, with a peak above 1.6
    assert "max |S| is above" in certificate_or_refusal(request, sharper, math.inf)[1]
