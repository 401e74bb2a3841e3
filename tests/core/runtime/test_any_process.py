"""What the grammar takes, the simulator runs: against inverse transforms in 25 digits, one for each echo of a delay."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import mpmath
import numpy as np
import pytest

from fopid_core.errors import InputError
from fopid_core.model.process import Process
from fopid_core.runtime.convolved_plant import ConvolvedPlant, plant_of
from fopid_core.runtime.plant import PlantSettings

Part = Callable[[mpmath.mpf], mpmath.mpf]


def exact(time: float, front: list[tuple[float, Part]], at_once: Part, late: Part, delay: float) -> float:
    """Step response of sum_i front_i exp(-L_i s) / (at_once + late exp(-delay s)), as a geometric series of echoes."""
    total = mpmath.mpf(0)
    for lag, numerator in front:
        k = 0
        while time - lag - k * delay > 1e-12:

            def term(s: mpmath.mpf, k: int = k, numerator: Part = numerator) -> mpmath.mpf:
                return numerator(s) * (-late(s)) ** k / (s * at_once(s) ** (k + 1))

            total += mpmath.invertlaplace(term, time - lag - k * delay, method="talbot")
            k += 1
            if late(mpmath.mpf(1)) == 0:
                break
    return float(total)


def none(_: mpmath.mpf) -> mpmath.mpf:
    return mpmath.mpf(0)


def one(_: mpmath.mpf) -> mpmath.mpf:
    return mpmath.mpf(1)


CASES: dict[str, tuple[float, list[tuple[float, Part]], Part, Part, float]] = {
    "1/(s^1.5+1)": (0.1, [(0.0, one)], lambda s: s**1.5 + 1, none, 1.0),
    "1/(2s^0.8+1)*exp(-0.0499s)": (0.05, [(0.0499, one)], lambda s: 2 * s**0.8 + 1, none, 1.0),
    "(0.5s^0.8+1)/(s^1.3+0.4s^0.5+1)": (0.1, [(0.0, lambda s: 0.5 * s**0.8 + 1)],
                                        lambda s: s**1.3 + 0.4 * s**0.5 + 1, none, 1.0),
    "1/((1e5s+1)(1e-5s+1))": (0.5, [(0.0, one)], lambda s: (1e5 * s + 1) * (1e-5 * s + 1), none, 1.0),
    "(s+1)/(0.001s+1)": (0.0005, [(0.0, lambda s: s + 1)], lambda s: 0.001 * s + 1, none, 1.0),
    "1/(s+1+0.5*exp(-s))": (0.1, [(0.0, one)], lambda s: s + 1, lambda _: mpmath.mpf(0.5), 1.0),
    "1/(s^0.5+exp(-s))": (0.1, [(0.0, one)], lambda s: s**0.5, one, 1.0),
    "2/(s+exp(-0.7s))*exp(-0.33s)": (0.1, [(0.33, lambda _: mpmath.mpf(2))], lambda s: s, one, 0.7),
    "(1-exp(-0.95s))/s": (0.1, [(0.0, one), (0.95, lambda _: mpmath.mpf(-1))], lambda s: s, none, 1.0),
    "1/(s^1.5+0.3*exp(-2s)*s+1)": (0.1, [(0.0, one)], lambda s: s**1.5 + 1, lambda s: 0.3 * s, 2.0),
    "(1+exp(-s)*s^0.3)/(s+1)": (0.1, [(0.0, one), (1.0, lambda s: s**0.3)], lambda s: s + 1, none, 1.0),
    "(s^0.5*exp(-2s)+exp(-s))/(s+1)": (0.1, [(2.0, lambda s: s**0.5), (1.0, one)], lambda s: s + 1, none, 1.0),
    "(1+0.3*exp(-0.5s)*s^0.5)/(s+1)": (0.01, [(0.0, one), (0.5, lambda s: 0.3 * s**0.5)], lambda s: s + 1, none, 1.0),
    "1/(1+0.9*exp(-s))": (0.1, [(0.0, one)], one, lambda _: mpmath.mpf(0.9), 1.0),
    "1/(1+exp(-2s))*exp(-0.25s)": (0.1, [(0.25, one)], one, one, 2.0),
    "1/(s+1+0.9*exp(-s)*s)": (0.1, [(0.0, one)], lambda s: s + 1, lambda s: mpmath.mpf(0.9) * s, 1.0),
    "1/(s+1-exp(-0.3s))": (0.1, [(0.0, one)], lambda s: s + 1, lambda _: mpmath.mpf(-1), 0.3),
    "(s+1+exp(-s))/(s+2)": (0.1, [(0.0, lambda s: s + 1), (1.0, one)], lambda s: s + 2, none, 1.0),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("process", CASES)
def test_the_step_response_is_exact_to_1e_minus_6_at_every_sample_looked_at(process: str) -> None:
    h, *parts = CASES[process]
    plant = plant_of(PlantSettings(Process.parse(process), h, delay_model="exact"))
    found = np.array([plant.step(1.0) for _ in range(60)])
    with mpmath.workdps(25):
        for k in (1, 2, 11, 60):
            assert found[k - 1] == pytest.approx(exact(h * k, *parts), abs=1e-6 * np.abs(found).max()), k


def test_an_unstable_process_runs_as_long_as_its_response_is_known() -> None:
    """A pole at 3^(1/1.2) = 2.5 rad/s."""
    plant = plant_of(PlantSettings(Process.parse("1/(s^1.2-3)"), 0.05))
    assert plant.ends_by == pytest.approx(409.6)
    found = [plant.step(1.0) for _ in range(60)]
    with mpmath.workdps(25):
        for k in (1, 40, 60):
            true = mpmath.invertlaplace(lambda s: 1 / (s**1.2 - 3) / s, 0.05 * k, method="talbot")
            assert found[k - 1] == pytest.approx(float(true), rel=1e-6), k
    with pytest.raises(InputError, match=r"within 409.6 s of a step of its input .* grows by more than .* sample_time"):
        deque(map(plant.step, [0.0] * 5000), maxlen=0)


def test_a_jump_at_a_sample_is_seen_after_it_as_the_plant_with_a_state_does() -> None:
    inside = Process.parse("(s+1+exp(-s))/(s+2)")
    jumps = ConvolvedPlant(PlantSettings(inside, 0.1))
    found = np.array([jumps.step(1.0) for _ in range(30)])
    first, second = (
        plant_of(PlantSettings(Process.parse(text), 0.1, delay_model="exact"))
        for text in ("(s+1)/(s+2)", "1/(s+2)*exp(-s)")
    )
    assert found == pytest.approx([first.step(1.0) + second.step(1.0) for _ in range(30)], abs=1e-7)
