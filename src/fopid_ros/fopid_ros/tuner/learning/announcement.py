"""What an autotuning does and how long it takes, as it is told before it begins."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fopid_ros.tuner.learning.autotune import AutotuneRequest
    from fopid_ros.tuner.learning.closed_loop_experiment import ClosedLoopExperiment

TOTAL, UNTIL_KNOWN, UNTIL_PROVED = 2.0, 0.7, 1.9
"""How long it usually takes, in lengths of an experiment: rest and one that is made whole; rest and one that ends when
enough is known; that with gains tried out, a second round and a proof."""
LONGEST, LONGEST_PROVED = 3.0, 8.5
"""No further experiment is begun that would end later than this, in the same lengths; with what follows so many have
been seen, where the loop turned out far slower than its integral time."""
WORKED_OUT = 20.0
"""How long it usually takes to work gains out [s]; that depends on the computer."""


def usual_time(length: float, until_known: bool, proved: bool) -> float:
    """How long all of it usually takes [s].

    Parameters
    ----------
    length : float
        Of a whole experiment [s].
    until_known : bool
        Whether it ends once enough is known.
    proved : bool
        Whether gains are tried out after it, watched and proved.

    Examples
    --------
    >>> usual_time(100.0, until_known=True, proved=True)
    210.0
    """
    lengths = TOTAL if not until_known else UNTIL_PROVED if proved else UNTIL_KNOWN
    return lengths * length + WORKED_OUT


def announcement(length: float, until_known: bool, proved: bool) -> str:
    """The same in words, and how long at most.

    Examples
    --------
    >>> announcement(100.0, until_known=True, proved=False)
    'about 90 s in all (rest, experiments, gains worked out), up to 320 s where they say too little'
    """
    most = (LONGEST_PROVED if proved else LONGEST) * length + WORKED_OUT
    parts = "rest, experiments, gains worked out" + (", watched and proved" if proved else "")
    usual = usual_time(length, until_known, proved)
    longest = f"up to {most:.3g} s " + ("have been seen" if proved else "where they say too little")
    return f"about {usual:.3g} s in all ({parts}), {longest}"


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
        "the method asked for, PI, PID and FOPID in time, and rules"
        if request.criteria.compare
        else f"method {request.criteria.tuning.method}"
        + (", and beside it PI, PID and FOPID in time, and rules" if request.propose_only else "")
    )
    lines = [
        rest, *experiment.plan, "identifying: models are fitted and judged on a part of the record held back",
        f"tuning: by {methods}", "verifying: on every process that the record leaves possible",
    ]  # fmt: skip
    if request.propose_only:
        return [*lines, "nothing is applied: the gains are proposed"], experiment.estimate
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
    return lines, experiment.estimate
