"""An actuator that is slow, where a record speaks for one: a linear model takes it for lag, delay and a lesser gain.

How far it moves in a time is limited, which small moves hardly show. As for a dead band, what the process felt follows
from the recorded control and the limit alone; the linear part is fitted to that, and how well it fits says which limit
there is, if any.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from fopid_core.design.identification.coloured_noise import whitener
from fopid_core.design.identification.fit import Fit, fit
from fopid_core.design.identification.flaws import Flaws, slewed
from fopid_core.design.identification.identified_model import IdentifiedModel
from fopid_core.design.identification.quality import correlation_time
from fopid_core.design.identification.record import Record
from fopid_core.design.identification.response import RecordResponse
from fopid_core.model.arrays import Floats

RATES, NEARER = 14, np.geomspace(0.6, 1.6, 13)
"""So many are tried first, from what takes a tick for all that the control moved to what takes a quarter of the record;
and what lies about the best of those, and about the slowest that is possible."""
SPEAKS, PROOF = 8.0, 20.0
"""Twice the logarithm of the likelihood grows by so much with a limit where one is looked into, and by so much in the
end, with all that is learnt anew behind it, where it is believed: by chance never, over all that are tried. Stiction
and play together look a little like one."""
POSSIBLE, EXCLUDED = 4.0, 15.0
"""What loses less of that is as good; and what loses more is not so. A record that does not exclude even the slowest
that is tried knows nothing of actuators."""
WHITE_DOUBT = 20.0
"""By so much less counts what is left of the measurement made white, which knows of a few short pulses in a long record
that no model explains closely, and where the fits have not quite come to their ends."""
SHORTER = (1.0, 0.2)
"""A delay learnt without a limit holds what a slow actuator takes: fits begin with it, and with that share of it."""
FINE = 1.12
"""Ratio of the limits that are looked at first, with few evaluations each."""
_CELLS, _EVALUATIONS, _FIRST_LOOK, _TOLERANCE = 2048, 12, 3, 1e-4


def rate_limit_of(record: Record, learnt: IdentifiedModel, speaks: float = SPEAKS) -> Flaws | None:
    """The limit that explains what a model leaves, beside what was learnt; None where nothing speaks for one.

    It is the smallest that explains that about as well as the best, which is the safe side.

    Parameters
    ----------
    record : Record
        With moves as large as may be.
    learnt : IdentifiedModel
        From it, or from smaller moves, as if the actuator were as fast as one likes.
    speaks : float
        How clearly a record must speak for a limit, in twice the logarithm of the likelihood; with 0 the smallest is
        told that it leaves possible.
    """
    moved = float(np.ptp(record.control))
    if not moved or learnt.structure.runs_away:
        return None
    shortest, longest = record.sample_time, 0.25 * record.span
    rates = moved / np.geomspace(shortest, longest, RATES)
    if speaks == 0.0:
        scanned = moved / np.geomspace(shortest, longest, math.ceil(math.log(longest / shortest) / math.log(FINE)) + 2)
        rates = np.append(rates, _dips(record, learnt, scanned))
    tried = _behind(record, learnt, np.append(rates, math.inf))
    lost = _lost(tried)
    if lost[math.inf] < speaks or lost[min(lost)] <= EXCLUDED:
        return None
    best = min(tried, key=lambda rate: tried[rate].error)
    nearer = {float(rate) for about in {best, _slowest(tried)} - {math.inf} for rate in about * NEARER}
    tried |= _behind(record, learnt, np.array(sorted(nearer)))
    slowest = _slowest(tried)
    return replace(learnt.flaws, rate=slowest) if math.isfinite(slowest) else None


def left_behind(record: Record, learnt: IdentifiedModel, rate: float) -> float:
    """What is left of a record, a standard deviation, where its structure stands behind an actuator with this limit."""
    return _behind(record, learnt, np.array([rate]))[rate].error


def gained(before: Fit, after: Fit) -> float:
    """By how much twice the logarithm of the likelihood has grown from one fit of a record to another."""
    independent = after.residual.size / correlation_time(after.residual)
    return 2.0 * independent * math.log(max(before.error, 1e-300) / max(after.error, 1e-300))


def _slowest(tried: dict[float, Fit]) -> float:
    return min(rate for rate, lost in _lost(tried).items() if lost <= POSSIBLE)


def _lost(tried: dict[float, Fit]) -> dict[float, float]:
    """Twice the logarithm of the likelihood of each limit, less than that of the likeliest."""
    best = min(tried.values(), key=lambda found: found.error)
    white, count = whitener(best.residual), best.residual.size
    left = {rate: float(np.var(lfilter(white, np.ones(1), one.residual)[white.size :])) for rate, one in tried.items()}
    least = max(min(left.values()), 1e-300)
    lost = {
        rate: max(gained(one, best), count * math.log(max(left[rate], 1e-300) / least) / WHITE_DOUBT)
        for rate, one in tried.items()
    }
    likeliest = min(lost.values())
    return {rate: less - likeliest for rate, less in lost.items()}


def _dips(record: Record, learnt: IdentifiedModel, rates: Floats) -> Floats:
    """Of these limits those that explain more than both their neighbours: strong moves tell the right one sharply.

    Not where there is dry friction, which takes long to follow through each of them.
    """
    if learnt.flaws.friction:
        return np.empty(0)
    scanned = _behind(record, learnt, rates, (SHORTER[1],), _FIRST_LOOK)
    error = np.array([scanned[rate].error for rate in rates.tolist()])
    inner = (error[1:-1] < error[:-2]) & (error[1:-1] < error[2:])
    return rates[1:-1][inner]


def _behind(
    record: Record, learnt: IdentifiedModel, rates: Floats, delays: Sequence[float] = SHORTER,
    evaluations: int = _EVALUATIONS,
) -> dict[float, Fit]:  # fmt: skip
    """The structure, fitted to what actuators with these limits let through, from such shares of its delay on."""
    others = replace(learnt.flaws, rate=math.inf)
    return {
        rate: _fitted(others.of_record(replace(record, control=felt)), learnt, delays, evaluations)
        for rate, felt in zip(rates.tolist(), slewed(record.time, record.control, rates), strict=True)
    }


def _fitted(seen: Record, learnt: IdentifiedModel, delays: Sequence[float], evaluations: int) -> Fit:
    response = RecordResponse(seen, learnt.structure, learnt.start, _CELLS)
    rows = np.ones(response.time.size, dtype=bool)
    begins = [np.append(learnt.fitted.x[:-1], share * learnt.fitted.x[-1]) for share in delays]
    return min((fit(response, begin, rows, evaluations, _TOLERANCE) for begin in begins), key=lambda one: one.error)
