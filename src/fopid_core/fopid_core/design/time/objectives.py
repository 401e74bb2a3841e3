"""What time-domain tuning minimises: eqs. (24) to (30), index plus control energy, and Zamani's composite."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fopid_core.design.specification import one_of, require
from fopid_core.model.indices import INDEX_NAMES

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

ZAMANI_PARTS = (
    "overshoot", "rise_time", "settling_time", "steady_state_error", "iae", "energy", "phase_margin", "gain_margin",
)  # fmt: skip
OBJECTIVES = (*INDEX_NAMES, "sum", "energy", "zamani")
SETTLED = 0.02
"""Band of the settling time, as a share of the step."""
SMALLEST = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class LoopResponses:
    """What a batch of n loops does after a unit setpoint step.

    Attributes
    ----------
    time : ndarray, shape (m,)
    errors : ndarray, shape (n, k m)
        Of k steps, one behind the other.
    controls : ndarray, shape (n, m)
        Only when the objective needs it; the first sample is that of the controller as it runs.
    w : ndarray, shape (k,)
        Frequencies [rad/s].
    loop : ndarray, shape (n, k)
        L(j w); only when the objective is no integral.
    """

    time: Real
    errors: Real
    controls: Real | None
    w: Real
    loop: Complex | None

    @property
    def signals(self) -> Real:
        """Errors, and behind them controls where they count."""
        return self.errors if self.controls is None else np.concatenate([self.errors, self.controls], axis=1)


@dataclass(frozen=True)
class Objective:
    """A cost of the loop's behaviour.

    Attributes
    ----------
    name : str
        One of the six indices of eqs. (24) to (29); ``sum``, their weighted sum, eq. (30); ``energy``, indices plus
        the integral of the squared control; ``zamani``, the composite of Zamani et al. (2009).
    weights : mapping
        Weights of the parts. For ``sum`` all six weigh 1 unless weights are given, for ``energy`` itae and energy do,
        for ``zamani`` all eight parts. The parts of ``zamani`` are the overshoot as a share of the step, times in
        seconds, and the inverse of the phase margin [rad] and of the gain margin.

    Examples
    --------
    >>> Objective.of("sum", {"iae": 1.0}).weights
    {'iae': 1.0}
    """

    name: str
    weights: Mapping[str, float]

    @staticmethod
    def of(name: str, weights: Mapping[str, float]) -> Objective:
        """An objective by name; no weights given means the usual ones."""
        one_of("index", name, OBJECTIVES)
        parts = {
            "sum": INDEX_NAMES,
            "energy": (*INDEX_NAMES, "energy"),
            "zamani": ZAMANI_PARTS,
        }.get(name, (name,))
        for part, weight in weights.items():
            one_of("weights", part, parts)
            require(0.0 <= weight < math.inf, f"weight of {part}", weight, "0 or above")
        require(not weights or any(weights.values()), "weights", dict(weights), "at least one above 0")
        usual = ("itae", "energy") if name == "energy" else parts
        return Objective(name, dict(weights) if weights else dict.fromkeys(usual, 1.0))

    @property
    def needs_control(self) -> bool:
        """Whether the control signal counts."""
        return self.weights.get("energy", 0.0) > 0.0

    @property
    def is_integral(self) -> bool:
        """Whether it is a sum of integrals of absolute values and squares, and nothing else."""
        return self.name != "zamani"

    def time_weights(self, time: Real, steps: Sequence[float] = (1.0,)) -> tuple[Real, Real]:
        """Weights, shape (k m,), of the signals' absolute values and squares whose sum is the cost.

        The sum is the trapezoid rule for eqs. (24) to (29) for each of k steps, weighted; behind the errors stands the
        control where it counts.
        """
        of_absolute = {"iae": np.ones_like(time), "itae": time}
        of_square = {"ise": np.ones_like(time), "itse": time, "istes": time**4, "istse": time**2}
        trapezoid = np.full_like(time, time[1])
        trapezoid[[0, -1]] *= 0.5
        absolute = np.concatenate([step * self._combined(of_absolute) * trapezoid for step in steps])
        square = np.concatenate([step * self._combined(of_square) * trapezoid for step in steps])
        if not self.needs_control:
            return absolute, square
        of_control = np.full_like(time, self.weights["energy"] * time[1])
        return np.concatenate([absolute, 0.0 * time]), np.concatenate([square, of_control])

    def cost(self, responses: LoopResponses, weights: tuple[Real, Real]) -> Real:
        """The cost of each loop, shape (n,), with the weights for its time."""
        absolute, square = weights
        signals = responses.signals
        total = np.zeros(len(signals))
        if absolute.any():
            total = total + np.abs(signals) @ absolute
        if square.any():
            total = total + signals**2 @ square
        return total if responses.loop is None else total + self._zamani(responses, responses.loop)

    def _combined(self, powers: Mapping[str, Real]) -> Real:
        parts = [self.weights.get(name, 0.0) * power for name, power in powers.items()]
        return np.asarray(np.sum(parts, axis=0))

    def _zamani(self, responses: LoopResponses, loop: Complex) -> Real:
        outputs = 1.0 - responses.errors
        parts = {
            "overshoot": np.maximum(outputs.max(axis=1) - 1.0, 0.0),
            "rise_time": _crossing(responses.time, outputs, 0.9) - _crossing(responses.time, outputs, 0.1),
            "settling_time": _settling(responses.time, responses.errors),
            "steady_state_error": np.abs(responses.errors[:, -1]),
            "phase_margin": 1.0 / phase_margin(loop),
            "gain_margin": 1.0 / gain_margin(loop),
        }
        return self._combined(parts)


def _crossing(time: Real, outputs: Real, level: float) -> Real:
    """The first instant at which each output reaches a level; the horizon when it does not."""
    above = outputs >= level
    first = np.where(above.any(axis=1), above.argmax(axis=1), len(time) - 1)
    rows, before = np.arange(len(outputs)), np.maximum(first - 1, 0)
    low, high = outputs[rows, before], outputs[rows, first]
    share = np.where(high > low, (level - low) / np.where(high > low, high - low, 1.0), 1.0)
    return np.asarray(time[before] + np.minimum(share, 1.0) * (time[first] - time[before]))


def _settling(time: Real, errors: Real) -> Real:
    """The instant from which each error stays within SETTLED."""
    outside = np.abs(errors) > SETTLED
    last = len(time) - 1 - outside[:, ::-1].argmax(axis=1)
    last = np.where(outside.any(axis=1), np.minimum(last, len(time) - 2), 0)
    rows = np.arange(len(errors))
    here, after = np.abs(errors[rows, last]), np.abs(errors[rows, last + 1])
    share = np.where(here > after, (here - SETTLED) / np.where(here > after, here - after, 1.0), 1.0)
    return np.asarray(time[last] + np.clip(share, 0.0, 1.0) * time[1])


def phase_margin(loop: Complex) -> Real:
    """The smallest angle from -1 at which |L| passes 1 downwards [rad], shape (n,); pi when it does not."""
    gain = _log_gain(loop)
    share, crosses = _downward(gain)
    angle = np.angle(-loop)
    turn = np.angle(np.exp(1j * np.diff(angle, axis=1)))
    margins = np.where(crosses, np.abs(angle[:, :-1] + share * turn), math.pi)
    return np.asarray(margins.min(axis=1, initial=math.pi))


def gain_margin(loop: Complex) -> Real:
    """The least factor above 1 on the gain that reaches -1, shape (n,); infinite when none does."""
    share, crosses = _downward(np.angle(-loop))
    near = np.abs(np.diff(np.angle(-loop), axis=1)) < 1.0
    gain = _log_gain(loop)
    reached = np.exp(-(gain[:, :-1] + share * np.diff(gain, axis=1)))
    margins = np.where(crosses & near & (reached > 1.0), reached, math.inf)
    return np.asarray(margins.min(axis=1, initial=math.inf))


def _log_gain(loop: Complex) -> Real:
    """A loop that is zero, as without gains, counts as the smallest that there is."""
    return np.asarray(np.log(np.maximum(np.abs(loop), SMALLEST)))


def _downward(values: Real) -> tuple[Real, NDArray[np.bool_]]:
    """Where each row passes zero downwards, and which share of the interval lies before that."""
    before, after = values[:, :-1], values[:, 1:]
    crosses = (before >= 0.0) & (after < 0.0)
    return np.where(crosses, before / np.where(crosses, before - after, 1.0), 0.0), crosses
