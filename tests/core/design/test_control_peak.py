"""The first control after a setpoint step is that of the controller as it runs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fopid_core.design.control_peak import first_control
from fopid_core.model.fopid import Fopid
from fopid_core.runtime.controller import ControllerSettings, FopidController


@settings(derandomize=True, deadline=None, max_examples=60)
@given(
    kp=st.floats(-10, 10),
    ki=st.floats(-10, 10),
    kd=st.floats(-10, 10),
    lam=st.floats(0.05, 1.95),
    mu=st.floats(0.05, 1.95),
    sample_time=st.sampled_from([0.001, 0.01, 0.1, 2.0]),
)
def test_it_is_what_the_controller_gives_at_its_first_tick(
    kp: float, ki: float, kd: float, lam: float, mu: float, sample_time: float
) -> None:
    gains = Fopid(kp, ki, kd, lam, mu)
    runs = FopidController(ControllerSettings(gains, sample_time=sample_time)).step(1.0, 0.0)
    size = abs(kp) + abs(ki) * sample_time**lam + abs(kd) * sample_time**-mu
    assert first_control(np.array([gains.gains]), sample_time)[0] == pytest.approx(runs, abs=2e-3 * size + 1e-12)
