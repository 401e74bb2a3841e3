"""Requests that mean nothing are refused: which field, its value, what is allowed."""

from __future__ import annotations

import math
from typing import Any

import pytest

from fopid_core.design.specification import Bound, FrequencySpecification, TuningRequest
from fopid_core.errors import InputError
from fopid_core.model.process import read_process


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"method": "guess"}, "method = 'guess'; allowed: frequency, time, rule"),
        ({"via": "third"}, "via = 'third'; allowed: none, foptd, soptd, nioptd1, nioptd2"),
        ({"criterion": "beauty"}, "criterion = 'beauty'; allowed: peaks, ms, flatness"),
        ({"solver": "gauss-newton"}, "solver = 'gauss-newton'; allowed: square, paper, monje"),
        ({"method": "rule", "solver": "paper"}, "solver = 'paper'; allowed: none for this method"),
        ({"phase_margin": 0.0}, "phase_margin = 0"),
        ({"phase_margin": math.pi}, "phase_margin = 3.14"),
        ({"phase_margin": math.nan}, "phase_margin = nan"),
        ({"crossover": -1.0}, "crossover = -1"),
        ({"crossover": math.inf}, "crossover = inf"),
        ({"horizon": 0.0}, "horizon = 0"),
        ({"ms_max": 1.0}, "ms_max = 1.0; allowed: above 1"),
        ({"ms_max": math.nan}, "ms_max = nan"),
        ({"u_max": 0.0}, "u_max = 0.0; allowed: above 1e-100"),
        ({"noise_max": -3.0}, "noise_max = -3"),
        ({"sample_time": 0.0}, "sample_time = 0"),
        ({"timeout": -1.0}, "timeout = -1"),
        ({"fixed": {"kx": 1.0}}, "fixed = 'kx'; allowed: kp, ki, kd, lam, mu"),
        ({"fixed": {"kp": math.nan}}, "fixed kp = nan"),
        ({"fixed": {"lam": 2.5}}, "lam = 2.5; allowed: 0 to 2"),
        ({"bounds": {"kp": (2.0, 1.0)}}, "bounds of kp"),
        ({"bounds": {"mu": (0.0, 3.0)}}, "mu = 3.0; allowed: 0 to 2"),
        ({"bounds": {"kp": (0.0, math.inf)}}, "bounds of kp"),
    ],
)
def test_a_request_that_means_nothing_is_refused(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as error:
        TuningRequest(read_process("P1"), **fields)
    assert message in str(error.value)
    assert "allowed" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(("db", "frequency"), [(math.nan, 1.0), (math.inf, 1.0), (-40.0, 0.0), (-40.0, math.nan)])
def test_a_bound_needs_a_level_and_a_frequency(db: float, frequency: float) -> None:
    with pytest.raises(InputError, match="allowed"):
        Bound(db, frequency)


def test_infinite_means_no_bound() -> None:
    request = TuningRequest(read_process("P1"), ms_max=math.inf, u_max=math.inf, noise_max=math.inf)
    assert request.ms_max == math.inf


@pytest.mark.parametrize(("margin", "crossover"), [(-1.0, 1.0), (4.0, 1.0), (1.0, 0.0), (1.0, math.inf)])
def test_a_frequency_specification_is_checked_too(margin: float, crossover: float) -> None:
    with pytest.raises(InputError, match="allowed"):
        FrequencySpecification(margin, crossover)
