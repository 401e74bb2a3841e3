"""What is read from others is answered or refused in one line; what once was not stays here."""

from __future__ import annotations

import numpy as np
import pytest

from fopid_core.errors import InputError

from .campaign import changed
from .lines import Fuzzer
from .targets import TARGETS, fault

SEARCHING = ("wishes",)
ONCE_BROKEN = [
    (
        "explore",
        b'{"ask": "predict", "process": "1/(1e3s+1)",'
        b' "sets": [{"kp": 0.5, "kd": 1, "lam": 0.5, "mu": 1.4, "filter_order": 2, "filter_time": 1.4}]}',
    ),
    ("explore", b'{"ask": "predict", "process": "1/(s+1)^3", "sets": [{"kp": 1%s}]}' % (400 * b"0")),
    (
        "explore",
        b'{"ask": "predict", "process": "1/(s+1)^3", "sets": [{"kp": 1, "filter_order": 2.0, "filter_time": 0.1}]}',
    ),
    (
        "http",  # a browser that is gone at once: a traceback in the log
        b"GET /live HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n",
    ),
]


@pytest.mark.parametrize(("name", "case"), ONCE_BROKEN, ids=[f"{name}-{i}" for i, (name, _) in enumerate(ONCE_BROKEN)])
def test_a_case_that_once_was_answered_badly_is_answered_well(name: str, case: bytes) -> None:
    assert fault(TARGETS[name], case) == ""


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] * (n in SEARCHING)) for n in TARGETS])
def test_cases_near_the_good_ones_are_read_or_refused_in_one_line(name: str) -> None:
    random, seeds = np.random.default_rng(1), list(TARGETS[name].seeds())
    cases = seeds + [changed(random, seeds) for _ in range(60)]
    assert {case: found for case in cases if (found := fault(TARGETS[name], case))} == {}


def test_requests_of_the_page_without_ros_are_answered_or_refused_in_one_line() -> None:
    fuzzer, target = Fuzzer(1), TARGETS["explore"]
    cases = [fuzzer.asked(("predict", "take")) for _ in range(60)]
    assert {case: found for case in cases if (found := fault(target, case))} == {}


@pytest.mark.parametrize("field", [b"float64 elapsed\n", b"float64 measurement_filter_time\n"])
def test_a_bag_that_defines_a_type_without_one_of_its_fields_is_refused_in_one_line(field: bytes) -> None:
    target = TARGETS["bag"]
    (seed,) = target.seeds()
    assert field in seed
    case = seed.replace(field, field[:-2] + b"_\n")  # as long as it was
    assert fault(target, case) == ""
    with pytest.raises(InputError, match="its messages lack"):
        target.read(case)
