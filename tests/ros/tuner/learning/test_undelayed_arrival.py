"""Stamps of what is heard, beside when it was sent by a clock that only the test can read."""

from __future__ import annotations

import numpy as np
import pytest

from fopid_ros.tuner.learning.undelayed_arrival import REMEMBERED, UndelayedArrival

TICK, LEAST_LATE = 10_000_000, 200_000


def lateness(
    offset: np.ndarray | float = 0.0, stalls: tuple[tuple[float, float], ...] = (), seconds: float = 60.0
) -> np.ndarray:
    """How much later than by the shortest way a topic at 100 Hz is told to come [ns], at each of its messages.

    The sender's clock is ahead by so much [s]; who hears stands still from one time to another [s].
    """
    rng, arrival = np.random.default_rng(1), UndelayedArrival()
    sent = 10**18 + TICK * np.arange(round(1e9 * seconds / TICK))
    came = sent + LEAST_LATE + rng.exponential(2e6, sent.size).astype(int)
    for begin, end in stalls:
        stalled = (came >= 10**18 + round(1e9 * begin)) & (came < 10**18 + round(1e9 * end))
        came[stalled] = 10**18 + round(1e9 * end)
    came = np.maximum.accumulate(came)
    ahead = np.broadcast_to(np.int64(np.array(offset) * 1e9), sent.shape)
    told = [
        arrival.time_ns({"source_timestamp": int(at), "received_timestamp": int(heard)})
        for at, heard in zip(sent + ahead, came, strict=True)
    ]
    return np.array(told) - sent - LEAST_LATE


@pytest.mark.parametrize("offset", [0.0, 1e4, -1e4])
def test_what_comes_late_is_told_as_if_it_had_come_in_time(offset: float) -> None:
    late = lateness(offset, ((20.0, 20.4), (30.0, 42.0), (43.0, 44.0)))
    assert np.all(late >= 0)
    assert np.max(late[100:]) < 1_000_000  # of some 500 in five seconds the least late one, of 2 ms on the average


@pytest.mark.parametrize("change", [0.5, -0.5])
def test_a_clock_that_is_set_is_followed(change: float) -> None:
    set_at = 2000
    late = lateness(np.where(np.arange(6000) < set_at, 0.0, change))
    assert np.max(np.abs(late[set_at + round(2.1 * REMEMBERED / TICK) :])) < 1_000_000
    assert np.max(np.abs(late)) < 510_000_000


def test_a_clock_that_drifts_is_followed() -> None:
    late = lateness(-100e-6 * 0.01 * np.arange(60_000), seconds=600.0)
    assert np.max(np.abs(late[100:])) < 1_000_000 + 100e-6 * 2 * REMEMBERED


def test_a_middleware_that_does_not_say_when_a_message_was_sent_says_when_it_came() -> None:
    arrival = UndelayedArrival()
    told = [arrival.time_ns({"source_timestamp": 0, "received_timestamp": came}) for came in (5, 9)]
    assert told == [5, 9]
