"""Plants that are drawn by chance are what their traits say."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from foreign_plants.drawn import KINDS, Drawn, Traits
from foreign_plants.gallery import DRAWN, GALLERY
from virtual_loop import VirtualLoop

ALL = [Traits.drawn(number) for number in range(24)]


def test_all_kinds_are_drawn_with_quick_and_slow_actuators() -> None:
    assert {one.kind for one in ALL} == set(KINDS)
    assert 3 < sum(math.isinf(one.rate) for one in ALL) < 15
    assert {one.stiction > 0.0 for one in ALL} == {one.backlash > 0.0 for one in ALL} == {False, True}


def test_a_number_always_stands_for_the_same_plant() -> None:
    assert Traits.drawn(7) == Traits.drawn(7) != Traits.drawn(8)
    assert GALLERY[f"{DRAWN}7"].gains == GALLERY[f"{DRAWN}7"].gains


@pytest.mark.parametrize("name", ["drawn", "drawn_", "drawn_x", "level"])
def test_another_name_is_no_plant(name: str) -> None:
    with pytest.raises((KeyError, ValueError)):
        GALLERY[name]


@pytest.mark.parametrize("kind", KINDS)
def test_a_step_of_the_control_ends_where_the_gain_says(kind: str) -> None:
    one = replace(
        ALL[0], kind=kind, noise=0.0, step=0.0, stiction=0.0, backlash=0.0, rate=math.inf, curve=0.0, damping=0.6
    )
    plant = Drawn(one)
    before = plant.measurement
    seen = [plant.step(55.0, one.sample_time) - before for _ in range(round(20.0 * one.lag / one.sample_time))]
    went = (seen[-1] - seen[-1 - round(one.lag / one.sample_time)]) if kind == "integrator" else seen[-1]
    assert went == pytest.approx(5.0 * one.gain, rel=0.02)
    late = one.delay if kind == "delay" else 0.0
    assert max(map(abs, seen[: round(0.9 * late / one.sample_time)]), default=0.0) == 0.0
    assert (min(seen) < -0.01 * one.gain) == (kind == "inverse response")


@pytest.mark.parametrize("number", range(24))
def test_the_gains_it_begins_with_hold_it(number: int) -> None:
    exhibit = GALLERY[f"{DRAWN}{number}"]
    loop = VirtualLoop(exhibit, 1)
    loop.setpoint += exhibit.move
    loop.run(exhibit.horizon)
    away = [abs(true - loop.setpoint) for true in loop.trace.true]
    assert max(away[len(away) // 2 :]) < exhibit.move
