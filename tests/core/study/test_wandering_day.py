"""What other gains would have done on a day whose loads wander, against that day lived again."""

from __future__ import annotations

import numpy as np
import pytest

from fopid_core.runtime.controller import ControllerSettings
from fopid_core.study.replay import replay
from tests.core.design.identification.days import Day


@pytest.mark.long
def test_such_a_day_is_replayed_within_its_bands() -> None:
    """Bands of 95 % at each instant; what is off is so for long, so that one day has 86 to 99.8 % of them inside."""
    day = Day(samples=2500, moves=(3.0, -3.0, 3.0))
    other = day.gains(1.5)
    found = replay(day.record(2), ControllerSettings(other, day.h))
    assert found.success, found.message
    assert "beside it loads wander" in found.message
    assert found.measurement is not None
    lived = day.record(2, other).measurement
    inside = (lived >= found.measurement.low) & (lived <= found.measurement.high)
    assert np.mean(inside) > 0.85
    assert np.mean(np.abs(lived - found.measurement.expected)) < 0.5 * np.std(day.record(2).measurement - lived)
