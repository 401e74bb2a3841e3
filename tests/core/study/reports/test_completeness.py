"""Every sample that a recording lacks is counted, at the right place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fopid_core.study.reports.completeness import samples
from fopid_core.study.reports.run import Run, Signal

STEP = 0.01


def run_of(measured: np.ndarray, controlled: np.ndarray, **more) -> Run:
    signals = {"measurement": Signal(measured, measured), "control": Signal(controlled, controlled)}
    return Run(Path("run"), signals, **more)


@settings(derandomize=True, deadline=None, max_examples=100)
@given(lost=st.sets(st.integers(1, 998), max_size=300), start=st.integers(0, 10**6))
def test_in_lockstep_what_is_lost_is_counted_exactly(lost: set[int], start: int) -> None:
    time = STEP * (start + np.arange(1000))
    found = samples(run_of(time, np.delete(time, sorted(lost))))
    assert (found["measurement"].missing, found["measurement"].expected) == (0, 1000)
    assert (found["control"].missing, found["control"].expected) == (len(lost), 1000)
    if lost:
        assert found["control"].first_gap == pytest.approx(time[min(lost)], abs=1e-6)


def test_samples_sent_twice_count_once() -> None:
    time = STEP * np.arange(100)
    assert str(samples(run_of(np.sort(np.append(time, time[20:30])), time))["measurement"]) == "0 of 100 missing"


def test_a_topic_that_ends_too_soon_lacks_its_end_unless_the_recording_was_cut_off() -> None:
    time = STEP * np.arange(100)
    assert samples(run_of(time, time[:90]))["control"].missing == 10
    assert samples(run_of(time, time[:90], whole=False))["control"].missing == 0


def test_on_a_wall_clock_jitter_is_no_loss_and_a_sample_left_out_is() -> None:
    time = STEP * np.arange(1000) + np.random.default_rng(1).uniform(0.0, 0.4 * STEP, 1000)
    found = samples(run_of(time, np.delete(time, [500, 501]), start=1_790_000_000 * 10**9))
    assert (found["measurement"].missing, found["control"].missing) == (0, 2)


def test_late_ticks_that_the_controller_counted_are_not_missing() -> None:
    time = np.delete(STEP * np.arange(1000), [300, 301, 302, 700])
    state = {"time": time, "overruns": 5.0 + 3.0 * (time > 3.0) + (time > 7.0)}
    found = samples(run_of(time, time, state=state, start=1_790_000_000 * 10**9))
    assert {name: str(one) for name, one in found.items()} == {
        "measurement": "4 of 1,000 missing",
        "control": "0 of 1,000 missing, 4 late",
        "state": "0 of 1,000 missing, 4 late",
    }


def test_a_single_sample_says_nothing() -> None:
    assert samples(run_of(np.zeros(1), np.zeros(1))) == {}
