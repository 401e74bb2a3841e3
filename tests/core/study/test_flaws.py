"""What is not linear in a recorded process is found, and as large as it is."""

from __future__ import annotations

import numpy as np
import pytest

from fopid_core.design.identification.flaws import Flaws, joined
from fopid_core.design.identification.record import Record
from fopid_core.study.flaw_search import learn

from .replay_campaign import SAMPLES, Foreign


def learnt(seed: int) -> tuple[Foreign, Flaws]:
    plant = Foreign(seed)
    found = learn(plant.run(plant.running, SAMPLES), "soptd", 5, 0)
    assert found.identified.success, found.identified.message
    assert found.possible is not None
    assert len(found.possible.processes) == np.size(found.possible.flaws.bend) == 6
    return plant, found.flaws


@pytest.mark.slow
def test_a_dead_band_is_found_within_a_tenth() -> None:
    plant, flaws = learnt(6)
    assert (flaws.slip, flaws.bend, flaws.high) == (1.0, 0.0, np.inf)
    assert flaws.dead_band == pytest.approx(plant.stick, rel=0.1)
    assert str(flaws).startswith("the actuator sticks within")


@pytest.mark.slow
def test_limits_that_the_controller_knows_nothing_of_are_found() -> None:
    plant, flaws = learnt(1)
    assert (flaws.low, flaws.high) == pytest.approx((-plant.limit, plant.limit), rel=0.05)
    assert flaws.dead_band == 0.0


@pytest.mark.slow
def test_a_gain_that_changes_with_the_level_is_found() -> None:
    plant, flaws = learnt(3)
    assert flaws.dead_band == 0.0
    assert flaws.bend == pytest.approx(0.5 * plant.bend, abs=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 4, 8])
def test_nothing_is_found_in_a_linear_process(seed: int) -> None:
    _, flaws = learnt(seed)
    assert str(flaws) == ""


@pytest.mark.slow
def test_loads_and_flaws_that_run_away_explain_nothing() -> None:
    plant = Foreign(2111)  # a level whose setpoint steps once; dead band and loads beyond all that moved were found
    found = learn(plant.run(plant.running, SAMPLES), "soptd", 5, 0)
    assert not found.identified.success
    assert "is no noise" in found.identified.message


def test_play_and_limits_are_felt_as_written_down() -> None:
    control = np.array([0.0, 1.0, 3.0, 2.5, 0.0])
    assert Flaws(dead_band=0.5, slip=0.0, high=2.0).felt(control)[0].tolist() == [0.0, 0.5, 1.5, 1.5, 0.5]
    several = Flaws(dead_band=np.array([0.0, 0.5]), slip=np.array([1.0, 0.0]), high=2.0).felt(control)
    assert several.tolist() == [[0.0, 1.0, 2.0, 2.0, 0.0], [0.0, 0.5, 1.5, 1.5, 0.5]]


def test_a_stem_that_stood_beside_the_control_at_first_stays_until_the_control_is_far_from_it() -> None:
    control = np.array([0.0, 0.3, 0.8, 0.9])
    assert Flaws(dead_band=0.5, began=-0.4).felt(control)[0].tolist() == [-0.4, 0.3, 0.3, 0.9]


def test_several_flaws_as_one_are_felt_as_each_alone() -> None:
    control = np.sin(np.arange(40.0))
    some = [Flaws(dead_band=0.3, slip=0.0), Flaws(high=0.5), Flaws(dead_band=0.2, began=0.1)]
    assert np.array_equal(joined(some).felt(control), np.concatenate([each.felt(control) for each in some]))


@pytest.mark.parametrize("bend", [-0.4, 0.0, 0.3])
def test_bent_and_straight_undo_each_other_also_where_it_goes_on_straight(bend: float) -> None:
    flaws, values = Flaws(bend=bend, centre=0.5), np.linspace(-6.0, 6.0, 200)
    assert flaws.straight(flaws.bent(values)) == pytest.approx(values, abs=1e-9)
    assert np.all(np.diff(flaws.bent(values)) > 0.0)


def test_the_record_without_flaws_has_what_was_felt() -> None:
    time = np.arange(40.0)
    record = Record(time, np.sin(time), np.cos(time), control_before=3.0)
    bare = Flaws(high=0.5).of_record(record)
    assert bare.control.max() == 0.5
    assert bare.control_before == 0.5
    assert bare.measurement == pytest.approx(record.measurement)
