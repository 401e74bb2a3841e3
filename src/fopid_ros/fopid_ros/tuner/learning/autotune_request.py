"""What is asked of an autotuning."""

from __future__ import annotations

from dataclasses import dataclass

from fopid_ros.tuner.learning.closed_loop_experiment import ExperimentSettings
from fopid_ros.tuner.learning.gain_update import AcceptanceCriteria, Trial


@dataclass(frozen=True)
class AutotuneRequest:
    """What is asked.

    Attributes
    ----------
    experiment : ExperimentSettings
    template : str
        Of the model.
    criteria : AcceptanceCriteria
        What the new gains must fulfil.
    propose_only : bool
    trial : Trial or None
        Gains to try instead of learning; they have been judged.
    second_round : bool
        Whether all is done once more with the new gains, where the record did not show the process's slow end, or these
        are much livelier.
    """

    experiment: ExperimentSettings
    template: str
    criteria: AcceptanceCriteria
    propose_only: bool
    trial: Trial | None = None
    second_round: bool = True
