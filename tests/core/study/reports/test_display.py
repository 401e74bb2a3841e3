"""What is drawn shows every peak of what was recorded."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fopid_core.study.reports.display import decimate, spike_free_range

SIGNALS = arrays(np.float64, st.integers(2, 3000), elements=st.floats(-1e6, 1e6))


@settings(derandomize=True, deadline=None, max_examples=100)
@given(value=SIGNALS, stretches=st.integers(1, 50))
def test_decimation_keeps_order_ends_and_the_extremes_of_every_window(value: np.ndarray, stretches: int) -> None:
    time = np.arange(value.size, dtype=float)
    kept_time, kept = decimate(time, value, stretches)
    assert kept_time.size <= max(4 * stretches, 2)
    assert np.all(np.diff(kept_time) > 0.0)
    assert np.array_equal(kept, value[kept_time.astype(int)])  # samples as they are
    assert (kept_time[0], kept_time[-1]) == (0.0, value.size - 1.0)
    assert (kept.min(), kept.max()) == (value.min(), value.max())
    longest = -(-value.size // stretches)
    for at in range(value.size):
        near = kept[np.abs(kept_time - at) < longest]
        assert near.min() <= value[at] <= near.max()


def test_every_gap_of_a_long_signal_is_kept() -> None:
    value = np.sin(np.arange(5000) / 50.0)
    gaps = [(100, 101), (1000, 1900), (4990, 4995)]
    for start, end in gaps:
        value[start:end] = np.nan
    time, kept = decimate(np.arange(5000.0), value, 40)
    starts = time[1:][np.isnan(kept[1:]) & ~np.isnan(kept[:-1])]
    assert starts.size == len(gaps)
    for start, end in gaps:
        inside = (time >= start) & (time < end)
        assert np.all(np.isnan(kept[inside]))
        assert time[inside][-1] == end - 1


def test_a_short_signal_is_left_as_it_is() -> None:
    time = np.arange(40.0)
    assert decimate(time, time, 10)[0] is time


def test_a_spike_of_a_few_samples_is_left_out_of_the_range() -> None:
    value = np.sin(np.arange(2000) / 50.0)
    value[700:703] = 80.0
    low, high = spike_free_range(value)
    assert -2.1 < low < -1.0 < 1.0 < high < 2.1


def test_a_signal_without_spikes_has_its_own_range() -> None:
    assert spike_free_range(np.sin(np.arange(2000) / 50.0)) is None
    assert spike_free_range(np.full(100, 3.0)) is None
    assert spike_free_range(np.array([1.0])) is None
    assert spike_free_range(np.array([np.nan])) is None
