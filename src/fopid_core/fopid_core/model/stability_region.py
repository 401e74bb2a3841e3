"""Which gains stabilise a process, for fixed orders: D-decomposition, verified.

On the border of a region a pole lies on the imaginary axis: 1 + C(jw) P(jw) = 0. For two free gains this is a real
2 by 2 system at every w, and its solutions draw the curve on which the number of unstable poles changes (Neimark 1948;
Hamamci 2007 for fractional orders). Whether a piece of it bounds the stable region is asked of the argument principle,
on both sides.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from fopid_core.errors import InputError
from fopid_core.model.arrays import Booleans, Floats
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process
from fopid_core.model.stability import stable_mask
from fopid_core.model.winding import right_half_plane_zeros

Plane = tuple[Literal["kp", "ki", "kd"], Literal["kp", "ki", "kd"]]
Box = tuple[tuple[float, float], tuple[float, float]]

_COLUMNS = {"kp": 0, "ki": 1, "kd": 2}
_CURVE_POINTS = 1500
_TURNS = 6.0  # of the delay's phase that the curve follows
_ASIDE = 1e-3  # distance from the curve at which both sides are tested, relative to the point's size
_PADDING = 0.15
_REACH = 30.0  # as far as the view goes, over the process's gain in the middle of its range; at least 1 over it
_DEPENDENT = 1e-9


@dataclass(frozen=True)
class StabilityRegion:
    """The stabilising gains in a plane, all other numbers of the controller fixed.

    Attributes
    ----------
    plane : tuple of str
        Names of the two gains.
    controller : Fopid
        The fixed numbers (its gains of that name are not used).
    x, y : ndarray, shape (n,)
        Values of the two gains on the grid.
    stable : ndarray of bool, shape (n, n)
        ``stable[i, j]`` for ``(x[j], y[i])``, by the argument principle.
    frequency : ndarray, shape (m,)
        The curve's parameter w [rad/s].
    curve : ndarray, shape (2, m)
        The gains that put a pole on jw.
    border : ndarray of bool, shape (m,)
        Where the loop is stable on one side of the curve and not on the other.
    """

    plane: Plane
    controller: Fopid
    x: Floats
    y: Floats
    stable: Booleans
    frequency: Floats
    curve: Floats
    border: Booleans


def stability_region(
    process: Process, controller: Fopid, plane: Plane = ("kp", "ki"), box: Box | None = None, resolution: int = 60
) -> StabilityRegion:
    """The gains in a plane for which the loop is stable.

    Parameters
    ----------
    process : Process
    controller : Fopid
        Orders, and the gain that is not in the plane.
    plane : tuple of str
        Two of kp, ki, kd.
    box : tuple of tuple of float, optional
        Limits of both gains; otherwise so that the verified border is in view.
    resolution : int
        Points of the grid along each side.

    Examples
    --------
    >>> region = stability_region(Process.parse("1/(s+1)^3"), Fopid(kp=0.0, ki=1.0), box=((0.0, 9.0), (-1.0, 4.0)))
    >>> bool(region.stable.any()), bool(region.stable[region.y < 0].any())
    (True, False)
    """
    _check(controller, plane, box, resolution)
    frequency = _frequencies(process)
    curve = _curve(process, controller, plane, frequency)
    kept = np.all(np.isfinite(curve), axis=0)
    frequency, curve = frequency[kept], curve[:, kept]
    border = _is_border(process, controller, plane, curve)
    (x_low, x_high), (y_low, y_high) = box or _view(process, curve[:, border])
    x, y = np.linspace(x_low, x_high, resolution), np.linspace(y_low, y_high, resolution)
    columns, rows = np.meshgrid(x, y)
    gains = _rows(controller, plane, np.stack((columns.ravel(), rows.ravel())))
    stable = stable_mask(process, gains).reshape(columns.shape)
    return StabilityRegion(plane, controller, x, y, stable, frequency, curve, border)


def _check(controller: Fopid, plane: Plane, box: Box | None, resolution: int) -> None:
    if len(plane) != 2 or len(set(plane)) != 2 or not set(plane) <= set(_COLUMNS):
        raise InputError(f"plane = {plane}; allowed: two of kp, ki, kd")
    powers = {"kp": 0.0, "ki": -controller.lam, "kd": controller.mu}
    if abs(math.sin(0.5 * math.pi * (powers[plane[0]] - powers[plane[1]]))) < _DEPENDENT:
        raise InputError(
            f"lam = {controller.lam:g}, mu = {controller.mu:g} in the plane {plane[0]}, {plane[1]}; "
            "allowed: orders that are not 0 or 2 apart (the two gains then act in one line)"
        )
    if box is not None and not all(math.isfinite(low) and math.isfinite(high) and low < high for low, high in box):
        raise InputError(f"box = {box}; allowed: two finite rising ranges")
    if not 2 <= resolution <= 1000:
        raise InputError(f"resolution = {resolution}; allowed: 2 to 1000")


def _dynamic_range(process: Process) -> tuple[float, float]:
    """Between which ln w the process changes."""
    parts = [right_half_plane_zeros(part).log_frequency for part in (process.numerator, process.denominator)]
    dense = np.concatenate(parts)
    return float(dense.min()), float(dense.max())


def _frequencies(process: Process) -> Floats:
    low, high = _dynamic_range(process)
    w = np.exp(np.linspace(low - 3.0, high + 3.0, _CURVE_POINTS))
    if process.delay:
        turns = np.linspace(0.0, _TURNS * 2.0 * math.pi, _CURVE_POINTS)[1:] / process.delay
        w = np.concatenate((w[w < turns[-1]], turns))
    return np.unique(w)


def _curve(process: Process, controller: Fopid, plane: Plane, frequency: Floats) -> Floats:
    """The two gains that solve C(s) = -1 / P(s) on s = jw, shape (2, m)."""
    s = 1j * frequency
    log_s = np.log(s)
    actions = {"kp": np.ones_like(s), "ki": np.exp(-controller.lam * log_s), "kd": np.exp(controller.mu * log_s)}
    with np.errstate(divide="ignore", invalid="ignore"):
        wanted = -1.0 / process(s)
        for name in set(actions) - set(plane):
            wanted = wanted - getattr(controller, name) * actions[name]
        a, b = (actions[name] for name in plane)
        determinant = (np.conj(a) * b).imag
        return np.stack(((np.conj(wanted) * b).imag / determinant, (np.conj(a) * wanted).imag / determinant))


def _rows(controller: Fopid, plane: Plane, gains: Floats) -> Floats:
    """Controllers as rows (kp, ki, kd, lam, mu) with the two gains put in."""
    rows = np.tile(np.array(controller.gains), (gains.shape[1], 1))
    for name, values in zip(plane, gains, strict=True):
        rows[:, _COLUMNS[name]] = values
    return rows


def _is_border(process: Process, controller: Fopid, plane: Plane, curve: Floats) -> Booleans:
    tangent = np.gradient(curve, axis=1)
    normal = np.stack((-tangent[1], tangent[0])) / np.maximum(np.linalg.norm(tangent, axis=0), 1e-300)
    aside = _ASIDE * np.linalg.norm(curve, axis=0) * normal
    left, right = (stable_mask(process, _rows(controller, plane, curve + sign * aside)) for sign in (-1.0, 1.0))
    return np.asarray(left != right, dtype=np.bool_)


def _view(process: Process, border: Floats) -> Box:
    """The border, cut where an unbounded region would push everything else into a corner."""
    typical = 1.0 / float(np.abs(process(1j * math.exp(0.5 * sum(_dynamic_range(process))))))
    sides = []
    for values in border:
        low = np.clip(values.min(initial=0.0), -_REACH * typical, -typical)
        high = np.clip(values.max(initial=0.0), typical, _REACH * typical)
        sides.append((low - _PADDING * (high - low), high + _PADDING * (high - low)))
    return sides[0], sides[1]
