"""What a record leaves possible, against the process it is from, simulated by another room."""

from __future__ import annotations

import control
import numpy as np
import pytest

from fopid_core.study.flaw_search import learn
from fopid_core.study.possible import two_lags

from .replay_campaign import SAMPLES, Foreign


@pytest.mark.parametrize(("lag", "shape"), [(2.0, 0.1), (1.0, 0.25), (0.5, 3.0), (4.0, 1e-5)])
def test_step_responses_of_two_lags_are_those_of_python_control(lag: float, shape: float) -> None:
    time = np.linspace(0.0, 10.0, 200)
    _, known = control.step_response(control.tf([1.0], [shape * lag**2, lag, 1.0]), time)
    assert two_lags(np.array([lag]), np.array([shape]), time[np.newaxis])[0] == pytest.approx(known, abs=1e-6)


def test_nothing_answers_before_its_delay() -> None:
    assert np.all(two_lags(np.ones(1), np.array([0.1]), np.array([[-2.0, -1e-9, 0.0]])) == 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 6])
def test_draws_lie_about_the_process_that_made_the_record(seed: int) -> None:
    plant = Foreign(seed)
    found = learn(plant.run(plant.running, SAMPLES), "soptd", 40, seed)
    assert found.possible is not None
    gains = np.array([process.steady_state_gain for process in found.possible.processes[1:]])
    delays = np.array([process.delay for process in found.possible.processes[1:]])
    for drawn, truth in ((gains, plant.gain), (delays, plant.delay)):
        assert abs(drawn.mean() - truth) < 4.0 * drawn.std()
        assert drawn.std() < 0.1 * truth
    assert len({str(process) for process in found.possible.processes}) > 30


@pytest.mark.slow
@pytest.mark.parametrize("seed", [8498, 8578, 8862])
def test_the_dead_band_that_made_the_record_is_among_the_draws_where_smaller_ones_explain_it_nearly_as_well(
    seed: int,
) -> None:
    """The likelihood over the dead band is narrow peaks; moves from one to another alone do not meet them all."""
    plant = Foreign(seed)
    found = learn(plant.run(plant.running, SAMPLES), "soptd", 40, seed)
    assert found.possible is not None
    away = np.abs(np.asarray(found.possible.flaws.dead_band)[1:] / plant.stick - 1.0)
    # By less than a tenth in some of 40 draws, so that it is within the band of 95 %.
    assert np.sum(away < 0.1) >= 2
