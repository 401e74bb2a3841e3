"""The measures of a segment are those of responses known in closed form; cuts are where something happens."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import trapezoid

from fopid_core.design.specification import Achieved
from fopid_core.model.fopid import Fopid
from fopid_core.study.reports.run import Phase, Run, Signal, Tuning
from fopid_core.study.reports.segments import Retuning, Segment, retunings, segments

STEP = 1e-3
NAN = math.nan
NOTHING_ACHIEVED = Achieved(*[NAN] * 9)


def run_of(time, setpoint, measurement, control=None, disturbance=None, **more) -> Run:
    arrays = {"setpoint": setpoint, "measurement": measurement, "control": control, "disturbance": disturbance}
    signals = {
        name: Signal(time, np.broadcast_to(np.asarray(0.0 if value is None else value, dtype=float), time.shape).copy())
        for name, value in arrays.items()
    }
    return Run(Path("run"), signals, **more)


def state_of(time, *changes: tuple[float, Fopid]) -> dict[str, np.ndarray]:
    """The controller's state with the gains that came into force at each instant."""
    rows = np.array([next(gains.gains for at, gains in reversed(changes) if t >= at) for t in time])
    return {"time": time, **dict(zip(("kp", "ki", "kd", "lam", "mu"), rows.T, strict=True))}


def tuning(time: float, method: str, gains: Fopid, process: str = "", achieved: Achieved = NOTHING_ACHIEVED) -> Tuning:
    return Tuning(time, method, process, True, True, "done", gains, achieved, True, (), 0.1)


@settings(derandomize=True, deadline=None, max_examples=40)
@given(
    before=st.floats(-5.0, 5.0), size=st.floats(0.1, 8.0), sign=st.sampled_from([-1.0, 1.0]), tau=st.floats(0.2, 2.0)
)
def test_a_first_order_answer_has_the_textbook_measures(before: float, size: float, sign: float, tau: float) -> None:
    """y = r0 + A (1 - exp(-t/tau)): rise tau ln 9, settling tau ln 50, IAE A tau, ITAE A tau^2."""
    step = sign * size
    time = np.arange(-5.0, 40.0, STEP)
    after = time >= 0.0
    setpoint = np.where(after, before + step, before)
    measurement = np.where(after, before + step * -np.expm1(-np.maximum(time, 0.0) / tau), before)
    if max(abs(before), abs(before + step)) < 1e-3:
        return
    found = segments(run_of(time, setpoint, measurement))[-1]
    assert found.start == pytest.approx(0.0, abs=STEP)
    assert found.overshoot_pct == pytest.approx(0.0, abs=1e-9)
    # The crossing instants are interpolated: an error of the order of STEP^2 / tau.
    assert found.rise_time == pytest.approx(tau * math.log(9.0), abs=2.0 * STEP**2 / tau + 1e-9)
    assert found.settling_time == pytest.approx(tau * math.log(50.0), abs=STEP + STEP**2 / tau)
    assert found.iae == pytest.approx(size * tau, rel=1e-5)
    assert found.itae == pytest.approx(size * tau**2, rel=1e-5)
    assert found.error_peak == pytest.approx(size, rel=1e-9)


@pytest.mark.parametrize("damping", [0.2, 0.5, 0.7])
def test_a_second_order_answer_overshoots_as_the_textbook_says(damping: float) -> None:
    time = np.arange(0.0, 60.0, STEP)
    root = math.sqrt(1.0 - damping**2)
    measurement = 2.0 - 2.0 * np.exp(-damping * time) * (np.cos(root * time) + damping / root * np.sin(root * time))
    (found,) = segments(run_of(time, 2.0, measurement))
    assert found.overshoot_pct == pytest.approx(100.0 * math.exp(-math.pi * damping / root), rel=1e-5)


def test_a_load_step_has_a_settling_time_in_the_band_of_the_setpoints_step_and_no_overshoot() -> None:
    """e = -0.4 exp(-t) after the load: within 2 % of the setpoint's step of 2 after ln 10."""
    time = np.arange(-20.0, 20.0, STEP)
    measurement = 2.0 * -np.expm1(-np.maximum(time + 10.0, 0.0) * 5.0) + np.where(time >= 0, 0.4 * np.exp(-time), 0.0)
    setpoint = np.where(time >= -10.0, 2.0, 0.0)
    disturbance = np.where(time >= 0.0, 0.7, 0.0)
    found = segments(run_of(time, setpoint, measurement, disturbance=disturbance))[-1]
    assert found.name.endswith("disturbance 0 → 0.7")
    assert found.settling_time == pytest.approx(math.log(10.0), abs=STEP)
    assert math.isnan(found.overshoot_pct)
    assert math.isnan(found.rise_time)
    assert found.iae == pytest.approx(0.4, rel=1e-4)


