"""Dry friction is learnt with the process it hides; the records come from bodies stepped through in plain Python."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest

from fopid_core.design.flaw_trial import FlawTrial
from fopid_core.design.identification.flaws import Flaws
from fopid_core.design.identification.friction import Friction, friction_of
from fopid_core.design.identification.identify import identify
from fopid_core.design.identification.record import Record
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process

STEP, SUBSTEPS = 0.005, 40
INERTIA, DAMPING, SIZE, NOISE = 0.03, 0.06, 0.02, 5e-4


def day(spring: float, size: float, seed: int, pushed: float = 0.0, seconds: float = 30.0) -> Record:
    """A body under P and D of its noisy place and steps that are added; explicit steps of a fortieth of a tick."""
    dice = random.Random(seed)
    place = speed = before = added = 0.0
    rows = []
    for k in range(round(seconds / STEP)):
        if k % 120 == 0:
            added = dice.choice((-1.0, 1.0)) * 0.06
        read = place + dice.gauss(0.0, NOISE)
        control = -1.0 * read - 0.05 * (read - before) / STEP * 0.2 + added
        before = read
        rows.append((k * STEP, control, read))
        for _ in range(SUBSTEPS):
            force = control + pushed - spring * place
            if speed == 0.0 and abs(force) <= size:
                continue
            direction = math.copysign(1.0, speed or force)
            faster = speed + STEP / SUBSTEPS * (force - DAMPING * speed - size * direction) / INERTIA
            speed = 0.0 if faster * direction < 0.0 else faster
            place += STEP / SUBSTEPS * speed
    return Record(*np.array(rows).T)


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("spring", [0.6, 0.0])
def test_friction_is_learnt_and_the_process_without_it(spring: float, seed: int) -> None:
    found = identify(day(spring, SIZE, seed), noise=NOISE)
    assert found.success, found.message
    assert found.best is not None
    assert "the process moves against a dry friction of 0.0" in found.message
    assert found.flaws.friction is not None
    assert found.flaws.friction.size == pytest.approx(SIZE, rel=0.1)
    for w in (2.0, 5.0, 10.0):
        s = 1j * w
        true = 1.0 / (INERTIA * s * s + DAMPING * s + spring)
        assert abs(found.best.process(s) / true - 1.0) < 0.2


@pytest.mark.slow
@pytest.mark.parametrize("spring", [0.6, 0.0])
def test_where_there_is_none_none_is_found(spring: float) -> None:
    record = day(spring, 0.0, 3)
    found = identify(record, noise=NOISE)
    assert found.success
    assert found.best is not None
    assert found.flaws.friction is None
    assert friction_of(record, found.best.noise) is None


def test_too_little_is_no_friction() -> None:
    assert friction_of(day(0.6, SIZE, 4, seconds=0.9), 1.0) is None


@pytest.mark.slow
def test_ticks_may_come_a_little_early_or_late_and_some_may_be_missing() -> None:
    record = day(0.6, SIZE, 0)
    dice = np.random.default_rng(1)
    kept = dice.random(record.time.size) > 0.03
    late = record.time + 0.1 * STEP * dice.random(record.time.size)
    found = friction_of(Record(late[kept], record.control[kept], record.measurement[kept]), 0.01)
    assert found is not None
    assert found.size == pytest.approx(SIZE, rel=0.15)


def test_a_constant_force_beside_the_control_is_found() -> None:
    quiet, pushed = day(0.6, SIZE, 5), day(0.6, SIZE, 5, pushed=0.05)
    friction = Friction(SIZE, INERTIA, DAMPING, 0.6)
    for record in (quiet, pushed):
        taken = record.control - friction.felt(record)
        speed = np.gradient(np.convolve(record.measurement, np.ones(21) / 21.0, mode="same"))[30:-30]
        moves = np.abs(speed) > np.quantile(np.abs(speed), 0.8)
        against = np.sign(speed[moves]) * taken[30:-30][moves]
        assert np.mean(np.abs(against / SIZE - 1.0) < 0.05) > 0.9


def test_gains_that_make_a_body_with_friction_hunt_are_refused() -> None:
    process, flaws = Process.parse("1/(0.03s^2+0.06s+0.6)"), Flaws(friction=Friction(SIZE, INERTIA, DAMPING, 0.6))
    trial = FlawTrial(process, flaws, STEP, 0.0, Loop(process, Fopid(kp=2.0, ki=2.0, kd=0.2)))
    assert trial.refusal(Loop(process, Fopid(kp=4.0, ki=6.0, kd=0.3))) == ""
    assert "the process moves against a dry friction of 0.02: after a load of" in trial.refusal(
        Loop(process, Fopid(kp=0.2, ki=1.3, kd=0.02))
    )


def test_what_takes_the_place_of_gains_near_instability_may_leave_up_to_twice_their_error() -> None:
    """Those of a motor's position, which only its dry friction holds: max |S| is 4.8 without it."""
    motor, flaws = Process.parse("1/(0.00047s^2+0.028s)"), Flaws(friction=Friction(0.058, 0.00047, 0.028, 0.0))
    near = Loop(motor, Fopid(kp=9.9, ki=182.0))
    calm, slow = (Loop(motor, gains) for gains in (Fopid(kp=5.0, ki=120.0, kd=0.05), Fopid(kp=1.6, ki=22.0)))
    kept, not_kept = (FlawTrial(motor, flaws, 0.002, 0.0, near, to_be_kept=kept) for kept in (True, False))
    assert "times the error of what runs" in kept.refusal(calm)
    assert not_kept.refusal(calm) == ""
    assert "times the error of what runs" in not_kept.refusal(slow)
