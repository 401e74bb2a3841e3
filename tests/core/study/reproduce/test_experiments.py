"""The files of config/experiments can be read, and the paper's hold the paper's controllers."""

from __future__ import annotations

from pathlib import Path

import pytest

from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import read_process
from fopid_core.model.stability import stability
from fopid_core.study.experiment import read_experiment
from fopid_core.study.reproduce.experiments import paper_experiments

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