def test_the_largest_control_is_that_of_its_own_segment() -> None:
    time = np.arange(0.0, 3.0, 0.01)
    control = np.select([time < 1.0, time < 2.0], [-7.0, 3.0], 5.0)
    setpoint = np.floor(time) + 1.0
    assert [s.control_peak for s in segments(run_of(time, setpoint, 0.0, control=control))] == [7.0, 3.0, 5.0]


def test_one_row_for_each_phase_of_an_experiment() -> None:
    time = np.arange(0.0, 40.0, 0.01)
    setpoint = np.select([time < 10.0, time < 20.0], [1.0, 2.0], 2.0)
    disturbance = np.where(time >= 20.0, -0.5, 0.0)
    first, second = Fopid(1.0), Fopid(2.0, 1.0)
    names = ("start", "tuned", "load", "rest")
    run = run_of(
        time, setpoint, 0.9 * setpoint, disturbance=disturbance, state=state_of(time, (0.0, first), (10.02, second)),
        phases=tuple(Phase(10.0 * i, name) for i, name in enumerate(names)),
        tunings=(tuning(9.9, "frequency", second),),
    )  # fmt: skip
    found = segments(run)
    assert [(s.name, s.method, s.gains) for s in found] == [
        ("start", "start", first), ("tuned", "frequency", second), ("load", "frequency", second),
        ("rest", "frequency", second),
    ]  # fmt: skip
    assert [s.start for s in found] == pytest.approx([0.0, 10.0, 20.0, 30.0], abs=1e-9)
    assert [s.end for s in found] == pytest.approx([10.0, 20.0, 30.0, 39.99], abs=1e-9)


def test_an_event_within_a_phase_makes_a_row_of_its_own() -> None:
    time = np.arange(0.0, 20.0, 0.01)
    setpoint = np.where(time >= 5.0, 2.0, 1.0)
    changes = state_of(time, (0.0, Fopid(1.0)), (12.0, Fopid(3.0)))
    run = run_of(time, setpoint, setpoint, state=changes, phases=(Phase(0.0, "all"),))
    assert [(s.name, s.method) for s in segments(run)] == [
        ("all", "start"), ("all: setpoint 1 → 2", "start"), ("all: retuned (by hand)", "by hand"),
    ]  # fmt: skip


def test_on_a_wall_clock_what_processes_do_about_one_phase_is_one_event() -> None:
    """The tuner's gains arrive, the setpoint moves, the phase is announced; before the first phase is nothing."""
    time = np.arange(0.0, 20.0, 0.01)
    setpoint = Signal(np.array([2.09, 8.3]), np.array([1.0, 2.0]))
    gains = (0.0, Fopid(1.0)), (8.0, Fopid(3.0))
    run = run_of(time, 0.0, 0.0, state=state_of(time, *gains), phases=(Phase(2.1, "first"), Phase(8.35, "second")))
    run = replace(run, start=10**18, signals={**run.signals, "setpoint": setpoint})
    assert [(s.name, s.start) for s in segments(run)] == [("first", 2.09), ("second", 8.3)]
    assert [s.gains.kp for s in segments(run)] == [1.0, 3.0]
    simulated = replace(run, start=0)
    assert [s.name for s in segments(simulated)] == ["first", "first: retuned (by hand)", "second"]


def test_steps_in_quick_succession_stay_apart_on_a_wall_clock() -> None:
    time = np.arange(0.0, 5.0, 0.01)
    run = replace(run_of(time, np.floor(time / 0.3), 0.0), start=10**18)
    assert [s.start for s in segments(run)] == pytest.approx(0.3 * np.arange(1, 17), abs=0.01)


@pytest.mark.parametrize("shape", [lambda t: 0.1 * t, np.sin, lambda t: np.floor(t / 0.02)])
def test_a_setpoint_that_never_rests_is_not_cut(shape) -> None:
    time = np.arange(0.0, 20.0, 0.01)
    assert len(segments(run_of(time, shape(time), 0.0))) == 1


def test_a_run_without_events_or_setpoint_is_one_segment_without_error_measures() -> None:
    time = np.arange(0.0, 10.0, 0.01)
    run = Run(Path("run"), {"measurement": Signal(time, np.sin(time)), "control": Signal(time, 2.0 * np.cos(time))})
    (found,) = segments(run)
    assert (found.start, found.end, found.control_peak) == (0.0, time[-1], 2.0)
    for name in ("overshoot_pct", "rise_time", "settling_time", "iae", "itae", "error_peak", "ms", "phase_margin"):
        assert math.isnan(getattr(found, name)), name


