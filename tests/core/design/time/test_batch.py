"""On the test batch of Astrom and Hagglund the optimum does not depend on luck, and no restriction beats it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fopid_core.design.tuner import TuningRequest, TuningResult, tune
from fopid_core.model.process import Process

from ....share import some_of
from .batch_campaign import BATCH, RESTRICTIONS, evolved, faults, keys, read, request, summary

SAMPLE = ["P1 T=1.3", "P3 T=0.2", "P4 n=5", "P6 T1=0.7 L1=0.3", "P7 T=5 T1=0.7 L1=0.3", "P8 a=0.8", "P9 T=0.5"]


def tuned(name: str, index: str, ms_max: float, **options: object) -> TuningResult:
    return tune(request(name, index, ms_max, **options))


def test_the_batch_is_that_of_the_paper() -> None:
    """Nine families of 21, 21, 10, 6, 9, 10, 36, 11 and 10 processes."""
    families = [name.split()[0] for name in BATCH]
    assert [families.count(f"P{i}") for i in range(1, 10)] == [21, 21, 10, 6, 9, 10, 36, 11, 10]
    assert len({str(Process.parse(text)) for text in BATCH.values()}) >= 130


@pytest.mark.slow
def test_an_integrating_process_with_delay_is_tuned_alike_by_every_seed() -> None:
    """It was 5.30, 1.615 and 5.31 by seed, and 1.88 with ki fixed to 0 (the running kick was not counted then)."""
    costs = [tuned("P6 T1=0.7 L1=0.3", "itae", 1.6, seed=seed).cost for seed in (0, 1, 2)]
    assert max(costs) <= 1.005 * min(costs)
    assert max(costs) <= 1.68


@pytest.mark.slow
def test_by_default_a_load_of_it_fades_which_no_seed_does_better() -> None:
    process = Process.parse(BATCH["P6 T1=0.7 L1=0.3"])
    asked = [TuningRequest(process, method="time", index="itae", ms_max=1.6, seed=seed) for seed in (0, 1, 2)]
    results = [tune(each) for each in asked]
    costs = [result.cost for result in results]
    assert max(costs) <= 1.005 * min(costs)
    assert not any("a load fades slowly" in result.message for result in results)
    assert "a load fades slowly" in tuned("P6 T1=0.7 L1=0.3", "itae", 1.6).message


@pytest.mark.slow
def test_numbers_on_the_edge_of_their_range_are_named() -> None:
    result = tuned("P6 T1=0.7 L1=0.3", "itae", 1.6)
    assert [text.split(" = ")[0] for text in result.at_edge] == ["lam"]
    assert "on the edge of its range: lam = 0.05 (range 0.05 to 2)" in result.message


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", some_of(SAMPLE))
def test_neither_a_seed_nor_a_restriction_finds_a_better_optimum(name: str) -> None:
    for index, ms_max in (("itae", 1.6), ("iae", 1.4)):
        whole = [tuned(name, index, ms_max, seed=seed) for seed in (0, 1, 2)]
        assert all(result.success for result in whole), whole[0].unmet
        costs = [result.cost for result in whole]
        assert max(costs) <= 1.005 * min(costs)
        restricted = [tuned(name, index, ms_max, fixed=fixed) for fixed in RESTRICTIONS.values()]
        succeeded = [result.cost for result in restricted if result.success]
        assert succeeded
        assert max(costs) <= min(succeeded) * 1.004


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", some_of(["P4 n=5", "P6 T1=0.7 L1=0.3", "P8 a=0.8"]))
def test_a_long_differential_evolution_finds_nothing_better(name: str) -> None:
    """Within 1 %; the same box, bounds and cost, another search."""
    asked = request(name, "itae", 1.6, horizon=60.0, u_max=50.0)
    assert tune(asked).cost <= 1.01 * evolved(asked, generations=250)


def test_the_campaign_names_what_is_wrong(tmp_path: Path) -> None:
    """One optimum that depends on the seed, one that a restriction beats, one that an evolution beats, one not met."""
    out = tmp_path / "rows.jsonl"
    wrong = {"P4 n=7": ("ki=0", 0.99), "P3 T=10": ("seed 1", 0.994), "P2 T=20": ("evolution", 0.98)}
    rows = []
    for key in keys():
        variant, other = wrong.get(key[0], ("", 1.0))
        cost = other if key[3] == variant else 1.0
        met = key[:4] != ("P9 T=0.5", "iae", 1.4, "seed 2")
        rows.append({"key": key, "cost": cost, "seconds": 1.0, "success": met, "unmet": ["max"], "at_edge": []})
    out.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")
    told = list(faults(read(out)))
    assert len(rows) == 134 * 4 * 8 + 32
    assert [sum(name in text for text in told) for name in (*wrong, "P9 T=0.5")] == [4, 4, 1, 1]
    assert len(told) == 10
    assert f"{134 * 4 * 3} tunings" in summary(read(out))
