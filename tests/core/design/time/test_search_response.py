"""The fast responses of a search are those of the loop, for all that a search compares."""

from __future__ import annotations

import numpy as np
import pytest

from fopid_core.data import paper_tables
from fopid_core.design.time.objectives import LoopResponses, Objective
from fopid_core.design.time.search_response import ResponseGrid
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process, read_process
from fopid_core.model.response import step_response

GAINS = ("kp", "ki", "kd", "lam", "mu")
ROWS = [row for row in paper_tables()["table4_to_7"] if row["process"] != "P4"]


def index_of(grid: ResponseGrid, gains: np.ndarray, name: str) -> float:
    objective = Objective.of(name, {})
    responses = LoopResponses(grid.time, grid.errors(gains), None, np.ones(1), np.ones((1, 1), dtype=complex))
    return float(objective.cost(responses, objective.time_weights(grid.time))[0])


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row['process']} {row['index']}")
def test_the_papers_indices_are_right_to_a_thousandth(row: dict[str, float | str]) -> None:
    """Against figures computed elsewhere and carried over as data."""
    gains = np.array([[float(row[name]) for name in GAINS]])
    grid = ResponseGrid(read_process(str(row["process"])), 50.0, 1024, speed=1.0)
    exact = row["exact"]["J"]  # type: ignore[index]
    assert index_of(grid, gains, str(row["index"]).lower()) == pytest.approx(exact, rel=1.5e-3)


@pytest.mark.parametrize(
    ("text", "gains", "horizon"),
    [
        ("1/(s+1)^3", (3.0, 1.0, 1.0, 0.9, 0.6), 40.0),
        ("2/(3s+1)*exp(-s)", (0.7, 0.2, 0.2, 1.1, 0.5), 60.0),
        ("(1-s)/(s+1)^3", (0.6, 0.2, 0.2, 1.0, 0.9), 60.0),
        ("1/(0.8s^2.2+0.5s^0.9+1)", (1.0, 1.0, 1.0, 1.1, 0.8), 30.0),
        ("1/(s(s+1))", (1.0, 0.1, 0.5, 0.9, 0.7), 60.0),
        ("1/((s-1)(0.1s+1))", (6.0, 3.0, 0.5, 0.9, 0.7), 20.0),
        ("-2/(s+1)^2", (-1.0, -0.5, -0.2, 1.0, 0.5), 30.0),
    ],
)
def test_errors_and_controls_are_those_of_the_accurate_response(
    text: str, gains: tuple[float, ...], horizon: float
) -> None:
    process = Process.parse(text)
    exact = step_response(Loop(process, Fopid(*gains)), horizon, points=1025)
    grid = ResponseGrid(process, horizon, 1024, speed=1.0)
    row = np.array([gains])
    # An index sees the difference on the whole: at a kink right after the delay it is larger for a few instants.
    difference = np.abs(grid.errors(row)[0] - exact.error)
    assert difference.mean() < 1e-3 * np.abs(exact.error).mean()
    assert difference.max() < 1e-2
    later = slice(20, None)  # the first instants of the control are smoothed
    scale = np.abs(exact.control[later]).max()
    assert np.abs(grid.controls(row)[0] - exact.control)[later].max() < 1e-2 * max(scale, 1.0)


def test_a_batch_gives_what_each_gives_alone() -> None:
    grid = ResponseGrid(read_process("P2"), 20.0, 256, speed=2.0)
    rng = np.random.default_rng(1)
    rows = rng.uniform([0.1, 0.1, 0.0, 0.5, 0.1], [1.0, 1.0, 0.5, 1.5, 1.5], size=(20, 5))
    together = grid.errors(rows)
    assert np.allclose(together, np.concatenate([grid.errors(row[None]) for row in rows]), atol=1e-12)
