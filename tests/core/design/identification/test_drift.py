"""A model is judged by new data, learnt anew where the process has changed, and the loop stays stable meanwhile."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fopid_core.design.identification.drift import drift
from fopid_core.design.identification.identified_model import IdentifiedModel
from fopid_core.design.identification.identify import identify
from fopid_core.design.identification.record import Record
from fopid_core.design.robust_verification import tune_robustly
from fopid_core.design.specification import TuningRequest
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import read_process
from fopid_core.runtime.controller import ControllerSettings, FopidController, with_gains

from .recorded import closed_loop, plant, square_wave

BEFORE, AFTER = "1/((s+1)(0.5s+1))*exp(-0.4s)", "2/((s+1)(0.5s+1))*exp(-0.6s)"
GAINS = Fopid(kp=1.2, ki=0.8, kd=0.3)
STEP = 0.02


def window(process: str, seed: int = 1) -> Record:
    """Forty seconds of normal operation, cut out of the middle."""
    return closed_loop(process, square_wave(2000), 3500, STEP, GAINS, 0.01, seed).part(20.0, 60.0)


@pytest.fixture(scope="module")
def model() -> IdentifiedModel:
    found = identify(window(BEFORE, seed=0)).best
    assert found is not None
    return found


def test_a_model_goes_on_explaining_a_process_that_does_not_change(model: IdentifiedModel) -> None:
    found = drift(model, window(BEFORE))
    assert found.drifted is False
    assert found.error < 1.2 * found.error_before


@pytest.mark.parametrize("process", [AFTER, BEFORE.replace("1/", "2/"), BEFORE.replace("0.4", "0.6")])
def test_a_changed_process_is_noticed_and_learnt_anew(model: IdentifiedModel, process: str) -> None:
    found = drift(model, window(process))
    assert found.drifted
    assert found.proposal is not None
    assert found.proposal.best is not None
    s = 0.8j  # about where the loop works
    assert complex(found.proposal.best.process(s)) == pytest.approx(complex(read_process(process)(s)), rel=0.05)


def test_nothing_is_said_about_a_loop_that_stands(model: IdentifiedModel) -> None:
    found = drift(model, closed_loop(BEFORE, lambda _: 0.0, 2000, STEP, GAINS, 0.01))
    assert found.drifted is None
    assert found.proposal is None


def test_nothing_is_proposed_from_a_window_in_which_the_process_changed(model: IdentifiedModel) -> None:
    one, two = window(BEFORE), window(AFTER)
    half = one.time.size // 2
    control, measurement = (
        np.concatenate([getattr(one, name)[:half], getattr(two, name)[half:]]) for name in ("control", "measurement")
    )
    found = drift(model, Record(one.time, control, measurement))
    assert found.drifted
    assert found.proposal is None


def test_noise_and_load_that_no_model_explains_are_no_drift(model: IdentifiedModel) -> None:
    noisy = closed_loop(BEFORE, square_wave(2000), 3500, STEP, GAINS, 0.03, seed=4).part(20.0, 60.0)
    load = np.cumsum(np.random.default_rng(2).standard_normal(3500)) * 0.01
    disturbed = closed_loop(BEFORE, lambda _: 0.0, 3500, STEP, GAINS, 0.01, 5, lambda k: float(load[k]))
    for record in (noisy, disturbed.part(20.0, 60.0)):
        found = drift(model, record)
        assert not found.drifted
        assert found.proposal is None


def test_a_load_that_came_is_no_drift(model: IdentifiedModel) -> None:
    loaded = closed_loop(BEFORE, square_wave(2000), 6000, STEP, GAINS, 0.01, 7, lambda k: 0.5 * (k > 3500))
    found = drift(model, loaded.part(20.0, 120.0))
    assert found.drifted is False
    assert "beside a load that came" in found.message


def test_an_operating_point_that_moves_slowly_is_no_drift(model: IdentifiedModel) -> None:
    record = window(BEFORE, seed=6)
    assert drift(model, Record(record.time, record.control, record.measurement + 0.01 * record.time)).drifted is False


class Drifting:
    """Two lags behind a gain and a delay that go from 1 and 0.4 s to 2 and 0.6 s between two instants."""

    def __init__(self, begin: float, end: float) -> None:
        self._begin, self._end = begin, end
        self._lags = plant("1/((s+1)(0.5s+1))", STEP, 0.01, seed=1)
        self._controls = [0.0] * round(1.0 / STEP)
        self._ticks = 0

    @property
    def measurement(self) -> float:
        return self._lags.measurement

    def step(self, control: float) -> None:
        share = float(np.clip((self._ticks * STEP - self._begin) / (self._end - self._begin), 0.0, 1.0))
        self._controls.append(control)
        self._lags.step((1.0 + share) * self._controls[-1 - round((0.4 + 0.2 * share) / STEP)])
        self._ticks += 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("end", "crossover"),
    [pytest.param(60.02, 0.5, id="at once, with a careful tuning"), pytest.param(300.0, None, id="slowly")],
)
def test_a_loop_whose_process_drifts_is_retuned_while_it_runs_and_stays_stable(
    end: float, crossover: float | None
) -> None:
    """Every ten seconds the last thirty are looked at."""
    wished = TuningRequest(read_process("P1"), phase_margin=math.radians(60.0), crossover=crossover, sample_time=STEP)
    first, process, retunings = identify(window(BEFORE, seed=0)), Drifting(60.0, end), 0
    known = first.best
    tuned = tune_robustly(first, wished)
    assert tuned.tuning is not None
    assert tuned.tuning.controller is not None
    controller = FopidController(ControllerSettings(tuned.tuning.controller, sample_time=STEP))
    rows = np.empty((round((end + 60.0) / STEP), 4))
    for k in range(len(rows)):
        setpoint = square_wave(2000)(k)
        rows[k] = k * STEP, controller.step(setpoint, process.measurement), process.measurement, setpoint
        process.step(rows[k, 1])
        if k % 500 == 400 and k >= 2000:  # not at a step: a bumpless change would keep its kick
            assert known is not None
            found = drift(known, Record(*rows[k - 1500 : k].T))
            proposed = tune_robustly(found.proposal, wished) if found.proposal else None
            if found.proposal and proposed and proposed.success and proposed.tuning and proposed.tuning.controller:
                known, retunings = found.proposal.best, retunings + 1
                controller.reconfigure(with_gains(controller.settings, proposed.tuning.controller))
    assert retunings
    assert np.abs(rows[:, 2]).max() < 1.6
    assert known is not None
    assert complex(known.process(0.5j)) == pytest.approx(complex(read_process(AFTER)(0.5j)), rel=0.1)
    settled = rows[-300:-50]  # long after the last step
    assert np.sqrt(np.mean((settled[:, 3] - settled[:, 2]) ** 2)) < 0.03
