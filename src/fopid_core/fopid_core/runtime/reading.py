"""What gains and orders come to, for one bank of lags: numbers between which a controller can go in a straight line."""

from __future__ import annotations

from dataclasses import dataclass

from fopid_core.runtime.operators import Matrix


@dataclass(frozen=True)
class Reading:
    """How a controller reads what it remembers.

    Attributes
    ----------
    kp, ki : float
    weights : ndarray, shape (2, size)
        Of what is remembered, for the integral and the derivative part, gains included.
    feedthrough, setpoint_feedthrough : float
        Control per unit of error, or of setpoint, at the same tick.
    tracking_gain : float
        What the integral's input gets per unit of limited less unlimited control.
    conditioned : bool
        Whether all that is remembered may take in what was limited.
    """

    kp: float
    ki: float
    weights: Matrix
    feedthrough: float
    setpoint_feedthrough: float
    tracking_gain: float
    conditioned: bool

    def towards(self, other: Reading, share: float) -> Reading:
        """The reading on the straight line to another one, which it is at share 1."""

        def go(a: float, b: float) -> float:
            return (1.0 - share) * a + share * b

        return Reading(
            go(self.kp, other.kp),
            go(self.ki, other.ki),
            (1.0 - share) * self.weights + share * other.weights,
            go(self.feedthrough, other.feedthrough),
            go(self.setpoint_feedthrough, other.setpoint_feedthrough),
            go(self.tracking_gain, other.tracking_gain),
            self.conditioned and other.conditioned,
        )
