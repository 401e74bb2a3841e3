"""On the test batch of Astrom and Hagglund the optimum does not depend on luck, and no restriction beats it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import differential_evolution

from fopid_core.data import test_batch as published_batch
from fopid_core.design.time.objectives import Objective
from fopid_core.design.time.problem import TimeProblem
from fopid_core.design.time.specification import TimeSpecification
from fopid_core.design.tuner import TuningRequest, TuningResult, tune
from fopid_core.model.process import Process
from fopid_core.model.stability import stable_mask

BATCH = published_batch()
SAMPLE = ["P1 T=1.3", "P3 T=0.2", "P4 n=5", "P6 T1=0.7 L1=0.3", "P7 T=5 T1=0.7 L1=0.3", "P8 a=0.8", "P9 T=0.5"]
RESTRICTIONS = ({"ki": 0.0}, {"kd": 0.0}, {"lam": 1.0, "mu": 1.0}, {"ki": 0.0, "mu": 1.0}, {"kd": 0.0, "lam": 1.0})


def tuned(name: str, index: str, ms_max: float, **options: object) -> TuningResult:
    request = TuningRequest(Process.parse(BATCH[name]), method="time", index=index, ms_max=ms_max, **options)  # type: ignore[arg-type]
    return tune(request)


def test_the_batch_is_that_of_the_paper() -> None:
    """Nine families of 21, 21, 10, 6, 9, 10, 36, 11 and 10 processes."""
    families = [name.split()[0] for name in BATCH]
    assert [families.count(f"P{i}") for i in range(1, 10)] == [21, 21, 10, 6, 9, 10, 36, 11, 10]
    assert len({str(Process.parse(text)) for text in BATCH.values()}) >= 130


def test_an_integrating_process_with_delay_is_tuned_alike_by_every_seed() -> None:
    """It was 5.30, 1.615 and 5.31 by seed, and 1.88 with ki fixed to 0 (the running kick was not counted then)."""
    costs = [tuned("P6 T1=0.7 L1=0.3", "itae", 1.6, seed=seed).cost for seed in (0, 1, 2)]
    assert max(costs) <= 1.005 * min(costs)
    assert max(costs) <= 1.68


def test_numbers_on_the_edge_of_their_range_are_named() -> None:
    result = tuned("P6 T1=0.7 L1=0.3", "itae", 1.6)
    assert [text.split(" = ")[0] for text in result.at_edge] == ["lam"]
    assert "on the edge of its range: lam = 0.05 (range 0.05 to 2)" in result.message


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", SAMPLE)
def test_neither_a_seed_nor_a_restriction_finds_a_better_optimum(name: str) -> None:
    for index, ms_max in (("itae", 1.6), ("iae", 1.4)):
        whole = [tuned(name, index, ms_max, seed=seed) for seed in (0, 1, 2)]
        assert all(result.success for result in whole), whole[0].unmet
        costs = [result.cost for result in whole]
        assert max(costs) <= 1.005 * min(costs)
        for fixed in RESTRICTIONS:
            restricted = tuned(name, index, ms_max, fixed=fixed)
            assert not restricted.success or max(costs) <= restricted.cost * 1.001, fixed


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", ["P4 n=5", "P6 T1=0.7 L1=0.3", "P8 a=0.8"])
def test_a_long_differential_evolution_finds_nothing_better(name: str) -> None:
    """Within 1 %; the same box, bounds and cost, another search."""
    result = tuned(name, "itae", 1.6, horizon=60.0, u_max=50.0)
    assert result.cost <= 1.01 * evolved(Process.parse(BATCH[name]), "itae", 1.6, horizon=60.0, u_max=50.0)


def evolved(process: Process, index: str, ms_max: float, horizon: float, u_max: float, generations: int = 250) -> float:
    """The best cost that differential evolution finds, gains on a logarithmic scale."""
    problem = TimeProblem(process, TimeSpecification(Objective.of(index, {}), horizon, ms_max, u_max), density=60)
    low, high = problem.box.T
    least = 1e-4 * problem.scale[:3]

    def gains(x: np.ndarray) -> np.ndarray:
        size = np.exp(x[:3])
        parts = np.where(size < 2.0 * least[:, None], 0.0, size)
        return np.clip(np.concatenate([parts, x[3:]]).T, low, high)

    def cost(x: np.ndarray) -> np.ndarray:
        rows = gains(x)
        value, slack = problem.cost_and_slack(rows)
        broken = np.minimum(slack.min(axis=1), 0.0)
        allowed = stable_mask(process, rows)
        return np.where(allowed & (broken == 0.0), value, 1e6 * np.where(allowed, 1.0 - broken, 1e3))

    ranges = [*zip(np.log(least), np.log(1e3 * problem.scale[:3]), strict=True), *zip(low[3:], high[3:], strict=True)]
    found = differential_evolution(
        cost, ranges, maxiter=generations, popsize=16, tol=1e-8, seed=0, polish=False, vectorized=True,
        updating="deferred",
    )  # fmt: skip
    return float(found.fun)
