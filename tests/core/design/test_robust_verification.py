"""A design on a learnt process holds on all that the record leaves possible, or is not handed out."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from fopid_core.design import robust_verification
from fopid_core.design.identification.identify import IdentificationResult, identify
from fopid_core.design.identification.record import Record
from fopid_core.design.robust_verification import (
    RobustLimits,
    plausible_processes,
    robustness,
    tune_robustly,
)
from fopid_core.design.specification import TuningRequest, TuningResult
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import Process, read_process
from fopid_core.model.stability import Stability, stability
from fopid_core.model.two_degrees import NO_FILTER
from fopid_core.runtime.simulation import Signal

from .identification.recorded import closed_loop, step_record

LIMITS = RobustLimits(samples=20)


@pytest.fixture(scope="module")
def learnt() -> IdentificationResult:
    return identify(step_record("P1", 20.0, 0.02, noise=0.02))


def test_a_good_record_is_tuned_and_verified(learnt: IdentificationResult) -> None:
    found = tune_robustly(learnt, limits=LIMITS)
    assert found.success
    assert found.tuning is not None
    assert found.robustness is not None
    assert found.robustness.stable == found.robustness.count > LIMITS.samples
    assert found.robustness.ms <= LIMITS.ms_max
    assert found.robustness.phase_margin >= LIMITS.phase_margin_min
    assert "stable on all" in found.message


@pytest.mark.parametrize("method", ["frequency", "time", "rule"])
def test_every_method_of_tuning_can_be_asked_for(learnt: IdentificationResult, method: str) -> None:
    request = TuningRequest(read_process("P4"), method=method, rule="simc-pi" if method == "rule" else None)
    found = tune_robustly(learnt, request, LIMITS)
    assert found.tuning is not None
    assert found.tuning.method == method


def noisy_days(
    process: str, setpoint: Signal, samples: int, gains: Fopid, noise: float, load: float, seed: int
) -> Record:
    """A loop sampled each 2 s, with a load that forgets within a minute."""
    draw, loads, keeps = np.random.default_rng(seed), [0.0], math.exp(-2.0 / 60.0)
    for kick in load * math.sqrt(1.0 - keeps**2) * draw.standard_normal(samples):
        loads.append(keeps * loads[-1] + kick)
    return closed_loop(process, setpoint, samples, 2.0, gains, noise, seed, lambda k: loads[k])


def test_in_noise_the_models_of_other_templates_count_as_possible_as_well() -> None:
    """A dead time of 40 s, learnt as one of 70 +- 3 s before a lag of another order."""
    steps = lambda t: 1.0 * (280.0 <= t < 560.0) + 0.3 * (t >= 560.0)  # noqa: E731
    found = identify(noisy_days("0.5/(8s+1)*exp(-40s)", steps, 420, Fopid(0.3, 0.01), 0.25, 0.3, 2))
    assert found.best is not None
    assert found.best.fit_pct < 80.0
    assert found.best.process.delay > 60.0
    assert min(process.delay for process in plausible_processes(found, LIMITS, 2.0)) < 45.0


@pytest.mark.slow
def test_they_do_so_where_that_noise_was_made_white_for_the_best_of_them_alone() -> None:
    """A dead time of 54 s, learnt as four lags and 0 to 12 s: gains for that ran away."""
    steps = lambda t: 3.2 * (670.0 <= t < 2000.0) + 1.0 * (t >= 2000.0)  # noqa: E731
    found = identify(noisy_days("1.6/(20s+1)*exp(-54s)", steps, 1300, Fopid(0.2, 0.004), 0.3, 0.25, 1))
    assert found.best is not None
    assert found.best.in_coloured_noise
    assert found.best.process.delay < 20.0
    assert max(process.delay for process in plausible_processes(found, LIMITS, 2.0)) > 45.0


@pytest.mark.slow
def test_a_crossover_that_is_too_much_for_the_limits_is_lowered(learnt: IdentificationResult) -> None:
    eager = TuningRequest(read_process("P1"), phase_margin=math.radians(60.0), crossover=1.3)
    strict = RobustLimits(ms_max=1.6, phase_margin_min=math.radians(35.0), samples=20)
    found = tune_robustly(learnt, eager, strict)
    assert found.success
    assert found.attempts > 1
    assert found.tuning is not None
    assert found.tuning.achieved is not None
    assert found.tuning.achieved.crossover < 1.0


@pytest.mark.slow
def test_a_design_that_is_refused_gives_way_to_a_more_cautious_one(learnt: IdentificationResult) -> None:
    eager = TuningRequest(read_process("P1"), phase_margin=math.radians(60.0), crossover=1.0)

    def too_fast(tuning: TuningResult) -> str:
        return "too fast" if tuning.achieved is None or tuning.achieved.crossover > 0.6 else ""

    found = tune_robustly(learnt, eager, LIMITS, refuse=too_fast)
    assert found.success, found.message
    assert found.tuning is not None
    assert found.tuning.achieved is not None
    assert 0.4 < found.tuning.achieved.crossover < 0.6
    never = tune_robustly(learnt, eager, LIMITS, refuse=lambda _: "never")
    assert (never.success, never.message, never.attempts) == (False, "never", 5)


@pytest.mark.slow
@pytest.mark.parametrize(("most", "low", "high"), [(1.55, 1.45, 1.55), (1.45, 1.35, 1.45)])
def test_a_search_in_time_goes_halfway_back_to_what_failed(
    learnt: IdentificationResult, most: float, low: float, high: float
) -> None:
    """The first has 1.83; 0.7 and 0.5 of what that has above 1 are 1.58 and 1.42, halfway is 1.5."""
    eager = TuningRequest(read_process("P1"), "time", structure="pi", index="iae", ms_max=2.0)

    def ring(tuning: TuningResult) -> str:
        return "it rings" if tuning.achieved is None or tuning.achieved.ms > most else ""

    found = tune_robustly(learnt, eager, LIMITS, refuse=ring)
    assert found.success, found.message
    assert found.attempts == 4
    assert found.tuning is not None
    assert found.tuning.achieved is not None
    assert low < found.tuning.achieved.ms < high


def test_limits_that_no_design_meets_are_refused_with_the_worst(learnt: IdentificationResult) -> None:
    found = tune_robustly(learnt, limits=RobustLimits(ms_max=1.01, samples=5))
    assert not found.success
    assert found.attempts == 5
    assert "worst max |S|" in found.message


def test_an_identification_that_was_refused_is_not_tuned() -> None:
    refused = identify(step_record("P1", 1.0, 0.01, noise=0.005))
    found = tune_robustly(refused)
    assert not found.success
    assert (found.tuning, found.message) == (None, refused.message)


def test_the_worst_is_what_the_textbook_says() -> None:
    """k / (s+1)^3 with kp = 1: unstable from k = 8 on, and max |S| grows with k."""
    family = [Process.parse(f"{k}/(s+1)^3") for k in (1, 4, 2)]
    found = robustness(Fopid(kp=1.0), family, RobustLimits(ms_max=10.0, phase_margin_min=0.1))
    w = np.logspace(-2, 2, 200_001)
    peak = np.abs(1.0 / (1.0 + 4.0 / (1j * w + 1.0) ** 3)).max()
    assert (found.met, found.stable, found.worst) == (True, 3, family[1])
    assert found.ms == pytest.approx(peak, rel=1e-6)
    unstable = robustness(Fopid(kp=1.0), [*family, Process.parse("9/(s+1)^3")], RobustLimits())
    assert (unstable.met, unstable.stable) == (False, 3)
    assert "unstable on 1 of 4" in str(unstable)


def test_the_hold_of_the_controller_delays_by_half_its_sample_time(learnt: IdentificationResult) -> None:
    assert learnt.best is not None
    s = 0.5j
    held = complex(plausible_processes(learnt, LIMITS, hold=0.1)[0](s)) / complex(learnt.best.process(s))
    assert np.angle(held) == pytest.approx(-0.5 * 0.5 * 0.1, rel=1e-3)


@pytest.mark.parametrize("wrong", [{"ms_max": 1.0}, {"phase_margin_min": 4.0}, {"samples": 0}])
def test_limits_that_make_no_sense_are_named(wrong: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(wrong))):
        RobustLimits(**wrong)  # type: ignore[arg-type]


def test_a_margin_that_is_not_known_is_not_met(monkeypatch: pytest.MonkeyPatch) -> None:
    """The largest and the smallest of numbers pass over NaN, where it does not come first."""
    pair = [Process.parse("1/(s+1)^3"), Process.parse("1.1/(s+1)^3")]
    controller, limits = Fopid(kp=1.0), RobustLimits()
    known = [margins(Loop(process, controller)) for process in pair]
    assert robustness(controller, pair, limits).met
    for unknown in ({"ms": math.nan}, {"phase_margin": math.nan}):
        for k in range(2):
            found = iter([replace(one, **unknown) if k == n else one for n, one in enumerate(known)])
            monkeypatch.setattr(robust_verification, "margins", lambda _, found=found: next(found))
            judged = robustness(controller, pair, limits)
            assert not judged.met
            assert judged.worst == pair[k] or "ms" not in unknown


def test_a_design_that_rings_as_it_runs_gives_way_to_a_slower_one() -> None:
    learnt = identify(step_record("2/(10s+1)", 100.0, 1.0, noise=0.001), "foptd")
    request = TuningRequest("P1", "frequency", crossover=0.02, sample_time=1.0)
    found = tune_robustly(learnt, request, RobustLimits(samples=5))
    assert found.success, found.message
    assert found.attempts == 3
    assert found.tuning is not None
    assert found.tuning.running is not None
    assert found.tuning.running.ms < 2.2, "the first design's is 4.69"


def test_a_design_that_is_not_known_to_hold_another_template_as_it_runs_is_refused(
    learnt: IdentificationResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that answers at once, of which the sampled loop is not known."""
    assert tune_robustly(learnt, limits=LIMITS).success
    at_once = Process.parse("(0.01s+1)/(s+1)")
    monkeypatch.setattr(robust_verification, "_of_other_templates", lambda *_: [at_once])
    found = tune_robustly(learnt, limits=LIMITS)
    assert not found.success
    assert "as it runs, with ticks of" in found.message
    assert "not known: the process answers the control at once" in found.message


