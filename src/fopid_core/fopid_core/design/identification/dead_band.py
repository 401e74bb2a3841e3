"""An actuator that sticks or has play, where a record speaks for one: a linear model takes it for lag and delay.

The stem follows the recorded control alone, so that for a given dead band what the process felt is known, and its
linear part is fitted to that as to any control. How well it fits then says which dead band there is, if any.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from fopid_core.design.identification.fit import Fit, fit
from fopid_core.design.identification.flaws import Flaws
from fopid_core.design.identification.identified_model import IdentifiedModel
from fopid_core.design.identification.quality import correlation_time
from fopid_core.design.identification.record import Record
from fopid_core.design.identification.response import MOST_CELLS, RecordResponse

STICKS, HAS_PLAY = 1.0, 0.0
SIZES = {STICKS: np.geomspace(0.01, 0.3, 240), HAS_PLAY: np.geomspace(0.01, 0.3, 60)}
"""Dead bands that are tried first, as shares of the control's range in the record: where the actuator jumps, those that
fit lie in narrow valleys."""
PROMISING, NEARER = 6, (0.975, 0.985, 0.99, 0.995, 1.005, 1.01, 1.015, 1.025)
"""So many of them are looked at more closely, and what lies about the best of those, in shares of it."""
PROOF = 30.0
"""Twice the logarithm of the likelihood grows by so much with a dead band: by chance never, over all that are tried."""
LEAST_EXPLAINED = 0.1
"""Share of what a linear model leaves of the measurement that a dead band must explain to be worth a word."""
HARDLY_FITS = 99.8
"""A model that explains so much [%] leaves no room for one."""
MOST_SAMPLES = MOST_CELLS
"""In longer records, whose samples are averaged to be fitted, none is looked for: averages hide by what it is known."""
_FIRST_LOOK, _CLOSER, _LAST = (8, 512, 2), (4, 1024, 12), (1, MOST_CELLS, 12)
"""Of how many samples one is fitted, but no fewer than so many, and by how many evaluations."""
_TOLERANCE = 1e-4


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
    bands = [(share * whole, slip) for slip, shares in SIZES.items() for share in shares.tolist()]
    looked = _behind(record, learnt, bands, *_FIRST_LOOK)
    tried = _behind(record, learnt, sorted(bands, key=lambda band: looked[band].error)[:PROMISING], *_CLOSER)
    size, slip = min(tried, key=lambda band: tried[band].error)
    tried |= _behind(record, learnt, [(share * size, slip) for share in NEARER], *_CLOSER)
    size, slip = min(tried, key=lambda band: tried[band].error)
    without, within = _behind(record, learnt, [(0.0, slip), (size, slip)], *_LAST).values()
    if within.error > (1.0 - LEAST_EXPLAINED) * without.error:
        return None
    independent = within.residual.size / correlation_time(within.residual)
    if 2.0 * independent * math.log(without.error / max(within.error, 1e-300)) < PROOF:
        return None
    return Flaws(dead_band=size, slip=slip)


def _behind(
    record: Record, learnt: IdentifiedModel, bands: list[tuple[float, float]], each: int, least: int, evaluations: int
) -> dict[tuple[float, float], Fit]:
    """The structure, fitted to what actuators with these dead bands let through."""
    cells = max(record.time.size // each, least)
    sizes, slips = np.array(bands).T
    fits = {}
    for band, felt in zip(bands, Flaws(dead_band=sizes, slip=slips).felt(record.control), strict=True):
        response = RecordResponse(replace(record, control=felt), learnt.structure, learnt.start, cells)
        rows = np.ones(response.time.size, dtype=bool)
        fits[band] = fit(response, learnt.fitted.x, rows, evaluations, _TOLERANCE)
    return fits
