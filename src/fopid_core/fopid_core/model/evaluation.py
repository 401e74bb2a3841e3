"""Everything that is asked about one loop, in one answer."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from fopid_core.errors import InputError, UnknownResponseError
from fopid_core.model.arrays import Booleans, Floats
from fopid_core.model.gruenwald import gl1_response
from fopid_core.model.indices import (
    INDEX_NAMES,
    Indices,
    indices,
    overshoot_pct,
    rise_time,
    rise_time_to_100,
    settling_time,
    total_variation,
)
from fopid_core.model.loop import Loop
from fopid_core.model.margins import Margins, margins
from fopid_core.model.response import HORIZON_RANGE, Response, step_response
from fopid_core.model.response_indices import response_indices
from fopid_core.model.stability import Stability, stability
from fopid_core.model.winding import right_half_plane_zeros

Method = Literal["exact", "gl1"]

PAPER_STEP = 0.01
"""Sample time [s] of the paper's tables."""

_SETTLED = 0.1  # below the frequency where S has left its steady state by this, little happens
_MOVED = 0.3  # the process's own frequency is where it has left its steady state by this, relatively
_LONGEST = 100.0  # times its own the process is slow at most: a power of s near 0 never settles
_SLOW_TIMES = 5.0
_DELAYS = 10.0
_SHARES = (1.0, 0.4, 0.2, 0.1)  # of the horizon, which are tried where the response takes too much


@dataclass(frozen=True)
class StepMeasures:
    """What a step of the setpoint shows.

    Attributes
    ----------
    indices, indices_accuracy : Indices
        Over the horizon, and the estimated largest error of each; NaN where an index is not known.
    overshoot_pct : float
        Per cent of the setpoint.
    rise_time, rise_time_to_100, settling_time : float
        10 to 90 %, first crossing of the setpoint (the paper's), into 2 % [s]; NaN when it does not happen.
    control_peak, control_variation : float
        Largest absolute value and total variation of the control; infinite with an ideal derivative.
    accuracy : float
        Estimated largest error of the output.
    """

    indices: Indices
    indices_accuracy: Indices
    overshoot_pct: float
    rise_time: float
    rise_time_to_100: float
    settling_time: float
    control_peak: float
    control_variation: float
    accuracy: float

    @staticmethod
    def of(response: Response) -> StepMeasures:
        """The measures of a response to a unit step of the setpoint."""
        time, output = response.time, response.output
        if response.uncertainty.size:
            found, doubts = response_indices(time, response.error, response.uncertainty)
        else:  # sampled as in the paper, and summed up as there
            found, doubts = indices(time, response.error), Indices(*[math.nan] * len(INDEX_NAMES))
        return StepMeasures(
            indices=found,
            indices_accuracy=doubts,
            overshoot_pct=overshoot_pct(output),
            rise_time=rise_time(time, output),
            rise_time_to_100=rise_time_to_100(time, output),
            settling_time=settling_time(time, output),
            control_peak=response.control_peak,
            control_variation=math.inf if response.control_impulse else total_variation(response.control),
            accuracy=response.accuracy,
        )


@dataclass(frozen=True)
class Evaluation:
    """A loop, judged.

    Attributes
    ----------
    stability : Stability
    margins : Margins
    horizon : float
        Of the step [s].
    step : StepMeasures or None
        None for a loop that is not stable: its error does not die out and no index exists; and where the response is
        not known.
    step_reason : str
        Why there is no step; empty where there is one.
    steady_state_error : float
        What is left of the error after a unit step in the end; where it is not 0 the indices grow with the horizon.
    """

    stability: Stability
    margins: Margins
    horizon: float
    step: StepMeasures | None
    steady_state_error: float
    step_reason: str = ""


def evaluate(
    loop: Loop, horizon: float | None = None, method: Method = "exact", sample_time: float = PAPER_STEP
) -> Evaluation:
    """Judge a loop.

    Parameters
    ----------
    loop : Loop
    horizon : float, optional
        Of the step [s]; ``default_horizon`` when not given.
    method : {"exact", "gl1"}
        Exact, or first-order Gruenwald-Letnikov at ``sample_time`` as in the paper.
    sample_time : float
        For ``gl1`` [s].

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> from fopid_core.model.process import read_process
    >>> judged = evaluate(Loop(read_process("P1"), Fopid(1.0, 0.4, 0.5)), horizon=30.0)
    >>> judged.stability.stable, judged.steady_state_error
    (True, 0.0)
    """
    if method not in ("exact", "gl1"):
        raise InputError(f"method = {method!r}; allowed: exact, gl1")
    respond = step_response if method == "exact" else partial(gl1_response, step=sample_time)
    verdict = stability(loop)
    measures, reason = None, "" if verdict.stable else verdict.reason
    if verdict.stable:
        try:
            response = respond(loop, horizon) if horizon is not None else on_default_horizon(loop, respond)
            measures, horizon = StepMeasures.of(response), horizon or float(response.time[-1])
        except UnknownResponseError as unknown:
            reason = str(unknown)
    final = _steady_state_error(loop) if verdict.stable else math.nan
    horizon = default_horizon(loop) if horizon is None else horizon
    return Evaluation(verdict, margins(loop), horizon, measures, final, reason)


def on_default_horizon(loop: Loop, respond: Callable[[Loop, float], Response]) -> Response:
    """A response up to ``default_horizon``, or to a part of that up to which it can be had."""
    whole = default_horizon(loop)
    for share in _SHARES[:-1]:
        try:
            return respond(loop, share * whole)
        except UnknownResponseError:
            continue
    return respond(loop, _SHARES[-1] * whole)


def default_horizon(loop: Loop) -> float:
    """A horizon [s] on which the loop settles: some times its slowest time, rounded up to 1, 2 or 5 and zeros.

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> from fopid_core.model.process import read_process
    >>> default_horizon(Loop(read_process("P1"), Fopid(1.0, 0.4, 0.5)))
    100.0
    """
    w = np.exp(right_half_plane_zeros(loop.characteristic).log_frequency)
    sensitivity = loop.sensitivity(1j * w)
    slow = _first(w, np.abs(sensitivity - sensitivity[0]) > _SETTLED)
    gain = loop.process.steady_state_gain
    if gain == 0.0:
        own = float(w[np.argmax(np.abs(loop.process(1j * w)))])
    elif math.isfinite(gain):
        own = _first(w, np.abs(loop.process(1j * w) - gain) > _MOVED * abs(gain))  # at a pole it is no number
    else:
        own = _first(w, np.abs(loop(1j * w)) < 1.0 / _SETTLED)
    slow = min(max(slow, own / _LONGEST), own)
    wished = min(_SLOW_TIMES / slow + _DELAYS * loop.process.delay, HORIZON_RANGE[1])
    decade = 10.0 ** math.floor(math.log10(wished))
    return float(next(n * decade for n in (1, 2, 5, 10) if n * decade >= wished))


def _first(w: Floats, happens: Booleans) -> float:
    """The first frequency at which it happens, or one in the middle where it never does."""
    return float(w[np.argmax(happens)] if happens.any() else w[w.size // 2])


def _steady_state_error(loop: Loop) -> float:
    """S(0), the final value of the error after a unit step."""
    opened, closed = loop.open_loop_denominator, loop.characteristic
    if opened.lowest_order > closed.lowest_order:
        return 0.0
    return opened.sum_of_order(0.0) / closed.sum_of_order(0.0)
