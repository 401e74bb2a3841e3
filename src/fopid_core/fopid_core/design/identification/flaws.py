"""What may not be linear in a process: an actuator that sticks, has play or limits, friction, a gain that bends."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fopid_core.design.identification.friction import Friction
from fopid_core.design.identification.record import Record
from fopid_core.model.arrays import Booleans, Floats

LEAST_SLOPE = 0.2
"""Below this share of its gain in the middle, a bent characteristic goes on straight."""


@dataclass(frozen=True)
class Flaws:
    """Of a process, before and behind its linear part; each a number, or an array of shape (m,) for m processes.

    Attributes
    ----------
    dead_band : float
        The stem stays while the control is no further than this from it.
    slip : float
        Then it comes up to the control (1: it sticks and jumps), or stays behind by the dead band (0: play).
    low, high : float
        Limits of what is felt of the control.
    bend : float
        The output is z + bend z^2 beside ``centre``, z what a linear process would show; straight where it is steep
        or flat.
    centre : float
    began : float
        How far from the control the stem stood at first.
    friction : Friction or None
        Of the mechanism that is moved; of one process.
    rate : float
        How far the actuator moves in a second at most; of one process.
    play : float
        Of what a stem that sticks moves in turn: it stays while the stem is no further than this from it.

    Examples
    --------
    >>> Flaws(dead_band=1.0).felt(np.array([0.0, 0.8, 1.5, 0.6, 0.4]))
    array([[0. , 0. , 1.5, 1.5, 0.4]])
    >>> Flaws(dead_band=1.0, slip=0.0).felt(np.array([0.0, 0.8, 1.5, 0.6, -0.9]))
    array([[0. , 0. , 0.5, 0.5, 0.1]])
    >>> Flaws(dead_band=1.0, play=0.3).felt(np.array([0.0, 0.8, 1.5, 0.6, 0.4]))
    array([[0. , 0. , 1.2, 1.2, 0.7]])
    >>> bent = Flaws(bend=0.1, centre=1.0)
    >>> bool(np.isclose(bent.straight(bent.bent(2.5)), 2.5))
    True
    """

    dead_band: Floats | float = 0.0
    slip: Floats | float = 1.0
    low: Floats | float = -math.inf
    high: Floats | float = math.inf
    bend: Floats | float = 0.0
    centre: float = 0.0
    began: Floats | float = 0.0
    friction: Friction | None = None
    rate: float = math.inf
    play: Floats | float = 0.0

    @property
    def stick(self) -> bool:
        """Whether play, stiction or dry friction is among them."""
        return bool(self.dead_band) or self.friction is not None

    @property
    def come_before(self) -> bool:
        """Whether something stands between the control and the linear part that only a simulation shows."""
        return self.stick or math.isfinite(self.rate)

    def stem(self, control: Floats, before: Floats) -> Floats:
        """Where the stem is under a control, shape (m,), and was before; play behind it is left out."""
        return self._moved(np.clip(control, self.low, self.high), before, self._behind())

    def _behind(self) -> Floats | None:
        """By how much a stem that moves stays behind; None where none does."""
        behind = np.asarray((1.0 - self.slip) * self.dead_band)
        return behind if behind.any() else None

    def _moved(self, limited: Floats, before: Floats, behind: Floats | None) -> Floats:
        """Where the stem is under what the limits leave of a control."""
        away = limited - before
        there = limited if behind is None else limited - np.sign(away) * behind
        return np.where(np.abs(away) > self.dead_band, there, before)

    def felt(self, control: Floats) -> Floats:
        """What is felt of a control, shape (n,), or of one for each process, shape (m, n); shape (m, n)."""
        count = np.broadcast(self.dead_band, self.slip, self.low, self.high, self.began, self.play).size
        controls = np.atleast_2d(control)
        controls = np.broadcast_to(controls, (max(count, len(controls)), controls.shape[1]))
        limited = np.clip(controls, _column(self.low), _column(self.high))
        if not (np.any(self.dead_band) or np.any(self.play)):
            return limited
        stem = np.clip(controls[:, 0] + self.began, self.low, self.high)
        stems, behind = np.array(limited.T, order="C"), self._behind()
        for moved in stems:
            moved[:] = stem = self._moved(moved, stem, behind)
        if np.any(self.play):
            beyond = stems[0].copy()
            for moved in stems:
                moved[:] = beyond = np.clip(beyond, moved - self.play, moved + self.play)
        return np.ascontiguousarray(stems.T)

    def bent(self, straight: Floats | float) -> Floats:
        """The output where a linear process would show this."""
        z, least, edge = self._about(straight)
        inside = np.where(least, edge, z)
        slope = 1.0 + 2.0 * self.bend * inside
        return np.asarray(self.centre + inside * (1.0 + self.bend * inside) + slope * (z - inside))

    def straight(self, output: Floats | float) -> Floats:
        """What a linear process would show where the output is this."""
        edge = self._edge()
        y = np.asarray(output) - self.centre
        steep = 1.0 + 4.0 * self.bend * y
        inside = 2.0 * y / (1.0 + np.sqrt(np.maximum(steep, LEAST_SLOPE**2)))
        at_edge = edge * (1.0 + self.bend * edge)
        return np.asarray(self.centre + np.where(steep < LEAST_SLOPE**2, edge + (y - at_edge) / LEAST_SLOPE, inside))

    def slope(self, output: Floats) -> tuple[float, float]:
        """The smallest and the largest gain on the way, as shares of that at the centre; of one process."""
        z = self.straight(output) - self.centre
        shares = np.maximum(1.0 + 2.0 * np.asarray(self.bend) * z, LEAST_SLOPE)
        return float(shares.min()), float(shares.max())

    def _edge(self) -> Floats:
        """Where the slope has fallen to the least, on the side where it falls."""
        bend = np.where(np.abs(self.bend) > 1e-12, self.bend, 1e-12)
        return np.asarray((LEAST_SLOPE - 1.0) / (2.0 * bend))

    def _about(self, straight: Floats | float) -> tuple[Floats, Booleans, Floats]:
        z = np.asarray(straight) - self.centre
        return z, 1.0 + 2.0 * self.bend * z < LEAST_SLOPE, self._edge()

    def of_record(self, record: Record) -> Record:
        """The record as the linear part sees it; of one process."""
        before = None if record.control_before is None else float(np.clip(record.control_before, self.low, self.high))
        control = record.control
        if math.isfinite(self.rate):
            control = slewed(record.time, control, np.array([self.rate]))[0]
        seen = replace(record, control=self.felt(control)[0], measurement=self.straight(record.measurement),
                       control_before=before)  # fmt: skip
        return replace(seen, control=self.friction.felt(seen)) if self.friction else seen

    def __str__(self) -> str:
        told = []
        if self.dead_band:
            behind = f" and has play within {self.play:.3g}" if self.play else ""
            told.append(f"the actuator {'sticks' if self.slip else 'has play'} within {self.dead_band:.3g}{behind}")
        if math.isfinite(self.rate):
            told.append(f"the actuator may be as slow as {self.rate:.3g} a second")
        told += [f"the control is felt {side} {at:.4g} only" for side, at in (("above", self.low), ("below", self.high))
                 if math.isfinite(at)]  # fmt: skip
        if self.bend:
            told.append(f"the gain changes by {100.0 * 2.0 * self.bend:.3g} % per unit of the measurement")
        if self.friction:
            told.append(str(self.friction))
        return ", ".join(told)


class Stem:
    """What the actuator of one process makes of a control, from one tick to the next; at 0 first.

    Examples
    --------
    >>> stem = Stem(Flaws(dead_band=1.0, play=0.3))
    >>> [stem.step(control) for control in (0.8, 1.5, 0.6, 0.4)]
    [0.0, 1.2, 1.2, 0.7]
    """

    def __init__(self, flaws: Flaws) -> None:
        self._low, self._high, self._band = float(flaws.low), float(flaws.high), float(flaws.dead_band)
        self._behind, self._play = (1.0 - float(flaws.slip)) * self._band, float(flaws.play)
        self._stem = self._felt = 0.0

    def step(self, control: float) -> float:
        """What is felt of a control."""
        limited = min(max(control, self._low), self._high)
        away = limited - self._stem
        if abs(away) > self._band:
            self._stem = limited - math.copysign(self._behind, away)
        self._felt = min(max(self._felt, self._stem - self._play), self._stem + self._play)
        return self._felt


def slewed(time: Floats, control: Floats, rates: Floats) -> Floats:
    """Where actuators of such speed are on average from each instant to the next; first at the first control.

    Parameters
    ----------
    time, control : ndarray, shape (n,)
        [s], and what is held from each instant to the next.
    rates : ndarray, shape (m,)
        [1/s], infinite for none.

    Returns
    -------
    ndarray, shape (m, n)

    Examples
    --------
    >>> slewed(np.arange(4.0), np.array([0.0, 3.0, 3.0, 1.0]), np.array([2.0, np.inf]))
    array([[0.  , 1.  , 2.75, 2.  ],
           [0.  , 3.  , 3.  , 1.  ]])
    """
    at = np.full(rates.size, control[0])
    felt = np.empty((control.size, rates.size))
    most = np.multiply.outer(np.diff(time, append=2.0 * time[-1] - time[-2]), rates)
    for mean, wanted, reach in zip(felt, control.tolist(), most, strict=True):
        away = wanted - at
        moved = np.clip(away, -reach, reach)
        mean[:] = at + moved * (1.0 - 0.5 * np.minimum(np.abs(away) / reach, 1.0))
        at = at + moved
    return np.ascontiguousarray(felt.T)


def joined(flaws: Sequence[Flaws]) -> Flaws:
    """Several, each of one process or of some, as one with arrays of shape (m,)."""
    rows = [np.broadcast_arrays(f.dead_band, f.slip, f.low, f.high, f.bend, f.began, f.play) for f in flaws]
    parts = [np.concatenate([np.ravel(row[i]) for row in rows]) for i in range(7)]
    band, slip, low, high, bend, began, play = parts
    return Flaws(band, slip, low, high, bend, flaws[0].centre, began, play=play)


def _column(value: Floats | float) -> Floats:
    return np.reshape(value, (-1, 1)) if np.ndim(value) else np.full((1, 1), value)
