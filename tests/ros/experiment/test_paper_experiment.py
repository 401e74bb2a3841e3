"""One of the paper's experiments through real nodes in lockstep gives the offline figures."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from fopid_core.model.fopid import Fopid
from fopid_core.model.indices import indices, overshoot_pct
from fopid_core.model.loop import Loop
from fopid_core.model.process import read_process
from fopid_core.model.response import step_response
from fopid_core.runtime.controller import ControllerSettings, FopidController
from fopid_core.runtime.plant import Plant, PlantSettings
from fopid_core.runtime.simulation import Trace, simulate
from fopid_core.study.bags.bag import read_bag
from fopid_core.study.experiments.experiment import Experiment, read_experiment
from fopid_core.study.reports.segments import segments
from fopid_core.study.reproduce.load_figures import setpoint_then_load

from ..conftest import BIN, Graph

FILE = Path(__file__).parents[3] / "config" / "experiments" / "paper_P2_time.yaml"


def offline(experiment: Experiment) -> Trace:
    h, (step, load) = experiment.sample_time, experiment.phases
    controller = FopidController(ControllerSettings(Fopid(**experiment.gains), sample_time=h))
    plant = Plant(PlantSettings(read_process(experiment.process), sample_time=h))
    change = round(step.duration / h)
    samples = change + round(load.duration / h)
    return simulate(controller, plant, samples, lambda _: 1.0, lambda k: 1.0 if k >= change else 0.0)


@pytest.mark.slow
def test_the_nodes_give_the_offline_figures(graph: Graph, tmp_path: Path) -> None:
    experiment = read_experiment(FILE)
    common = {"trigger": "lockstep", "sample_time": experiment.sample_time}
    graph.start("plant_simulator", {**common, "process": experiment.process, "advance_until": 0.0})
    graph.start("fopid_controller", {**common, **experiment.gains})
    out = tmp_path / "run"
    ended = subprocess.run([BIN / "experiment", FILE, "--out", out, "--no-report"], env=graph.environment,
                           capture_output=True, text=True, timeout=250, check=False)  # fmt: skip
    assert ended.returncode == 0, ended.stderr + graph.logs()

    run, expected = read_bag(out / "bag"), offline(experiment)
    assert list(run.signals["measurement"].value) == list(expected.measurement)
    assert list(run.signals["control"].value) == list(expected.control)

    step, load = segments(run)
    loop = Loop(read_process(experiment.process), Fopid(**experiment.gains))
    exact = step_response(loop, experiment.phases[0].duration)
    by_exact = indices(exact.time, exact.error)
    # Holding the control for 10 ms delays it by 5 ms; at the crossover of 3.5 rad/s that turns the loop by 1 degree.
    assert step.overshoot_pct == pytest.approx(overshoot_pct(exact.output), abs=0.5)
    assert step.iae == pytest.approx(by_exact.iae, rel=0.02)
    assert step.itae == pytest.approx(by_exact.itae, rel=0.02)
    whole = setpoint_then_load(loop, experiment.phases[0].duration, sampled=False)
    late = whole.time >= experiment.phases[0].duration  # what is left of the setpoint's answer is there, too
    assert load.iae == pytest.approx(indices(whole.time[late], 1.0 - whole.output[late]).iae, rel=0.02)
    assert load.error_peak == pytest.approx(np.abs(1.0 - whole.output[late]).max(), rel=0.02)
