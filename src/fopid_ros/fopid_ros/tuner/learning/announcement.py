"""What an autotuning does and how long it takes, as it is told before it begins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fopid_ros.tuner.learning.autotune_request import AutotuneRequest
    from fopid_ros.tuner.learning.closed_loop_experiment import ClosedLoopExperiment

UNTIL_KNOWN, WHOLE, AFTERWARDS = 0.38, 1.45, 1.35
"""How long it usually takes to move the loop, in lengths of an experiment that is made whole: until enough is known; a
whole one with its probes. And what follows where gains are tried out: watched, a second round, a proof."""
DUE, LEFT = 1.45, 0.8
"""At so many times what is said of it an experiment that ends when enough is known is content with any process that its
record shows: with a tick or two within 1.5. Where the loop came to rest late, not before that share of what was left
for it."""
LONGEST, LONGEST_PROVED = 3.0, 8.5
"""No further experiment is begun that would end later than this, in the same lengths; with what follows so many have
been seen, where the loop turned out far slower than its integral time."""
WORKED_OUT, WORKED_OUT_TWICE = 25.0, 45.0
"""How long it usually takes to work gains out [s], once or with the second round that every other tuning makes; that
depends on the computer."""


@dataclass(frozen=True)
class ExperimentLength:
    """How long an experiment takes, as it is said before it begins.

    Attributes
    ----------
    whole : float
        Of one that is made whole, without what comes before it [s].
    rest : float
        For which it is waited before [s].
    until_known : bool
        Whether it ends once enough is known.
    proved : bool
        Whether gains are tried out after it, watched and proved.

    Examples
    --------
    >>> length = ExperimentLength(whole=100.0, rest=2.0, until_known=True, proved=False)
    >>> length.experiment, length.in_all
    (40.0, 65.0)
    >>> print(length)
    an experiment of about 40 s, about 65 s in all (gains worked out), up to 325 s where it says too little
    """

    whole: float
    rest: float
    until_known: bool
    proved: bool

    @property
    def experiment(self) -> float:
        """Rest, and while the loop is moved [s]."""
        return self.rest + (UNTIL_KNOWN if self.until_known else WHOLE) * self.whole

    @property
    def in_all(self) -> float:
        """With all that follows [s]."""
        return self.experiment + AFTERWARDS * self.whole * self.proved + self.worked_out

    @property
    def worked_out(self) -> float:
        """While gains are worked out [s]."""
        return WORKED_OUT_TWICE if self.proved else WORKED_OUT

    @property
    def due(self) -> float:
        """From rest to where any process is enough [s]."""
        return DUE * self.experiment - self.rest

    def __str__(self) -> str:
        most = (LONGEST_PROVED if self.proved else LONGEST) * self.whole + self.worked_out
        parts = "gains worked out" + (", watched and proved" if self.proved else "")
        longest = f"up to {most:.3g} s " + ("have been seen" if self.proved else "where it says too little")
        return f"an experiment of about {self.experiment:.3g} s, about {self.in_all:.3g} s in all ({parts}), {longest}"


def planned(
    request: AutotuneRequest, experiment: ClosedLoopExperiment, sample_time: float, has_a_second_round: bool
) -> tuple[list[str], float]:
    """A line for each phase, and how long all of it takes [s]."""
    trial = request.trial
    rest = f"measuring: wait until the loop rests, {experiment.rest_window:.3g} s or more"
    if trial is not None:
        watched = trial.watched(sample_time)
        watching = f"watching: for {watched:.3g} s; the gains from before come back if the loop gets worse"
        return [rest, f"applying: {trial.design.gains}, on trial", watching], experiment.rest_window + watched
    methods = (
        "the method asked for, PI, PID and FOPID in the time domain, and rules"
        if request.criteria.compare
        else f"method {request.criteria.tuning.method}"
        + (", and beside it PI, PID and FOPID in the time domain, and rules" if request.propose_only else "")
    )
    lines = [
        rest, *experiment.plan, "identifying: models are fitted and judged on a part of the record held back",
        f"tuning: by {methods}", "verifying: on every process that the record leaves possible",
    ]  # fmt: skip
    if request.propose_only:
        return [*lines, "nothing is applied: the gains are proposed"], experiment.length.in_all
    watching = "watching: for ten response times; the gains from before come back if the loop gets worse"
    proving = (
        "proving: moved once more as far as that, then up to half of what is allowed, and by pulses of the control, as "
        "large as any move, where the actuator may be slow; the gains from before come back if it swings on or hunts, "
        "or would in larger moves"
    )
    lines += ["applying: without a bump, on trial", watching, proving]
    if has_a_second_round:
        where = "where the record does not show the process's slow end, or these are much livelier"
        lines.append(f"all that once more with the new gains, {where}")
    return lines, experiment.length.in_all
