"""Gains that hold a loop, beside what it shows once it is moved with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fopid_core.design.identification.flaws import Flaws
from fopid_core.design.identification.friction import Friction
from fopid_core.design.identification.identify import IdentificationResult, identify
from fopid_core.design.identification.record import Record
from fopid_core.design.proof_verification import near_instability
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process
from fopid_core.model.two_degrees import NO_FILTER

TICK, MOST = 0.1, 2.5
LIVELY, TOO_LIVELY = Fopid(kp=15.0, ki=15.0), Fopid(kp=25.0, ki=25.0)
"""On a lag of 1 s, sampled: 1 - z / (z - a) goes beyond 2.5 with the one, and swings ever further with the other."""


@pytest.fixture(scope="module")
def lag() -> IdentificationResult:
    time = np.arange(0.0, 40.0, TICK)
    control, measured = (time % 20.0 < 10.0).astype(float), np.zeros(400)
    for k in range(399):
        measured[k + 1] = np.exp(-TICK) * measured[k] - np.expm1(-TICK) * control[k]
    return identify(Record(time, control, measured), "foptd")


def judged(gains: Fopid, as_moved: IdentificationResult, *more: IdentificationResult) -> str:
    asked = iter(more)
    told = near_instability(gains, NO_FILTER, as_moved, lambda: next(asked), TICK, MOST)
    assert not list(asked), "all is asked for"
    return told


def rubbing(lag: IdentificationResult) -> IdentificationResult:
    assert lag.best is not None
    return replace(lag, best=replace(lag.best, flaws=Flaws(friction=Friction(0.1, 1e-3, 1.0, 1.0))))


def test_the_peak_is_that_of_the_sampled_loop(lag: IdentificationResult) -> None:
    """By the difference equation of a lag behind a hold and a PI whose integral takes up each error at once."""
    z = np.exp(1j * np.linspace(1e-3, np.pi, 100_001))
    process = -np.expm1(-TICK) / (z - np.exp(-TICK))
    peaks = []
    for share in (0.0, 1.0):  # of the integral up to the last tick, the rest up to this one
        integral = TICK * (share + (1.0 - share) * z) / (z - 1.0)
        peaks.append(np.abs(1.0 / (1.0 + process * (LIVELY.kp + LIVELY.ki * integral))).max())
    told = judged(LIVELY, lag, lag)
    seen = float(told.split("max |S| of ")[1].split()[0])
    assert min(peaks) - 0.02 < seen < max(peaks) + 0.02


def test_a_second_look_that_speaks_for_the_gains_is_believed(lag: IdentificationResult) -> None:
    assert lag.best is not None
    half = replace(lag, best=replace(lag.best, process=Process.parse("0.5/(s+1)")))
    assert judged(LIVELY, lag, half) == ""


def test_one_beside_loads_that_wander_is_not(lag: IdentificationResult) -> None:
    assert lag.best is not None
    half = replace(lag, best=replace(lag.best, process=Process.parse("0.5/(s+1)"), wanders=True))
    assert "a max |S| of" in judged(LIVELY, lag, half)


def test_nor_is_one_that_shows_no_process(lag: IdentificationResult) -> None:
    assert "a max |S| of" in judged(LIVELY, lag, replace(lag, success=False))


def test_moves_that_show_no_process_speak_against_nothing(lag: IdentificationResult) -> None:
    assert judged(LIVELY, replace(lag, success=False)) == ""
    assert judged(LIVELY, replace(lag, best=None)) == ""


def test_a_process_that_the_gains_would_not_hold_is_none_where_no_friction_does(lag: IdentificationResult) -> None:
    assert judged(TOO_LIVELY, lag) == ""
    assert "a loop that only friction holds" in judged(TOO_LIVELY, rubbing(lag), rubbing(lag))
