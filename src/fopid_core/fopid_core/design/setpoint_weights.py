"""How much of the setpoint the proportional part sees: the least overshoot at hardly more error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fopid_core.errors import InputError
from fopid_core.model.indices import indices, overshoot_pct
from fopid_core.model.loop import Loop
from fopid_core.model.response import step_response
from fopid_core.model.two_degrees import SetpointWeights

HARDLY_MORE = 1.05
"""How many times the least error after a step of the setpoint is hardly more."""
SHARES = np.linspace(1.0, 0.0, 11)
"""Of the weight that was chosen for the least error, which are tried."""
CALM = 2.0
"""An overshoot [%] of which nobody complains."""


def calmest_weights(loop: Loop, horizon: float) -> SetpointWeights:
    """The weights of a loop, or with less of the setpoint in the proportional part where that overshoots less.

    Their integral of the absolute error is at most 1.05 times the least of those tried, over a horizon [s]. Load and
    stability do not know of the weights.

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> from fopid_core.model.process import Process
    >>> loop = Loop(Process.parse("1/(s+1)*exp(-0.2s)"), Fopid(kp=2.5, ki=4.0))
    >>> calmest_weights(loop, 20.0).proportional < 1.0
    True
    """
    tried: list[tuple[float, float, SetpointWeights]] = []
    for share in SHARES.tolist():
        weights = replace(loop.weights, proportional=share * loop.weights.proportional)
        try:
            response = step_response(replace(loop, weights=weights), horizon)
        except InputError:  # near the border of stability it is not known
            return loop.weights
        tried.append((indices(response.time, response.error).iae, overshoot_pct(response.output), weights))
        least = min(error for error, _, _ in tried)
        if tried[-1][1] <= CALM or tried[-1][0] > HARDLY_MORE * least:
            break
    return min((one for one in tried if one[0] <= HARDLY_MORE * least), key=lambda one: one[1])[2]
