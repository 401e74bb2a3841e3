"""An actuator that sticks or has play, where a record speaks for one: a linear model takes it for lag and delay.

The stem follows the recorded control alone, so that for a given dead band what the process felt is known, and its
linear part is fitted to that as to any control. How well it fits then says which dead band there is, if any.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fopid_core.design.identification.fit import Fit, fit
from fopid_core.design.identification.flaws import Flaws
from fopid_core.design.identification.identified_model import IdentifiedModel
from fopid_core.design.identification.rate_limit import gained
from fopid_core.design.identification.record import Record
from fopid_core.design.identification.response import MOST_CELLS, RecordResponse

STICKS, HAS_PLAY = 1.0, 0.0
SIZES = {STICKS: np.geomspace(0.01, 0.3, 240), HAS_PLAY: np.geomspace(0.01, 0.3, 60)}
"""Dead bands that are tried first, as shares of the control's range in the record: where the actuator jumps, those that
fit lie in narrow valleys."""
PROMISING, NEARER = 6, (0.975, 0.985, 0.99, 0.995, 1.005, 1.01, 1.015, 1.025)
"""So many of them are looked at more closely, and what lies about the best of those, in shares of it."""
VALLEYS, PLAYS, NEARER_PLAY = 4, np.geomspace(0.05, 1.0, 9), (0.75, 0.85, 0.93, 1.08, 1.17, 1.3)
"""The best of the valleys are tried with play behind, in shares of what sticks, and so is what lies about the best."""
PROOF = 30.0
"""Twice the logarithm of the likelihood grows by so much with a dead band: by chance never, over all that are tried."""
LEAST_EXPLAINED = 0.1
"""Share of what a linear model leaves of the measurement that a dead band must explain to be worth a word."""
HARDLY_FITS = 99.8
"""A model that explains so much [%] leaves no room for one."""
MOST_SAMPLES = 4 * MOST_CELLS
"""In longer records none is looked for: averages of so many samples hide by what it is known."""
_FIRST_LOOK, _CLOSER, _LAST = (8, 512, 2), (4, 1024, 12), (1, MOST_CELLS, 12)
"""Of how many samples one is fitted, but no fewer than so many, and by how many evaluations."""
_TOLERANCE, _ROUNDS = 1e-4, 2


class _Band(NamedTuple):
    """An actuator's flaw: how far it sticks (slip 1) or has play (0), and the play behind what sticks."""

    size: float
    slip: float
    play: float = 0.0


def dead_band_of(record: Record, learnt: IdentifiedModel) -> Flaws | None:
    """The dead band that explains what a linear model leaves of a record; None where nothing speaks for one clearly.

    Parameters
    ----------
    record : Record
    learnt : IdentifiedModel
        From it, as if the actuator had none.
    """
    whole = float(np.ptp(record.control))
    if not whole or record.time.size > MOST_SAMPLES:
        return None
    if learnt.whiteness.white or learnt.fit_pct >= HARDLY_FITS or learnt.structure.runs_away:
        return None
    bands = [_Band(share * whole, slip) for slip, shares in SIZES.items() for share in shares.tolist()]
    looked = _behind(record, learnt, bands, *_FIRST_LOOK)
    both = _behind(record, learnt, _with_play(looked), *_FIRST_LOOK)
    tried = [_Band(0.0, STICKS), _nearest(record, learnt, looked), *([_nearest(record, learnt, both)] if both else [])]
    fits = _behind(record, learnt, tried, *_LAST)
    found = tried[0]
    for band in tried[1:]:
        found = band if _is_clear(fits[found], fits[band]) else found
    return Flaws(dead_band=found.size, slip=found.slip, play=found.play) if found.size else None


def _nearest(record: Record, learnt: IdentifiedModel, looked: dict[_Band, Fit]) -> _Band:
    """The best of these, looked at more closely, and of what lies about it."""
    tried = _behind(record, learnt, sorted(looked, key=lambda band: looked[band].error)[:PROMISING], *_CLOSER)
    for _ in range(_ROUNDS):
        size, slip, play = min(tried, key=lambda band: tried[band].error)
        nearer = [_Band(share * size, slip, play) for share in NEARER]
        nearer += [_Band(size, slip, share * play) for share in NEARER_PLAY if play]
        tried |= _behind(record, learnt, nearer, *_CLOSER)
        if not play:
            break
    return min(tried, key=lambda band: tried[band].error)


def _is_clear(before: Fit, after: Fit) -> bool:
    """Whether one fit explains more than another by what is worth a word and no chance."""
    return after.error <= (1.0 - LEAST_EXPLAINED) * before.error and gained(before, after) >= PROOF


def _with_play(looked: dict[_Band, Fit]) -> list[_Band]:
    """Those that stick and fit better than their neighbours, with play behind."""
    sticks = [band for band in looked if band.slip == STICKS]
    errors = [looked[band].error for band in sticks]
    valleys = [i for i in range(1, len(sticks) - 1) if errors[i] <= min(errors[i - 1], errors[i + 1])]
    best = sorted(valleys, key=errors.__getitem__)[:VALLEYS]
    return [_Band(sticks[i].size, STICKS, share * sticks[i].size) for i in best for share in PLAYS.tolist()]


def _behind(
    record: Record, learnt: IdentifiedModel, tried: Iterable[_Band], each: int, least: int, evaluations: int
) -> dict[_Band, Fit]:
    """The structure, fitted to what actuators with these dead bands let through."""
    cells = max(record.time.size // each, least)
    bands = list(dict.fromkeys(tried))
    if not bands:
        return {}
    sizes, slips, plays = np.array(bands).T
    fits = {}
    for band, felt in zip(bands, Flaws(dead_band=sizes, slip=slips, play=plays).felt(record.control), strict=True):
        response = RecordResponse(replace(record, control=felt), learnt.structure, learnt.start, cells)
        rows = np.ones(response.time.size, dtype=bool)
        fits[band] = fit(response, learnt.fitted.x, rows, evaluations, _TOLERANCE)
    return fits
