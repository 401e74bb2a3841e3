"""How much of the setpoint the controller acts on: what overshoots less at little more error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fopid_core.design.control_peak import first_control
from fopid_core.errors import InputError
from fopid_core.model.arrays import Floats
from fopid_core.model.indices import indices, overshoot_pct
from fopid_core.model.loop import Loop
from fopid_core.model.response import step_response
from fopid_core.model.two_degrees import SetpointWeights

DERIVATIVE_PAYS = 1.5
"""How many times the error a step of the setpoint must leave without its derivative, for that to be worth its kick:
what less was promised, limits took on the plants, and the control moved half as much again."""
KICK = 3.0
"""And how many times what a step moves the control by without it that kick may be: a motor's promised half the error
for four times that, left three quarters, and moved the control three times as much in all."""
LITTLE_MORE = 1.1
"""How many times the least error is given for less overshoot: the plant overshoots by more than what is known of it,
since it has limits."""
SHARES = np.linspace(1.0, 0.0, 21)
"""Of the proportional part's weight, which are tried."""
DIGITS = 6
"""Behind the point, of weights: one from a search comes as 0.9999999999999987."""
CALM = 2.0
"""An overshoot [%] of which nobody complains."""


def calmest_weights(loop: Loop, horizon: float, sample_time: float = 0.0) -> SetpointWeights:
    """Weights no larger than those of a loop, and as small as little more error allows.

    That of the derivative is 0 where it does not pay, and the proportional one is made less where the loop would
    overshoot with the whole setpoint. Error is the integral of its absolute value over a horizon [s]. Load and
    stability do not know of the weights. With the sample time of the controller [s] its kick is looked at as well.

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
            pays = loop.controller.kd and without.errors.min() > DERIVATIVE_PAYS * steps.errors.min()
            if not pays or _kick(loop, sample_time) > KICK * without.control_peak:
                steps = without
    except InputError:  # near the border of stability it is not known
        return loop.weights
    if steps.overshoot <= CALM:
        return steps.weights(int(np.argmin(steps.errors)))
    return steps.weights(int(np.flatnonzero(steps.errors <= LITTLE_MORE * steps.errors.min())[-1]))


def _kick(loop: Loop, sample_time: float) -> float:
    """How far the setpoint's derivative moves the control in the first tick after a unit step; 0 where not known."""
    derivative = replace(loop.controller, kp=0.0, ki=0.0)
    first = float(first_control(np.array([derivative.gains]), sample_time)[0]) if sample_time else 0.0
    return abs(loop.weights.derivative * first)


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
        self._controls: list[Floats] = [np.interp(time, one.time, one.control) for one in (none, whole)]

    @property
    def control_peak(self) -> float:
        """How far the control goes with the share that leaves least error, where the setpoint is not differentiated."""
        none, whole = self._controls
        return float(np.abs(none + SHARES[int(np.argmin(self.errors))] * (whole - none)).max())

    def weights(self, i: int) -> SetpointWeights:
        """Those of a share, in as many digits as anybody reads."""
        given = self._given
        return SetpointWeights(round(float(SHARES[i]) * given.proportional, DIGITS), round(given.derivative, DIGITS))
