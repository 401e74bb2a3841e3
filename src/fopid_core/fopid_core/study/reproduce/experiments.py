"""Section 5's comparison as experiments: a step of the setpoint, then one of the load, for both kinds of design."""

from __future__ import annotations

from fopid_core.design.specification import NUMBERS
from fopid_core.study.experiments.experiment import Experiment, Phase
from fopid_core.study.reproduce.facts import PROCESSES, printed_design, printed_tuning
from fopid_core.study.reproduce.load_figures import LOAD_AT

KINDS = ("frequency", "time")
SAMPLE_TIME = {("P4", "time"): 0.001}
"""Where 10 ms is too slow [s]: that loop rises in 0.6 s but turns in 0.03 s."""


def paper_experiment(process: str, kind: str) -> Experiment:
    """The experiment for a process and a kind of design, ``frequency`` or ``time``.

    Examples
    --------
    >>> paper_experiment("P1", "time").gains["kp"]
    6.5139
    """
    controller = printed_design(process).controller if kind == "frequency" else printed_tuning(process).controller
    return Experiment(
        process=process,
        name=f"paper-{process}-{kind}",
        sample_time=SAMPLE_TIME.get((process, kind), 0.01),
        gains=dict(zip(NUMBERS, controller.gains, strict=True)),
        phases=(
            Phase("setpoint step", LOAD_AT[process], setpoint=1.0, disturbance=0.0),
            Phase("load step", LOAD_AT[process], disturbance=1.0),
        ),
    )


def paper_experiments() -> dict[str, Experiment]:
    """All eight, by the names of their files.

    Examples
    --------
    >>> next(iter(paper_experiments()))
    'paper_P1_frequency.yaml'
    """
    return {f"paper_{process}_{kind}.yaml": paper_experiment(process, kind) for process in PROCESSES for kind in KINDS}
