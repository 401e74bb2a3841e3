"""The integral indices of a computed response, each with the largest error that it may have.

Simpson's rule on pairs of samples is compared with itself on pairs of pairs. Where the error changes sign its absolute
value has a kink: there the parabola through the samples is integrated finely. Where it jumps, the trapezoid rules of
both spacings are compared, which differ by more than a jump between samples can matter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fopid_core.model.arrays import Booleans, Floats
from fopid_core.model.indices import INDEX_NAMES, Indices

_POWERS = {"iae": (0, 1), "ise": (0, 2), "itae": (1, 1), "itse": (1, 2), "istes": (4, 2), "istse": (2, 2)}
_FINE = 16  # parts of each interval next to a change of sign
_ROUGH = 0.05  # third differences so large beside the first ones: a jump or a cusp
_BETWEEN = 0.065  # of the third difference is what a parabola misses between samples at most
_JUMP = 1.5
_UNKNOWN = 0.5  # an index with a larger relative error than this is not known


@dataclass(frozen=True)
class _Groups:
    """Samples by fives, neighbours sharing one: shape (g, 5) each."""

    time: Floats
    error: Floats
    rough: Booleans
    crossing: Booleans

    @staticmethod
    def of(time: Floats, error: Floats) -> _Groups:
        count = (time.size - 1) // 4
        index = 4 * np.arange(count)[:, None] + np.arange(5)
        e = error[index]
        first, third = np.abs(np.diff(e, axis=1)).max(axis=1), np.abs(np.diff(e, n=3, axis=1)).max(axis=1)
        return _Groups(time[index], e, third > _ROUGH * first, (e.min(axis=1) < 0.0) & (e.max(axis=1) > 0.0))


def response_indices(time: Floats, error: Floats, uncertainty: Floats) -> tuple[Indices, Indices]:
    """The indices of a response and the largest error of each.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Rising instants [s]; all but the first few evenly spaced by fours.
    error : ndarray, shape (n,)
        Setpoint minus output at these instants.
    uncertainty : ndarray, shape (n,)
        Largest error of ``error``.

    Returns
    -------
    indices, accuracy : Indices
        NaN where an index is not known to half its value.

    Examples
    --------
    >>> time = np.linspace(0.0, 40.0, 401)
    >>> found, accuracy = response_indices(time, np.cos(time) * np.exp(-time / 2), np.zeros(401))
    >>> round(found.ise, 5), abs(found.ise - 0.6) < accuracy.ise < 1e-4
    (0.6, True)
    """
    head = (time.size - 1) % 4
    groups = _Groups.of(time[head:], error[head:])
    found, accuracy = {}, {}
    with np.errstate(all="ignore"):
        for name in INDEX_NAMES:
            power, square = _POWERS[name]
            value, doubt = _groups(groups, power, square)
            early, early_doubt = _early(time[: head + 1], error[: head + 1], power, square)
            value, doubt = value + early, doubt + early_doubt
            doubt += _carried(time, error, uncertainty, power, square)
            known = bool(doubt <= _UNKNOWN * value)
            found[name], accuracy[name] = (value, doubt) if known else (float("nan"), float("nan"))
    return Indices(**found), Indices(**accuracy)


def _integrand(time: Floats, error: Floats, power: int, square: int) -> Floats:
    return np.asarray(time**power * (error**2 if square == 2 else np.abs(error)))


def _groups(groups: _Groups, power: int, square: int) -> tuple[float, float]:
    f = _integrand(groups.time, groups.error, power, square)
    step = (groups.time[:, 4] - groups.time[:, 0]) / 4.0
    fine, coarse = _simpson(f, step)
    doubt = np.abs(fine - coarse)
    trapezoids = step * np.abs(f[:, 1] + f[:, 3] - 0.5 * f[:, 0] - f[:, 2] - 0.5 * f[:, 4])
    rough = groups.rough
    if square == 1 and groups.crossing.any():
        kinked = np.flatnonzero(groups.crossing)
        fine[kinked], doubt[kinked] = _kinks(groups.time[kinked], groups.error[kinked], power, step[kinked])
    bent = step * np.abs(np.diff(f, n=3, axis=1)).max(axis=1)  # a cusp between samples can deceive both rules alike
    doubt = np.where(rough, doubt + _JUMP * trapezoids + bent, doubt)
    return float(fine.sum()), float(doubt.sum())


def _simpson(f: Floats, step: Floats) -> tuple[Floats, Floats]:
    fine = step / 3.0 * (f[:, 0] + 4.0 * f[:, 1] + 2.0 * f[:, 2] + 4.0 * f[:, 3] + f[:, 4])
    coarse = 2.0 * step / 3.0 * (f[:, 0] + 4.0 * f[:, 2] + f[:, 4])
    return fine, coarse


def _kinks(time: Floats, error: Floats, power: int, step: Floats) -> tuple[Floats, Floats]:
    """Integrals of the absolute value over groups in which the error changes sign."""
    x = np.linspace(0.0, 2.0, 2 * _FINE + 1)
    basis = np.stack([0.5 * (x - 1.0) * (x - 2.0), x * (2.0 - x), 0.5 * x * (x - 1.0)])
    total, doubt = np.zeros(step.size), np.zeros(step.size)
    width = step / _FINE
    for i in (0, 2):
        t = time[:, i, None] + step[:, None] * x
        f = t**power * np.abs(error[:, i : i + 3] @ basis)
        total += width * (f.sum(axis=1) - 0.5 * (f[:, 0] + f[:, -1]))
        slope = np.abs(np.diff(error[:, i : i + 3], axis=1)).max(axis=1)
        bend = np.abs(np.diff(error[:, i : i + 3], n=2, axis=1))[:, 0]
        doubt += time[:, 4] ** power * width * (slope / _FINE / 4.0 + bend / _FINE / 6.0)
    third = np.abs(np.diff(error, n=3, axis=1)).max(axis=1)
    doubt += time[:, 4] ** power * 4.0 * step * _BETWEEN * third
    signed = _simpson(time**power * error, step)
    return total, doubt + np.abs(signed[0] - signed[1])


def _early(time: Floats, error: Floats, power: int, square: int) -> tuple[float, float]:
    """The first few intervals: the trapezoid rule, wrong by no more than all the change in them."""
    if time.size < 2:
        return 0.0, 0.0
    f, step = _integrand(time, error, power, square), np.diff(time)
    return float(np.sum(step * (f[1:] + f[:-1])) / 2.0), float(np.sum(step * np.abs(np.diff(f))) + step.sum() * f.max())


def _carried(time: Floats, error: Floats, uncertainty: Floats, power: int, square: int) -> float:
    """What the uncertainty of the error makes of an index."""
    size = uncertainty if square == 1 else uncertainty * (2.0 * np.abs(error) + uncertainty)
    f = time**power * np.where(uncertainty > 0.0, size, 0.0)
    return float(np.sum(np.diff(time) * np.maximum(f[1:], f[:-1])))
