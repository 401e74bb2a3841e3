"""What is read from others is answered or refused in one line; what once was not stays here."""

from __future__ import annotations

import numpy as np
import pytest

from .campaign import changed
from .targets import TARGETS, fault

ONCE_BROKEN = [
    (
        "http",  # a browser that is gone at once: a traceback in the log
        b"GET /live HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n",
    ),
]


@pytest.mark.parametrize(("name", "case"), ONCE_BROKEN, ids=[name for name, _ in ONCE_BROKEN])
def test_a_case_that_once_was_answered_badly_is_answered_well(name: str, case: bytes) -> None:
    assert fault(TARGETS[name], case) == ""


@pytest.mark.parametrize("name", TARGETS)
def test_cases_near_the_good_ones_are_read_or_refused_in_one_line(name: str) -> None:
    random, seeds = np.random.default_rng(1), list(TARGETS[name].seeds())
    cases = seeds + [changed(random, seeds) for _ in range(60)]
    assert {case: found for case in cases if (found := fault(TARGETS[name], case))} == {}
