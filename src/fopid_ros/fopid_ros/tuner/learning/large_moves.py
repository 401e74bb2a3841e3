"""What large moves ask of a controller whose actuator may be slow, which small ones do not show."""

from __future__ import annotations

from fopid_core.design.flaw_trial import FlawTrial
from fopid_core.design.identification.identify import IdentificationResult
from fopid_core.design.specification import TuningResult
from fopid_core.model.loop import Loop
from fopid_core.runtime.settings import Pace
from fopid_ros.tuner.learning.loop_baseline import LoopBaseline


def needed_pace(
    slow: IdentificationResult, tuning: TuningResult, rest: LoopBaseline, held: Pace
) -> tuple[Pace | None, str]:
    """The pace that gains have to be held to, and what speaks against them even then, if anything.

    Where nothing does without one, a ramp of the setpoint that is far better than none.

    Parameters
    ----------
    slow : IdentificationResult
        Of the process behind the slowest actuator that cannot be excluded.
    tuning : TuningResult
        The gains.
    rest : LoopBaseline
        With those from before.
    held : Pace
        That the controller is held to now.
    """
    if slow.best is None or tuning.controller is None:
        return None, ""
    process, now = slow.best.process, rest.controller
    before = Loop(process, now.gains, filter=now.filter, weights=now.weights)
    room = now.room(rest.control)
    trial = FlawTrial(
        process, slow.flaws, now.sample_time, rest.noise, before, room, now.pace, now.antiwindup, large_only=True
    )
    new = Loop(process, tuning.controller, filter=tuning.filter, weights=tuning.weights)
    ramp = trial.ramp(new) & held if held == now.pace else held
    if not (trial.refusal(new, held) and trial.refusal(new, ramp)):
        return (ramp if ramp != held else None), ""
    pace = trial.pace(new) & held
    return pace, trial.refusal(new, pace)
