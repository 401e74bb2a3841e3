"""An experiment may end when the record says enough, and not before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import dlsim

from fopid_core.design.identification.record import Record
from fopid_core.design.sufficiency import Sufficiency, residence_time
from fopid_core.model.process import Process


def record(noise: float, ticks: int, lag: float = 5.0, delay: int = 1) -> Record:
    """Of 2 exp(-delay s)/(lag s + 1) behind a held pseudo-random control, by its difference equation."""
    rng = np.random.default_rng(3)
    control = np.repeat(rng.integers(0, 2, 40), 10).astype(float)
    pole = float(np.exp(-1.0 / lag))
    _, measured = dlsim(
        ([2.0 * (1.0 - pole)], [1.0, -pole], 1.0), np.concatenate([np.zeros(delay), control])[: control.size]
    )
    measured = measured[:, 0] + noise * rng.standard_normal(control.size)
    return Record(np.arange(float(ticks)), control[:ticks], measured[:ticks], control_before=0.0)


def test_one_look_is_not_enough_and_two_that_agree_are() -> None:
    sufficiency = Sufficiency("foptd", 0.01, 1.0)
    assert not sufficiency.look(record(0.01, 80))
    assert "nothing to compare" in sufficiency.missing
    assert sufficiency.look(record(0.01, 120)), sufficiency.missing


def test_noise_asks_for_more() -> None:
    sufficiency = Sufficiency("foptd", 1.0, 1.0)
    assert [sufficiency.look(record(1.0, ticks)) for ticks in (60, 80)] == [False, False]
    assert sufficiency.missing


def test_a_process_that_changes_asks_for_more() -> None:
    sufficiency = Sufficiency("foptd", 0.01, 1.0)
    assert not sufficiency.look(record(0.01, 120))
    assert not sufficiency.look(record(0.01, 130, lag=8.0))
    assert "from what a shorter record showed" in sufficiency.missing


def test_a_slow_end_that_was_not_seen_asks_for_more() -> None:
    """Two looks that agree on a lag of 30 s are too early after 60 s."""
    sufficiency = Sufficiency("foptd", 0.001, 1.0)
    assert not sufficiency.look(record(0.001, 50, 30.0, 5))
    assert not sufficiency.look(record(0.001, 60, 30.0, 5))
    assert "to come to rest" in sufficiency.missing
    assert sufficiency.look(record(0.001, 130, 30.0, 5)), sufficiency.missing


def test_a_look_that_is_content_with_less_takes_what_another_would_not() -> None:
    shorter, longer = record(0.01, 120), record(0.01, 130, lag=5.7)
    enough = []
    for content in (1.0, 2.0):
        sufficiency = Sufficiency("foptd", 0.01, 1.0)
        sufficiency.look(shorter)
        enough.append(sufficiency.look(longer, content))
    assert enough == [False, True]


def test_any_process_is_enough_for_one_that_is_content_with_that_but_none_is_not() -> None:
    sufficiency = Sufficiency("foptd", 0.01, 1.0)
    assert sufficiency.look(record(0.01, 80), np.inf), "with nothing before it"
    quiet = record(0.01, 80)
    assert not sufficiency.look(replace(quiet, measurement=np.sin(quiet.time)), np.inf)
    assert sufficiency.missing


@pytest.mark.parametrize(
    ("text", "crossover", "seconds"),
    [("2/(5s+1)*exp(-s)", 0.3, 6.0), ("2/((3s+1)(4s+1))", 0.2, 7.0), ("1/s", 1.0, 0.0), ("1/(s(s+1))", 1.0, 1.0)],
)
def test_the_residence_time_is_the_delay_and_the_lags(text: str, crossover: float, seconds: float) -> None:
    assert residence_time(Process.parse(text), crossover) == pytest.approx(seconds, rel=0.03)


def test_looks_at_noise_alone_are_in_vain_after_five() -> None:
    rng = np.random.default_rng(1)
    control = np.repeat(rng.integers(0, 2, 40), 10).astype(float)
    noise = rng.standard_normal(control.size)
    sufficiency, vain = Sufficiency("foptd", 1.0, 1.0), []
    for ticks in range(60, 400, 60):
        enough = sufficiency.look(Record(np.arange(float(ticks)), control[:ticks], noise[:ticks], control_before=0.0))
        assert not enough
        vain.append(sufficiency.is_vain)
    assert vain == [False] * 4 + [True] * 2


def test_one_process_seen_ends_what_was_in_vain() -> None:
    sufficiency = Sufficiency("foptd", 0.01, 1.0)
    nothing = replace(record(0.01, 80), measurement=np.random.default_rng(2).standard_normal(80))
    for _ in range(5):
        sufficiency.look(nothing)
    assert sufficiency.is_vain
    sufficiency.look(record(0.01, 120))
    assert not sufficiency.is_vain