def test_the_hold_of_the_control_counts_once() -> None:
    """SIMC's PI for a lag, with half a tick as its delay, takes all that is left away at each tick: S = 1 - 1/z."""
    learnt = identify(step_record("2/(10s+1)", 100.0, 1.0, noise=0.001), "foptd")
    assert learnt.best is not None
    assert learnt.best.process.delay < 0.05
    found = tune_robustly(learnt, TuningRequest("P1", "rule", rule="simc-pi", sample_time=1.0), RobustLimits(samples=5))
    assert found.success, found.message
    assert found.tuning is not None
    assert found.tuning.running is not None
    assert found.tuning.running.ms == pytest.approx(2.0, rel=0.1)


@pytest.mark.slow
def test_what_the_running_gains_would_not_hold_is_not_the_process(
    learnt: IdentificationResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A steady-state gain of the other sign is possible where nobody saw it; no integral action holds that."""
    assert learnt.best is not None
    turned = Process.parse("-0.5/(s+1)")
    monkeypatch.setattr(type(learnt.best), "sample", lambda *_: (learnt.best.process, turned))
    gentle, wild = Fopid(0.2, 0.1), Fopid(-9.0, -9.0)
    assert "unstable on 1 of" in tune_robustly(learnt, limits=LIMITS).message
    found = tune_robustly(learnt, limits=LIMITS, running=(gentle, NO_FILTER))
    assert found.success
    assert "(1 that the gains that run would not hold left out)" in found.message
    refused = tune_robustly(learnt, limits=LIMITS, running=(wild, NO_FILTER))
    assert not refused.success, "gains that would not hold the learnt process itself say nothing"


def test_what_the_running_gains_may_hold_stays_possible(
    learnt: IdentificationResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A loop too close to the border to call is no proof against the process."""
    assert learnt.best is not None
    turned = Process.parse("-0.5/(s+1)")
    monkeypatch.setattr(type(learnt.best), "sample", lambda *_: (learnt.best.process, turned))

    def unsure(loop: Loop) -> Stability:
        verdict = stability(loop)
        return verdict if verdict.stable else replace(verdict, decided=False)

    monkeypatch.setattr(robust_verification, "stability", unsure)
    found = tune_robustly(learnt, limits=LIMITS, running=(Fopid(0.2, 0.1), NO_FILTER))
    assert "left out" not in found.message
    assert not found.success
    assert "unstable on 1 of" in found.message
