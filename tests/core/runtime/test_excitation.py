"""An experiment moves what it shall, for as long as announced, and ends when the measurement leaves its band."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fopid_core.errors import InputError
from fopid_core.model.process import Process
from fopid_core.runtime.excitation import Excitation, ExcitationSettings
from fopid_core.runtime.plant import Plant, PlantSettings

STEP = 0.01


def settings_of(kind: str, **changes: object) -> ExcitationSettings:
    given = {"amplitude": 1.0, "low": -5.0, "high": 5.0, "hold": 1.0}
    if kind == "relay":
        given |= {"acts_on": "control"}
    return ExcitationSettings(kind, **(given | changes))  # type: ignore[arg-type]


def drive(excitation: Excitation, process: str, gain: float = 1.0, longest: float = 500.0) -> list[float]:
    """Add to the control of a plant at rest until the experiment is over; what was added."""
    plant, added = Plant(PlantSettings(Process.parse(process), STEP, "exact")), [0.0]
    while not excitation.finished:
        added.append(excitation.step(0.0, plant.measurement, added[-1], len(added) * STEP))
        plant.step(gain * added[-1])
        assert len(added) < longest / STEP
    return added[1:]


@pytest.mark.parametrize(("kind", "duration"), [("step", 2.0), ("prbs", 63.0), ("relay", 8.0)])
def test_the_duration_is_announced_and_kept(kind: str, duration: float) -> None:
    excitation = Excitation(settings_of(kind, rest=0.5))
    assert excitation.settings.duration == duration + 0.5
    took = len(drive(excitation, "1/(0.1s+1)^3")) * STEP
    assert excitation.completed
    assert took <= duration + 0.5 + 2 * STEP
    if kind != "relay":
        assert took >= duration + 0.5


@pytest.mark.parametrize("kind", ["step", "prbs", "relay"])
def test_nothing_is_added_before_the_rest_is_over_nor_after_the_end(kind: str) -> None:
    excitation = Excitation(settings_of(kind, rest=1.0))
    added = drive(excitation, "1/(0.1s+1)^3")
    assert not np.any(added[: round(1.0 / STEP)])
    assert excitation.progress == 1.0
    assert excitation.step(0.0, 0.0, 0.0, 1e3) == 0.0


@pytest.mark.parametrize("kind", ["step", "prbs", "relay"])
def test_a_measurement_out_of_its_band_ends_it_at_once(kind: str) -> None:
    excitation = Excitation(settings_of(kind, amplitude=3.0, low=-0.5, high=0.5))
    added = drive(excitation, "1/s*exp(-0.3s)")
    assert added[-1] == 0.0
    assert not excitation.completed
    assert "left the band -0.5 to 0.5" in excitation.reason


@pytest.mark.parametrize("kind", ["step", "prbs", "relay"])
@settings(derandomize=True, deadline=None, max_examples=30)
@given(measurements=st.lists(st.floats(-2.0, 2.0), min_size=5, max_size=60), amplitude=st.floats(0.1, 3.0))
def test_nothing_but_the_amplitude_is_ever_added(kind: str, measurements: list[float], amplitude: float) -> None:
    excitation = Excitation(settings_of(kind, amplitude=amplitude))
    added = [excitation.step(0.0, y, 0.0, 0.1 * k) for k, y in enumerate(measurements)]
    assert {abs(value) for value in added} <= {0.0, amplitude}


@pytest.mark.parametrize(("process", "gain"), [("1/(s+1)^3", 1.0), ("-1/(s+1)^3", -1.0)])
def test_a_relay_oscillates_at_the_frequency_of_180_degrees(process: str, gain: float) -> None:
    """The describing function of a relay without hysteresis: period 2 pi / sqrt(3) for three lags of 1 s."""
    excitation = Excitation(settings_of("relay", amplitude=gain, hold=20.0, switches=14))
    drive(excitation, process)
    assert excitation.completed
    # the fundamental stands for the whole square wave: 5 % is usual for three lags
    assert excitation.period == pytest.approx(2.0 * math.pi / math.sqrt(3.0), rel=0.05)


def test_a_relay_that_does_not_switch_says_so() -> None:
    excitation = Excitation(settings_of("relay", hold=3.0))
    drive(excitation, "-1/(s+1)")
    assert not excitation.completed
    assert excitation.reason == "the relay did not switch within 3 s"


@pytest.mark.parametrize("order", [3, 4, 5, 6, 7, 9, 10])
def test_a_pseudo_random_sequence_is_as_white_as_can_be(order: int) -> None:
    excitation = Excitation(settings_of("prbs", order=order))
    length = 2**order - 1
    bits = np.array([excitation.step(0.0, 0.0, 0.0, k + 0.5) for k in range(length + 1)])[:length]
    correlation = np.array([bits @ np.roll(bits, k) for k in range(length)])
    assert correlation[0] == length
    assert np.all(correlation[1:] == -1.0)  # Golomb: a sequence of maximal length


def test_it_can_be_cancelled_at_any_moment() -> None:
    excitation = Excitation(settings_of("step"))
    assert excitation.step(0.0, 0.0, 0.0, 0.0) == 1.0
    excitation.cancel()
    assert excitation.step(0.0, 0.0, 0.0, 0.1) == 0.0
    assert (excitation.finished, excitation.completed, excitation.reason) == (True, False, "cancelled")


@pytest.mark.parametrize(
    "wrong",
    [
        {"kind": "chirp"},
        {"kind": "relay"},
        {"amplitude": 0.0},
        {"amplitude": math.inf},
        {"low": 5.0},
        {"hold": 0.0},
        {"rest": -1.0},
        {"hysteresis": -1.0},
        {"order": 8},
        {"switches": 1},
        {"acts_on": "measurement"},
    ],
)
def test_settings_that_make_no_sense_are_named(wrong: dict[str, object]) -> None:
    good = {"kind": "step", "amplitude": 1.0, "low": -5.0, "high": 5.0, "hold": 1.0}
    named = "acts_on" if wrong == {"kind": "relay"} else next(iter(wrong))
    with pytest.raises(InputError, match=named):
        ExcitationSettings(**(good | wrong))  # type: ignore[arg-type]


def test_a_signal_that_is_not_finite_is_refused() -> None:
    with pytest.raises(InputError, match="measurement = nan"):
        Excitation(settings_of("step")).step(0.0, math.nan, 0.0, 0.0)
