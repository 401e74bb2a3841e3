"""What a design must fulfil before it is handed to a running controller."""

from __future__ import annotations

import math

from fopid_core.design.specification import TuningResult

MS_MAX = 4.0
"""Gains with a larger max |S| are not applied: ``verify.ms_max`` of the tuner's node."""

DELAY_MARGIN_TICKS = 2.0
"""Gains with a delay margin of fewer ticks are not applied: ``verify.ticks`` of the tuner's node."""


def rejection_reason(
    result: TuningResult, sample_time: float, ms_max: float = MS_MAX, ticks: float = DELAY_MARGIN_TICKS
) -> str:
    """Why a design is not applied; empty when it may be.

    Parameters
    ----------
    result : TuningResult
    sample_time : float
        Tick of the controller [s]. A held control is half a tick late, and its messages up to another.
    ms_max : float
        Largest max |S|.
    ticks : float
        Least delay margin, in ticks.
    """
    if result.controller is None or not result.stable:
        return "not applied: no stable design"
    if not result.success:
        return "not applied: the specification is not met"
    # Each bound is asked to hold: what is not known (NaN) does not.
    if result.achieved is None or not result.achieved.ms <= ms_max:
        ms = math.nan if result.achieved is None else result.achieved.ms
        return f"not applied: Ms = {ms:.3g} is above verify.ms_max = {ms_max:g}"
    least = ticks * sample_time
    if not result.achieved.delay_margin >= least:
        too_small = f"delay margin {result.achieved.delay_margin:.3g} s is below {least:.3g} s (verify.ticks)"
        return f"not applied: {too_small}; the loop may be unstable as it runs"
    if result.running is None or not result.running.stable:
        why = "not looked at" if result.running is None else result.running.reason
        return f"not applied: the loop as it runs, with ticks of {sample_time:g} s, is not known to be stable: {why}"
    if not result.running.ms <= ms_max:
        return f"not applied: Ms = {result.running.ms:.3g} of the loop as it runs is above verify.ms_max = {ms_max:g}"
    return ""
