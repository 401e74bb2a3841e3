"""What gains and orders come to, for one bank of lags: numbers between which a controller can go in a straight line."""

from __future__ import annotations

from dataclasses import dataclass

from fopid_core.model.fopid import Fopid
from fopid_core.runtime.antiwindup import direct_feedthrough, feedthroughs
from fopid_core.runtime.operators import Matrix, Operators


@dataclass(frozen=True)
class Reading:
    """How a controller reads what it remembers.

    Attributes
    ----------
    ki : float
    integrates : bool
        Whether the controller does.
    weights : ndarray, shape (2, size)
        Of what is remembered, for the integral and the derivative part, gains included.
    feedthrough : float
        Control per unit of error at the same tick, kept away from zero: anti-windup divides by it.
    parts : tuple of float
        Such feedthroughs of the proportional part, kp, and of the integral and the derivative part; their sum may be
        zero.
    tracking_gain : float
        What the integral's input gets per unit of limited less unlimited control.
    conditioned : bool
        Whether all that is remembered may take in what was limited.
    """

    ki: float
    integrates: bool
    weights: Matrix
    feedthrough: float
    parts: tuple[float, float, float]
    tracking_gain: float
    conditioned: bool

    def towards(self, other: Reading, share: float) -> Reading:
        """The reading on the straight line to another one, which it is at share 1."""

        def go(a: float, b: float) -> float:
            return (1.0 - share) * a + share * b

        return Reading(
            go(self.ki, other.ki),
            self.integrates or other.integrates,
            (1.0 - share) * self.weights + share * other.weights,
            go(self.feedthrough, other.feedthrough),
            (go(self.parts[0], other.parts[0]), go(self.parts[1], other.parts[1]), go(self.parts[2], other.parts[2])),
            go(self.tracking_gain, other.tracking_gain),
            self.conditioned and other.conditioned,
        )


def reading_of(operators: Operators, gains: Fopid, tracking_gain: float, conditioned: bool) -> Reading:
    """What gains come to, read by operators that are set to their orders."""
    return Reading(
        ki=gains.ki,
        integrates=gains.integrates,
        weights=operators.weights * [[gains.ki], [gains.kd]],
        feedthrough=direct_feedthrough(operators, gains),
        parts=feedthroughs(operators, gains),
        tracking_gain=tracking_gain,
        conditioned=conditioned,
    )
