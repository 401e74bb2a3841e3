"""Anti-windup: what the controller remembers while its control is limited.

Conditioning (Hanus, Kinnaert and Henrotte 1987): the controller remembers not the error but the realisable error,
the one for which the control would just not have been limited. With u = D e + (what is remembered), D the instant
gain, this is e + (limited - unlimited) / D. All lags take it in, those of the derivative too, so that nothing winds
up and what is remembered stays the memory of one error, for whatever orders come next.

The realisable error obeys the inverse of the controller. Where that is not stable (orders with lam + mu well above 2
and a small kp, some gains of both signs) only the integral takes a correction in, as in the books:
(limited - unlimited) / (ki tracking_time^lam).
"""

from __future__ import annotations

import math

import numpy as np

from fopid_core.model.fopid import Fopid
from fopid_core.runtime.filter_bank import Vector
from fopid_core.runtime.operators import Operators
from fopid_core.runtime.settings import ControllerSettings

_LOUDEST = 4.0  # echo of an excess, ticks later; of a derivative of order 2 the next tick alone brings up to 2.7
_FIRST_TICKS = 64  # in which an echo that dies away is loudest
_FASTEST = 1.0 + 1e-6  # growth per tick: less than threefold in a million ticks


def feedthroughs(operators: Operators, gains: Fopid) -> tuple[float, float, float]:
    """Control per unit of error at the same tick, of the proportional, the integral and the derivative part."""
    return gains.kp, float(gains.ki * operators.matrix[-2, -2]), float(gains.kd * operators.matrix[-1, -1])


def direct_feedthrough(operators: Operators, gains: Fopid) -> float:
    """Control per unit of error at the same tick; never so little that taking it back would overshoot."""
    gain = sum(feedthroughs(operators, gains))
    least = abs(gains.ki) * operators.integral_after_one_tick()
    return gain if abs(gain) >= least else math.copysign(least, gains.ki)


def setpoint_feedthrough(parts: tuple[float, float, float], settings: ControllerSettings) -> float:
    """Control per unit of setpoint at the same tick, by the ``feedthroughs`` of the three parts."""
    proportional, integral, derivative = parts
    return proportional * settings.setpoint_weight + integral + derivative * settings.derivative_setpoint_weight


def conditioning(operators: Operators, gains: Fopid) -> Vector | None:
    """What a unit of limited less unlimited control adds to what is remembered, shape (size,).

    None where the inverse of the controller is not stable, and where there is no integral to unwind.
    """
    n, matrix, gain = operators.size, operators.matrix, direct_feedthrough(operators, gains)
    if gains.ki == 0.0:
        return None
    of_error = operators.of_error / gain
    return of_error if _is_stable(operators, gains, matrix[:, :n] @ of_error) else None


def tracking_gain(operators: Operators, gains: Fopid, tracking_time: float) -> float:
    """What the integral's input gets per unit of limited less unlimited control.

    1 / (ki tracking_time^lam), but no more than takes half of the excess back in one tick, and no more than makes it
    die away: beyond that the correction would overshoot from tick to tick. 0 stands for (kp/ki)^(1/lam).
    """
    ki, lam = gains.ki, gains.lam
    if ki == 0.0 or lam == 0.0:
        return 0.0
    scale = tracking_time**lam if tracking_time else abs(gains.kp / ki) or 1.0
    per_excess = max(abs(ki) * scale, 2.0 * abs(ki) * operators.integral_after_one_tick())
    gain = math.copysign(1.0 / per_excess, ki) if per_excess > 1e-300 else 0.0
    while gain and not _is_stable(operators, gains, gain * operators.matrix[:, -2]):
        gain *= 0.5
    return gain


def _is_stable(operators: Operators, gains: Fopid, taken_in: Vector) -> bool:
    """Whether an excess that is taken in so (a column of the operators' matrix) does not come back ever louder."""
    only_integral = not taken_in[operators.integrated : operators.size].any()
    n = operators.integrated if only_integral else operators.size
    reading = np.array([gains.ki, gains.kd])
    echo = np.zeros((n + 1, n + 1))  # on what is remembered and the excess, from tick to tick
    echo[:n, :n], echo[:n, n] = operators.matrix[:n, :n], taken_in[:n]
    echo[n, :n], echo[n, n] = -reading @ operators.matrix[-2:, :n], -reading @ taken_in[-2:]
    if not np.isfinite(echo).all() or np.abs(np.linalg.eigvals(echo)).max() > _FASTEST:
        return False
    now = echo[:, n]
    for _ in range(_FIRST_TICKS):
        if abs(now[n]) > _LOUDEST:
            return False
        now = echo @ now
    return True