def test_a_run_that_starts_at_rest_on_its_setpoint_has_no_step_there() -> None:
    time = np.arange(0.0, 10.0, 0.01)
    (found,) = segments(run_of(time, 5.0, 5.0 + 0.01 * np.sin(time)))
    assert math.isnan(found.overshoot_pct)


@settings(derandomize=True, deadline=None, max_examples=50)
@given(cuts=st.lists(st.integers(20, 1980), max_size=6, unique=True))
def test_segments_cover_the_run_without_gap_or_overlap(cuts: list[int]) -> None:
    time = 0.01 * np.arange(2001)
    setpoint = np.ones_like(time)
    for cut in cuts:
        setpoint[cut:] += 1.0
    found = segments(run_of(time, setpoint, 0.5 * setpoint))
    assert found[0].start == 0.0
    assert found[-1].end == time[-1]
    assert all(a.end == b.start for a, b in pairwise(found))
    assert all(isinstance(s, Segment) and s.start < s.end for s in found)
    # the integrals of the pieces are the integral of the whole (the jumps lie between samples)
    whole = float(trapezoid(np.abs(setpoint - 0.5 * setpoint), time))
    assert sum(s.iae for s in found) == pytest.approx(whole, abs=0.01 * 0.5 * len(cuts) + 1e-9)


def test_retunings_are_the_first_gains_and_every_change() -> None:
    time = np.arange(0.0, 4.0, 0.1)
    a, b, c = Fopid(1.0), Fopid(2.0, 1.0, 0.5, 0.9, 1.1), Fopid(3.0)
    answer = tuning(0.95, "time", b)
    run = run_of(time, 1.0, 1.0, state=state_of(time, (0.0, a), (1.0, b), (2.0, c), (3.0, b)), tunings=(answer,))
    assert [(change.method, change.gains, change.tuning) for change in retunings(run)] == [
        ("start", a, None), ("time", b, answer), ("by hand", c, None), ("time", b, answer),
    ]  # fmt: skip
    assert [change.time for change in retunings(run)] == pytest.approx([0.0, 1.0, 2.0, 3.0])


def test_without_the_controllers_state_the_tuners_word_is_taken() -> None:
    answers = (tuning(1.0, "frequency", Fopid(2.0)), tuning(2.0, "rule", Fopid(3.0)))
    run = run_of(np.arange(0.0, 4.0, 0.1), 1.0, 1.0, tunings=answers)
    assert retunings(run) == tuple(Retuning(t.time, t.gains, t.method, t) for t in answers)


def test_robustness_is_that_of_the_loop_with_its_process() -> None:
    """PI on 1/(s+1)^3 against python-control and a dense frequency grid."""
    time = np.arange(0.0, 5.0, 0.01)
    gains = Fopid(kp=1.5, ki=0.6)
    run = run_of(time, 1.0, 0.0, state=state_of(time, (0.0, gains)), metadata={"process": "P1"})
    (found,) = segments(run)
    s = control.tf("s")
    loop = (gains.kp + gains.ki / s) / (s + 1) ** 3
    _, phase_margin, _, _ = control.margin(loop)
    w = np.logspace(-3, 2, 200_000)
    assert found.phase_margin == pytest.approx(math.radians(phase_margin), rel=1e-6)
    assert found.ms == pytest.approx(np.max(np.abs(1.0 / (1.0 + loop(1j * w)))), rel=1e-7)


def test_without_a_process_robustness_is_what_the_tuner_reported() -> None:
    time = np.arange(0.0, 5.0, 0.01)
    gains = Fopid(kp=1.5, ki=0.6)
    reported = Achieved(1.1, *[NAN] * 4, 1.4, NAN)
    run = run_of(
        time, 1.0, 0.0, state=state_of(time, (0.0, gains)), tunings=(tuning(0.0, "rule", gains, "", reported),)
    )
    (found,) = segments(run)
    assert (found.ms, found.phase_margin) == (1.4, 1.1)


def test_a_loop_that_is_not_stable_has_no_robustness() -> None:
    time = np.arange(0.0, 5.0, 0.01)
    run = run_of(time, 1.0, 0.0, state=state_of(time, (0.0, Fopid(kp=9.0))), metadata={"process": "1/(s+1)^3"})
    (found,) = segments(run)
    assert math.isnan(found.ms)
    assert math.isnan(found.phase_margin)
