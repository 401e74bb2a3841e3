"""What a response is worth: the integral indices, eqs. (24) to (30) of the paper, and the usual step measures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike

from fopid_core.errors import InputError
from fopid_core.model.arrays import Floats

INDEX_NAMES = ("iae", "ise", "itae", "itse", "istes", "istse")


@dataclass(frozen=True)
class Indices:
    """Integrals of the error over the response.

    Attributes
    ----------
    iae, ise, itae, itse, istes, istse : float
        Integrals of abs(e), e^2, t abs(e), t e^2, (t^2 e)^2 and t^2 e^2: eqs. (24) to (29).
    """

    iae: float
    ise: float
    itae: float
    itse: float
    istes: float
    istse: float

    def weighted_sum(self, weights: Mapping[str, float] | None = None) -> float:
        """The composite index of eq. (30); every weight is 1 when none is given.

        Examples
        --------
        >>> Indices(1.0, 2.0, 3.0, 4.0, 5.0, 6.0).weighted_sum({"iae": 1.0, "ise": 0.5})
        2.0
        """
        values = asdict(self)
        if weights is None:
            return float(sum(values.values()))
        for name in weights:
            if name not in values:
                raise InputError(f"weight of {name!r}; allowed: weights of {', '.join(INDEX_NAMES)}")
        return float(sum(weight * values[name] for name, weight in weights.items()))


def indices(time: ArrayLike, error: ArrayLike) -> Indices:
    """The integral indices of a sampled error, by the trapezoid rule.

    Parameters
    ----------
    time : array_like, shape (n,)
        Instants [s], increasing; the spacing need not be even.
    error : array_like, shape (n,)
        Setpoint minus output at these instants. One that is infinite at first, behind a derivative of the setpoint of
        an order above 1, falls as a power of time, which has an integral up to some power.

    Examples
    --------
    >>> import numpy as np
    >>> time = np.linspace(0.0, 40.0, 40001)
    >>> round(indices(time, np.exp(-time)).itae, 5)
    1.0
    """
    t, e = np.asarray(time, dtype=float), np.asarray(error, dtype=float)
    with np.errstate(invalid="ignore"):  # 0 times infinity at the first instant
        integrands = {
            "iae": np.abs(e),
            "ise": e**2,
            "itae": t * np.abs(e),
            "itse": t * e**2,
            "istes": (t**2 * e) ** 2,
            "istse": t**2 * e**2,
        }
    if e.size > 2 and np.isinf(e[0]):
        return Indices(**{name: _from_infinite(t, f) for name, f in integrands.items()})
    return Indices(**{name: _integral(t, f) for name, f in integrands.items()})


def _integral(t: Floats, f: Floats) -> float:
    return float(np.sum(np.diff(t) * (f[1:] + f[:-1])) / 2.0)


def _from_infinite(t: Floats, f: Floats) -> float:
    """Of what falls from an infinite error as a power of time; infinite where that power is -1 or steeper."""
    if not 0.0 < f[1] < np.inf or not 0.0 < f[2] < np.inf:
        return _integral(t[1:], f[1:])
    power = float(np.log(f[2] / f[1]) / np.log(t[2] / t[1]))
    return _integral(t[1:], f[1:]) + (float(f[1] * t[1]) / (power + 1.0) if power > -1.0 else float("inf"))


def overshoot_pct(output: ArrayLike, setpoint: float = 1.0) -> float:
    """How far the output goes past the setpoint, in per cent of it; 0 when it does not."""
    return float(max(np.max(np.asarray(output) / setpoint) - 1.0, 0.0) * 100.0)


def first_crossing(time: ArrayLike, output: ArrayLike, level: float) -> float:
    """The first instant [s] at which the output reaches ``level``; NaN when it never does."""
    t, y = np.asarray(time, dtype=float), np.asarray(output, dtype=float)
    above = np.flatnonzero(y >= level)
    if above.size == 0:
        return float("nan")
    i = int(above[0])
    if i == 0 or y[i] == y[i - 1]:
        return float(t[i])
    return float(t[i - 1] + (level - y[i - 1]) / (y[i] - y[i - 1]) * (t[i] - t[i - 1]))


def rise_time(time: ArrayLike, output: ArrayLike, setpoint: float = 1.0) -> float:
    """The time [s] from the first 10 % to the first 90 % of the setpoint; NaN when 90 % is not reached."""
    scaled = np.asarray(output, dtype=float) / setpoint
    return first_crossing(time, scaled, 0.9) - first_crossing(time, scaled, 0.1)


def rise_time_to_100(time: ArrayLike, output: ArrayLike, setpoint: float = 1.0) -> float:
    """The first instant [s] at which the output reaches the setpoint, the paper's rise time."""
    return first_crossing(time, np.asarray(output, dtype=float) / setpoint, 1.0)


def settling_time(time: ArrayLike, output: ArrayLike, setpoint: float = 1.0, band: float = 0.02) -> float:
    """The instant [s] from which the output stays within ``band`` of the setpoint; NaN when it does not settle."""
    t = np.asarray(time, dtype=float)
    distance = np.abs(np.asarray(output, dtype=float) / setpoint - 1.0)
    outside = np.flatnonzero(distance > band)
    if outside.size == 0:
        return float(t[0])
    last = int(outside[-1])
    if last == t.size - 1:
        return float("nan")
    fraction = (distance[last] - band) / (distance[last] - distance[last + 1])
    return float(t[last] + fraction * (t[last + 1] - t[last]))


def total_variation(signal: ArrayLike) -> float:
    """The sum of all rises and falls of a sampled signal; infinite when a sample is."""
    values: Floats = np.asarray(signal, dtype=float)
    if not np.all(np.isfinite(values)):
        return float("inf")
    return float(np.sum(np.abs(np.diff(values))))


def peak(signal: ArrayLike) -> float:
    """The largest absolute value of a sampled signal; infinite when a sample is."""
    return float(np.max(np.abs(np.asarray(signal, dtype=float))))
