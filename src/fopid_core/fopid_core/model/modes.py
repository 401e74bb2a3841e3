"""Modes: what poles add to a signal, residue times exp(p t), with what is known of their errors."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fopid_core.model.arrays import Complexes, Floats
from fopid_core.model.poles import Poles

_CIRCLE = 24  # points about each pole: what lies five radii away then counts for less than rounding
_RADIUS = 0.2
_SAFETY = 2.0  # of a pole's error as it is estimated
_NEGLIGIBLE = 1e-18
LARGEST_EXPONENT = 600.0  # exp(700) overflows


@dataclass(frozen=True)
class Modes:
    """k signals, each the sum over poles of the real part of ``weight * residue * exp(p t)``.

    Attributes
    ----------
    poles : ndarray, shape (p,)
        Those with Im p >= 0; the conjugates are in ``residues`` twice over.
    shifts : ndarray, shape (p,)
        Estimated errors of the poles [1/s].
    residues, residue_errors : ndarray, shape (k, p)
        A pair's counted twice.
    """

    poles: Complexes
    shifts: Floats
    residues: Complexes
    residue_errors: Floats

    @staticmethod
    def of(transforms: Callable[[Complexes], Complexes], found: Poles, keep_away: Floats) -> Modes:
        """Residues by the trapezoid rule on two circles about each pole; where these differ, that is the error.

        ``keep_away`` [1/s], shape (p,), is how far each is from what is not among them.
        """
        poles = found.values
        everything = np.concatenate((poles, poles[poles.imag > 0.0].conj(), [0.0]))
        distance = np.abs(poles[:, None] - everything)
        distance[distance == 0.0] = np.inf
        radius = _RADIUS * np.minimum(distance.min(axis=1, initial=np.inf), keep_away)
        turns = np.exp(2j * math.pi * (np.arange(_CIRCLE) + 0.5) / _CIRCLE)
        residues, moments = [], []
        for share in (1.0, 0.6):
            circle = (share * radius)[:, None] * turns
            values = transforms((poles[:, None] + circle).ravel()).reshape(2, *circle.shape)
            residues.append((values * circle).mean(axis=-1))
            moments.append((values * circle**2).mean(axis=-1))
        main, other = residues
        with np.errstate(divide="ignore", invalid="ignore"):
            seen = np.where(np.abs(main) > 0.0, np.abs(moments[1] / main), 0.0)
        strongest = np.argmax(np.abs(main), axis=0)
        shifts = _SAFETY * np.maximum(found.shifts, np.take_along_axis(seen, strongest[None], axis=0)[0])
        shifts += np.finfo(float).eps * np.abs(poles)  # of the pole as a number and of its product with time
        twice = np.where(poles.imag > 0.0, 2.0, 1.0)
        main = np.where(poles.imag == 0.0, main.real, main)
        return Modes(poles, shifts, twice * main, twice * (np.abs(main - other) + 1e-15 * np.abs(main)))

    def transform(self, s: Complexes) -> Complexes:
        """Shape (k, m)."""
        total = np.zeros((self.residues.shape[0], s.size), dtype=np.complex128)
        for i, p in enumerate(self.poles):
            if p.imag == 0.0:
                total += self.residues[:, i, None] / (s - p)
            else:
                half = 0.5 * self.residues[:, i, None]
                total += half / (s - p) + half.conj() / (s - p.conjugate())
        return total

    def transform_error(self, s: Complexes) -> Floats:
        """The estimated error of ``transform``, shape (k, m)."""
        total = np.zeros((self.residues.shape[0], s.size))
        for i, p in enumerate(self.poles):
            near = 1.0 / np.abs(s - p)
            total += self.residue_errors[:, i, None] * near
            total += np.abs(self.residues[:, i, None]) * (self.shifts[i] * near**2)
        return total

    def at(self, time: Floats) -> Floats:
        """The signals, shape (k, n)."""
        total = np.zeros((self.residues.shape[0], time.size))
        for i, p in enumerate(self.poles):
            alive = time if p.real >= 0.0 else time[: self._life(i, time)]
            wave = np.exp(p * alive)
            for row, residue in zip(total, self.residues[:, i], strict=True):
                row[: alive.size] += residue.real * wave.real - residue.imag * wave.imag
        return total

    def error_at(self, time: Floats) -> Floats:
        """The estimated error of ``at``, shape (k, n)."""
        total = np.zeros((self.residues.shape[0], time.size))
        for i, p in enumerate(self.poles):
            decay = np.exp(np.minimum(p.real * time, LARGEST_EXPONENT))
            drift = np.minimum(self.shifts[i] * time, 2.0)
            total += np.abs(self.residues[:, i, None]) * (decay * drift) + self.residue_errors[:, i, None] * decay
        return total

    def at_infinity(self, count: int) -> Floats:
        """The coefficients of 1/s, 1/s^2, ... of the transforms, shape (k, count)."""
        powers = self.poles[:, None] ** np.arange(count)
        return np.asarray((self.residues @ powers).real)

    def fastest(self, time: float, level: float) -> float:
        """The highest frequency [rad/s] still above a level at an instant; 0 when none is."""
        size = np.log(np.abs(self.residues).max(axis=0, initial=1e-300)) + self.poles.real * time
        alive = np.abs(self.poles)[size > math.log(level)]
        return float(alive.max(initial=0.0))

    def _life(self, i: int, time: Floats) -> int:
        """How many of the rising instants come before the mode has died out."""
        size = max(float(np.abs(self.residues[:, i]).max()), 1e-300)
        return int(np.searchsorted(time, math.log(size / _NEGLIGIBLE) / -float(self.poles[i].real)))
