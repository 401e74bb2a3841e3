"""Profiles as numbers, beside the formulas and beside what the standard library reads."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fopid_core.errors import InputError
from fopid_core.study.experiments.profiles import File, Ramp, Sine, Steps, loaded, values


def test_a_ramp_goes_from_the_present_value_and_stays_there() -> None:
    found = values(Ramp(to=-1.0, over=2.0), before=3.0, samples=301, sample_time=0.01)
    expected = [3.0 - 4.0 * min(k * 0.01 / 2.0, 1.0) for k in range(301)]
    assert np.allclose(found, expected, rtol=0, atol=1e-14)


def test_a_sine_swings_about_the_present_value() -> None:
    found = values(Sine(amplitude=0.5, period=3.0, phase_deg=90.0), before=1.0, samples=500, sample_time=0.01)
    expected = [1.0 + 0.5 * math.cos(2.0 * math.pi * k * 0.01 / 3.0) for k in range(500)]
    assert np.allclose(found, expected, rtol=0, atol=1e-13)


def test_a_number_and_nothing_are_held() -> None:
    assert values(2.0, 1.0, 3, 0.1).tolist() == [2.0, 2.0, 2.0]
    assert values(None, 1.0, 3, 0.1).tolist() == [1.0, 1.0, 1.0]


@settings(derandomize=True, deadline=None, max_examples=100)
@given(st.lists(st.tuples(st.integers(0, 60), st.floats(-5, 5)), min_size=1, max_size=8), st.sampled_from([1e-3, 0.3]))
def test_steps_hold_the_latest_point(points: list[tuple[int, float]], h: float) -> None:
    points = sorted(points, key=lambda point: point[0])
    found = values(Steps(tuple((k * h, value) for k, value in points)), before=-9.0, samples=50, sample_time=h)
    held, expected = -9.0, []
    for k in range(50):
        for at, value in points:
            held = value if at == k else held
        expected.append(held)
    assert found.tolist() == expected


def test_a_csv_file_is_read_relative_to_its_folder(tmp_path: Path) -> None:
    (tmp_path / "load.csv").write_text("\ufefftime, value, remark\n0, 1.5, a\n2.5, -1, b\n", encoding="utf-8")
    assert loaded("setpoint", File("load.csv"), tmp_path) == Steps(((0.0, 1.5), (2.5, -1.0)))


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("t,value\n0,1\n", "columns t, value"), ("time,value\n0,1\n1,x\n", "line 3: time = '1', value = 'x'"),
        ("", "columns none"), ("time,value\n", "at least one"),
        ("time,value\n1,1\n0,1\n", "order of time"), ("time,value\n0,inf\n", "not finite"),
        ("time,value\n0\n", "line 2"),
    ],
)  # fmt: skip
def test_a_csv_file_that_cannot_be_used_is_named(tmp_path: Path, text: str, named: str) -> None:
    path = tmp_path / "load.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=named) as error:
        loaded("setpoint", File("load.csv"), tmp_path)
    assert "load.csv" in str(error.value)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Ramp(to=1.0, over=0.0), lambda: Ramp(to=math.inf, over=1.0), lambda: Sine(1.0, -1.0),
        lambda: Sine(math.nan, 1.0), lambda: Steps(()), lambda: Steps(((-1.0, 0.0),)),
    ],
)  # fmt: skip
def test_profiles_without_meaning_are_refused(make) -> None:
    with pytest.raises(InputError, match="allowed"):
        make()
