"""The files of config/experiments can be read, and the paper's hold the paper's controllers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fopid_core.model.fopid import Fopid
from fopid_core.model.indices import indices
from fopid_core.model.loop import Loop
from fopid_core.model.process import read_process
from fopid_core.model.stability import stability
from fopid_core.study.experiments.experiment import read_experiment
from fopid_core.study.experiments.simulate import simulate_experiment
from fopid_core.study.reproduce.experiments import paper_experiments
from fopid_core.study.reproduce.load_figures import setpoint_then_load

FOLDER = Path(__file__).parents[4] / "config" / "experiments"


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.yaml")), ids=lambda path: path.name)
def test_every_experiment_can_be_read(path: Path) -> None:
    assert read_experiment(path).phases


def test_the_papers_experiments_are_there_and_as_computed() -> None:
    experiments = paper_experiments()
    assert {path.name for path in FOLDER.glob("paper_*.yaml")} == set(experiments)
    assert len(experiments) == 8
    for name, experiment in experiments.items():
        assert read_experiment(FOLDER / name) == experiment
        assert stability(Loop(read_process(experiment.process), Fopid(**experiment.gains))).stable


@pytest.mark.parametrize("name", paper_experiments())
def test_run_in_samples_they_give_the_exact_figures(name: str) -> None:
    experiment = read_experiment(FOLDER / name)
    change = experiment.phases[0].duration
    loop = Loop(read_process(experiment.process), Fopid(**experiment.gains))
    exact = setpoint_then_load(loop, change, sampled=False)
    output = simulate_experiment(experiment, lambda _: None).trace.measurement
    time = experiment.sample_time * np.arange(output.size)
    for begin, end in ((0.0, change), (change, 2.0 * change)):
        figures = []
        for t, y in ((time, output), (exact.time, exact.output)):
            phase = (t >= begin) & (t <= end)
            error = indices(t[phase] - begin, 1.0 - y[phase])
            figures.append((error.iae, error.itae, y[phase].max()))
        # the control held between samples comes half a sample late
        assert figures[0] == pytest.approx(figures[1], rel=0.025)
