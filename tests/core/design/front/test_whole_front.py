"""The trade-off beside what others find: NSGA-II of pymoo in 120,000 evaluations or more, the methods compared."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fopid_core.design.comparison.compare import compare, comparison_request
from fopid_core.design.front.front import Front, front
from fopid_core.design.specification import STRUCTURES
from fopid_core.model.process import read_process

from .hypervolume import hypervolume

pytestmark = pytest.mark.slow
IAE = {"P1": 3.5, "P2": 2.0, "P3": 6.0, "P4": 1.3}
"""Largest that counts; beside each process kp, ki, kd, filter time, IAE, Ms, noise gain of 200 designs in
``by_pymoo_*.csv``, made by tools/front_by_pymoo.py."""
BEYOND = 1e-3


@pytest.fixture(scope="module")
def pid() -> Front:
    return front(read_process("P1"), "pid")


@pytest.mark.parametrize("name", list(IAE))
def test_it_dominates_as_much_as_a_long_evolution_and_none_of_that_beats_it(name: str) -> None:
    found = front(read_process(name), "pid").objectives
    evolved = np.loadtxt(Path(__file__).with_name(f"by_pymoo_{name}.csv"), delimiter=",", skiprows=1)[:, 4:]
    assert len(found) == len(evolved) == 200
    reference = 1.002 * np.array([IAE[name], 2.0, 20.0])
    for scaled in (np.asarray, np.log):
        volume = hypervolume(scaled(found), scaled(reference))
        assert volume >= 0.99 * hypervolume(scaled(evolved), scaled(reference))
    assert not beaten_by(evolved, found).any()


@pytest.mark.timeout(900)
def test_no_design_of_the_comparison_is_beyond_it(pid: Front) -> None:
    process = read_process("P1")
    rows = [row for row in compare(comparison_request(process)).rows if row.stable]
    objectives = np.array([[row.iae_load, row.ms, row.noise_gain] for row in rows])
    for found in (pid, front(process, "fopid")):
        simpler = [found.structure == "fopid" or row.candidate.structure in ("pi", "pid") for row in rows]
        others = objectives[simpler]
        assert len(others) >= 5
        assert not beaten_by(others, found.objectives).any()
        # The least IAE under exactly what a design does.
        for _, ms, noise in others[(others[:, 1] > 1.3) & (others[:, 1] < 2.0) & (others[:, 2] < 20.0)][:4]:
            corner = front(process, found.structure, 8, 1.2, ms * (1 + 1e-6), noise * (1 + 1e-6))
            least = others[(others[:, 1] <= ms) & (others[:, 2] <= noise), 0].min()
            assert corner.iae_load.min() <= least * (1.0 + BEYOND)


@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", ["P2", "P3", "P4"])
def test_nor_is_one_of_any_other_process(name: str) -> None:
    process = read_process(name)
    rows = [row for row in compare(comparison_request(process)).rows if row.stable]
    for structure, contained in (("pid", ("pi", "pid")), ("fopid", tuple(STRUCTURES))):
        others = [(row.iae_load, row.ms, row.noise_gain) for row in rows if row.candidate.structure in contained]
        assert len(others) >= 5
        assert not beaten_by(np.array(others), front(process, structure).objectives).any()


def beaten_by(others: np.ndarray, designs: np.ndarray) -> np.ndarray:
    """Which designs another one beats in everything by more than a tenth of a per cent."""
    return (others[:, None] <= (1.0 - BEYOND) * designs[None]).all(axis=2).any(axis=0)
