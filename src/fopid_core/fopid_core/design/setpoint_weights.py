"""How much of the setpoint the controller acts on: what overshoots less at little more error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fopid_core.errors import InputError
from fopid_core.model.arrays import Floats
from fopid_core.model.indices import indices, overshoot_pct
from fopid_core.model.loop import Loop
from fopid_core.model.response import step_response
from fopid_core.model.two_degrees import SetpointWeights

DERIVATIVE_PAYS = 1.5
"""How many times the error a step of the setpoint must leave without its derivative, for that to be worth its kick:
what less was promised, limits took on the plants, and the control moved half as much again."""
LITTLE_MORE = 1.1
"""How many times the least error is given for less overshoot: the plant overshoots by more than what is known of it,
since it has limits."""
SHARES = np.linspace(1.0, 0.0, 21)
"""Of the proportional part's weight, which are tried."""
DIGITS = 6
"""Behind the point, of weights: one from a search comes as 0.9999999999999987."""
CALM = 2.0
"""An overshoot [%] of which nobody complains."""


def calmest_weights(loop: Loop, horizon: float) -> SetpointWeights:
    """Weights no larger than those of a loop, and as small as little more error allows.

    That of the derivative is 0 where it does not pay, and the proportional one is made less where the loop would
    overshoot with the whole setpoint. Error is the integral of its absolute value over a horizon [s]. Load and
    stability do not know of the weights.

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> from fopid_core.model.process import Process
    >>> loop = Loop(Process.parse("1/(s+1)*exp(-0.2s)"), Fopid(kp=2.5, ki=4.0))
    >>> calmest_weights(loop, 20.0).proportional < 1.0
    True
    """
    try:
        steps = _Steps(loop, horizon)
        if loop.weights.derivative:
            without = _Steps(replace(loop, weights=replace(loop.weights, derivative=0.0)), horizon)
            if not loop.controller.kd or without.errors.min() <= DERIVATIVE_PAYS * steps.errors.min():
                steps = without
    except InputError:  # near the border of stability it is not known
        return loop.weights
    if steps.overshoot <= CALM:
        return steps.weights(int(np.argmin(steps.errors)))
    return steps.weights(int(np.flatnonzero(steps.errors <= LITTLE_MORE * steps.errors.min())[-1]))


class _Steps:
    """Steps of the setpoint with shares of a loop's weight of the proportional part.

    The output is linear in that weight, so that two responses give all.

    Attributes
    ----------
    errors : ndarray
        One for each of the shares.
    overshoot : float
        With the whole setpoint [%].
    """

    def __init__(self, loop: Loop, horizon: float) -> None:
        self._given = loop.weights
        none, whole = (step_response(replace(loop, weights=replace(loop.weights, proportional=b)), horizon)
                       for b in (0.0, 1.0))  # fmt: skip
        time = np.union1d(none.time, whole.time)
        slowest, fastest = (np.interp(time, one.time, one.output) for one in (none, whole))

        def error(share: float) -> float:
            weight = share * self._given.proportional
            off: Floats = 1.0 - slowest - weight * (fastest - slowest)
            return indices(time, off).iae

        self.errors = np.array([error(share) for share in SHARES.tolist()])
        self.overshoot = overshoot_pct(fastest)

    def weights(self, i: int) -> SetpointWeights:
        """Those of a share, in as many digits as anybody reads."""
        given = self._given
        return SetpointWeights(round(float(SHARES[i]) * given.proportional, DIGITS), round(given.derivative, DIGITS))
