"""Recorded days as they are: samples drop out, sensors die for a while, rows are missing, a historian thins out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from fopid_core.design.identification.frequency_response import BEYOND, frequency_response
from fopid_core.design.identification.identify import identify
from fopid_core.design.identification.noise import sensor_noise
from fopid_core.design.identification.record import Record
from fopid_core.design.identification.sensor_faults import sound
from fopid_core.errors import InputError
from fopid_core.study.replay import replay

TICK, GAIN, LAG, DELAY, NOISE, COUNT = 0.5, 2.0, 20.0, 4.0, 0.05, 2400
Fault = Callable[[int, float, float], float]
"""What a sensor tells at a sample, of a value, after it has told another."""


def dropping(every: int, at: Sequence[int], to: float) -> Fault:
    return lambda sample, value, _: to if sample % every in at else value


def dead(first: int, last: int) -> Fault:
    return lambda sample, value, told: told if first < sample < last else value


FAULTS: dict[str, Fault] = {
    "samples that drop out": dropping(97, [50], 0.0),
    "two in a row to a number that stands for none": dropping(300, [20, 21], -9999.0),
    "near ones": dropping(300, [20, 22, 25], 100.0),
    "spikes": lambda sample, value, _: value + 4.0 * (sample % 211 == 50),
    "a sensor dead for a while": dead(1240, 1380),
    "a sensor that died": dead(1740, COUNT),
    "the end of its range": lambda _, value, __: min(value, 64.0),
}

NOWHERE_AT_REST = ("samples that drop out", "two in a row to a number that stands for none")
"""The others leave a stretch of rest that is long enough."""


def loop(fault: Fault = lambda _, value, __: value, seed: int = 0, load_at: int = COUNT) -> Record:
    """A lag with delay, exactly, held by a PI controller that believes what its sensor tells it."""
    chance, late, kept = np.random.default_rng(seed), round(DELAY / TICK), np.exp(-TICK / LAG)
    control, told, setpoint = np.full(COUNT, 30.0), np.full(COUNT, 60.0), np.full(COUNT, 60.0)
    setpoint[200:], setpoint[700:], setpoint[1200:], setpoint[1700:] = 66.0, 58.0, 63.0, 60.0
    true, integral = 60.0, 30.0
    for k in range(COUNT):
        told[k] = fault(k, true + NOISE * chance.standard_normal(), told[k - 1])
        integral += 0.03 * (setpoint[k] - told[k]) * TICK
        control[k] = integral + 0.6 * (setpoint[k] - told[k])
        acts = (control[k - late] if k >= late else 30.0) + 2.0 * (k >= load_at)
        true = kept * true + GAIN * (1.0 - kept) * acts
    return Record(TICK * np.arange(COUNT), control, told, setpoint)


def learnt(record: Record, tolerance: float = 0.05) -> str:
    """What is said of a process that was learnt as it is."""
    found = identify(record, "foptd")
    assert found.success, found.message
    assert found.best is not None
    gain, lag, delay = (found.best.parameters[name] for name in ("K", "T", "L"))
    assert gain == pytest.approx(GAIN, rel=tolerance)
    assert lag == pytest.approx(LAG, rel=tolerance)
    assert delay == pytest.approx(DELAY, abs=2.0 * TICK)
    return found.message


@pytest.mark.parametrize("fault", FAULTS)
def test_what_a_faulty_sensor_tells_is_told_and_left_out(fault: str) -> None:
    message = learnt(loop(FAULTS[fault]))
    assert ("dropped out" in message) != ("stands still at" in message)


@pytest.mark.parametrize("fault", FAULTS)
def test_nor_does_it_count_as_noise_or_in_the_response_without_a_model(fault: str) -> None:
    record = loop(FAULTS[fault])
    noise = sensor_noise(record)
    assert noise.at_rest == (fault not in NOWHERE_AT_REST)
    if noise.at_rest:
        assert noise.level < 1.3 * NOISE
    clean = identify(loop(), "foptd").best
    assert clean is not None
    shown = frequency_response(record)
    assert shown.outside(clean.process, BEYOND).sum() <= max(2, 0.1 * shown.known.sum())


def test_a_hole_in_the_record_while_the_control_moved_ends_a_stretch() -> None:
    whole = loop()
    kept = (whole.time < 605.0) | (whole.time > 640.0)
    signals = (whole.control[kept], whole.measurement[kept], whole.setpoint[kept])  # type: ignore[index]
    message = learnt(Record(whole.time[kept], *signals))
    assert "of 2329 samples the 1210 from 0 s to 604.5 s, a stretch without a break, were used" in message


def test_a_load_in_a_later_stretch_is_told_by_the_time_of_the_record() -> None:
    whole = loop(load_at=1450)
    kept = (whole.time < 95.0) | (whole.time > 130.0)
    signals = (whole.control[kept], whole.measurement[kept], whole.setpoint[kept])  # type: ignore[index]
    best = identify(Record(whole.time[kept], *signals), "foptd").best
    assert best is not None
    assert best.loads == pytest.approx([725.0], abs=10.0), "instants 8 s apart are tried"
    assert best.simulated[0][0] == pytest.approx(130.5)


def test_a_hole_while_the_loop_rested_ends_none() -> None:
    whole = loop()
    kept = (whole.time < 310.0) | (whole.time > 340.0)
    signals = (whole.control[kept], whole.measurement[kept], whole.setpoint[kept])  # type: ignore[index]
    assert not Record(whole.time[kept], *signals).breaks


def test_the_longest_stretch_is_not_always_the_one_that_tells_something() -> None:
    """The last one is longer and at rest."""
    whole = loop(dead(1190, 1260))
    rests = replace(whole, setpoint=None)
    rests.measurement[1400:] = 63.0 + NOISE * np.random.default_rng(1).standard_normal(1000)
    rests.control[1400:] = 31.5
    assert "from 0 s to 595 s, a stretch without a break" in learnt(rests)


def test_a_day_with_a_dead_sensor_or_a_break_is_not_lived_again() -> None:
    whole = loop()
    kept = (whole.time < 605.0) | (whole.time > 640.0)
    signals = (whole.control[kept], whole.measurement[kept], whole.setpoint[kept])  # type: ignore[index]
    with pytest.raises(InputError, match=r"no samples from 604.5 s to 640.5 s; allowed: a stretch without a break"):
        replay(Record(whole.time[kept], *signals))
    with pytest.raises(InputError, match=r"is the sensor dead.* allowed: a stretch without \(--from, --to\)"):
        replay(loop(FAULTS["a sensor dead for a while"]))


@pytest.mark.parametrize("tells", ["by exception", "on straight lines"])
def test_a_record_that_a_historian_has_thinned_out_is_named_where_it_is_refused(tells: str) -> None:
    whole = loop()
    kept = [0]
    for k in range(COUNT):
        if abs(whole.measurement[k] - whole.measurement[kept[-1]]) > 0.3:
            kept.append(k)
    if tells == "by exception":
        told = whole.measurement[np.array(kept)[np.searchsorted(kept, np.arange(COUNT), side="right") - 1]]
    else:
        told = np.interp(np.arange(COUNT), kept, whole.measurement[kept])
    found = identify(replace(whole, measurement=told), "foptd")
    assert found.success == ("a historian that compresses" not in found.message)
    assert not found.success


def test_a_sensor_that_was_dead_nearly_always_leaves_nothing_to_learn_from() -> None:
    found = identify(loop(dead(45, COUNT)), "foptd")
    assert not found.success
    assert "stands still at" in found.message


@pytest.mark.parametrize("step", [0.0, 0.02, 0.1, 1.0])
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_moves_of_a_process_are_no_faults(noise: float, step: float) -> None:
    """Steps, pulses of some samples, swings that nothing damps, and rests, sampled finely and coarsely."""
    chance, time = np.random.default_rng(2), np.arange(600.0)
    for values in (
        (time > 100.0).astype(float),
        np.where(time % 40 < 6, 1.0, 0.0),
        np.sin(time / 0.7),
        np.sin(time / 30.0),
        np.where(time > 200.0, np.exp(-(time - 200.0) / 15.0) * np.cos(time - 200.0), 0.0),
        np.where(time > 200.0, 1.0 - np.exp(-(time - 200.0) / 2.0), 0.0),
    ):
        told = values + noise * chance.standard_normal(600)
        record = Record(time, np.sin(time), np.round(told / step) * step if step else told)
        found, said = sound(record)
        assert found is record, said
