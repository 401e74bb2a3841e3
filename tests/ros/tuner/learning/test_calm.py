"""The wait for the experiment to die out takes what that takes, not what chance adds."""

from __future__ import annotations

import numpy as np
import pytest

from fopid_ros.tuner.learning.calm import Calm


def calm_after(signal: np.ndarray, near: float, calm_for: float) -> float:
    """When a signal of one sample a second has been calm for so long [s]; infinite for never."""
    calm = Calm(near, 0.2 * calm_for)
    for time, value in enumerate(signal.tolist()):
        calm.step(float(time), value)
        if calm.lasted >= calm_for:
            return float(time)
    return float("inf")


@pytest.mark.parametrize("seed", range(5))
def test_noise_alone_is_calm(seed: int) -> None:
    noise = np.random.default_rng(seed).standard_normal(2000)
    assert np.any(np.abs(noise[10:300]) > 2.5), "single samples do go that far"
    assert calm_after(noise, 2.5, 200.0) <= 220.0


def test_what_has_not_died_out_is_not_calm() -> None:
    time = np.arange(2000.0)
    dying = 20.0 * np.exp(-time / 100.0) + 0.5 * np.random.default_rng(0).standard_normal(2000)
    small_from = 100.0 * np.log(20.0 / 2.5)
    assert small_from + 200.0 < calm_after(dying, 2.5, 200.0) < small_from + 300.0
    assert calm_after(5.0 * np.sin(0.02 * time), 2.5, 200.0) == float("inf")
