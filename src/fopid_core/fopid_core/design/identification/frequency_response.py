"""The frequency response that records show without a model of the process, with regions of confidence.

The measurement is predicted from its own past and the control's by least squares, over a memory so long that what it
leaves out is far below the noise:

    y_k = sum over j of a_j y_(k-j) + b_j u_(k-j)  +  offset + ramp k + e_k,    G = b(z) / (1 - a(z)).

The memory takes up the colour of the noise, which is why feedback is no error (the direct method), and since the past
is known, nothing of the beginning leaks into the response. Akaike's criterion balances what a memory leaves out and
its noise; a region of confidence counts the noise only, so that twice the memory is taken.

Of a long record the distant past counts in sums over some lags. It is never thinned out: a mean over several controls
has answered measurements that the thinned record does not show, which is an error in a loop. Of very many equations
some are added up with random signs, so that the noise of one stays independent of the past of another (a sketch:
Clarkson and Woodruff, Journal of the ACM 63 (2017) 54).

References
----------
Ljung, System Identification, 2nd ed. (1999), ch. 9.4 and 13.4; Ljung and Wahlberg, Advances in Applied Probability 24
(1992) 412-440; Hurvich and Tsai, Biometrika 76 (1989) 297-307;
Berk, Annals of Statistics 2 (1974) 489-502; Fieller, Journal of the Royal Statistical Society B 16 (1954) 175-185.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import fdtri

from fopid_core.design.identification.feedback import moved_from_outside
from fopid_core.design.identification.record import FEWEST_SAMPLES, Record
from fopid_core.design.identification.response import InitialCondition
from fopid_core.design.identification.sensor_faults import sound
from fopid_core.design.sampled_loop import sampled_process
from fopid_core.errors import InputError
from fopid_core.model.arrays import Booleans, Complexes, Floats, Indexes
from fopid_core.model.process import Process

CONFIDENCE = 0.95
POINTS = 24
TELLS = 0.5
"""A response whose region is wider than this share of its size is not known."""
BEYOND = 0.05
"""A model leaves a region when it is further out than this share of the response, besides."""
FEWEST, SHARE = 3, 0.3
"""So many frequencies must be left, and such a share of those known, for its structure to be wrong."""
_FINE, _REACH = 16, 10
"""A sum of lags lies at least so many times further back than its number of them, and none further than one part in so
many of the record: a memory that is short beside what the process takes shows the controller instead, -1/C."""
_ROWS, _BLOCK = 16_384, 8192
"""More equations than this are added up by some; so many are looked at at once."""
_DENSEST = 8192
"""Frequencies end where they would with so many samples: a longer record has finer ones."""
_ENOUGH = 4
"""Of many pieces the longest, until they hold so many times that."""
_LONGER, _LEAST_MEMORY = 2, 16
"""The memory is so many times what the criterion asks, and at least one part in so many of the record."""
_EACH, _LONGEST = 6, 150
"""Samples for each step of the memory, at least; and steps, at most."""
_PERIODS, _HIGHEST = 4.0, 0.8
"""From so many periods in the longest record to this share of half the sample rate."""
_GAP, _UNEVEN = 1.7, 0.3
"""A distance of so many usual ones is a gap, which ends a piece; no sample may be further from its place than this."""
_DEPENDENT, _EXACT = 1e-9, 1e-12
_COLUMNS = 2  # offset and ramp, of each piece


@dataclass(frozen=True)
class FrequencyResponse:
    """The response of the process behind the hold of its control, sampled; arrays of shape (n,).

    Attributes
    ----------
    frequency : ndarray
        [rad/s], ascending.
    response : ndarray of complex
        The centre of the disc that holds it; NaN where it is not known.
    radius : ndarray
        Of the disc about each that holds the true response in 95 of 100 records; infinite where it is not known.
    sample_time : float
        [s]
    memory : int
        Of the predictor, in sample times.
    reason : str
        Why nothing is known; or nothing.

    References
    ----------
    For what sampling makes of a process: `fopid_core.design.sampled_loop.sampled_process`.
    """

    frequency: Floats
    response: Complexes
    radius: Floats
    sample_time: float
    memory: int
    reason: str = ""

    @property
    def known(self) -> Booleans:
        """Where the region is narrow enough to tell something."""
        return np.isfinite(self.radius)

    def model(self, process: Process) -> Complexes:
        """The same of a model."""
        return self.at(process, self.frequency)

    def at(self, process: Process, frequency: Floats) -> Complexes:
        """The same of a model, at other frequencies [rad/s]."""
        return sampled_process(process, self.sample_time, frequency * self.sample_time)

    def outside(self, process: Process, beyond: float = 0.0) -> Booleans:
        """Where the response is known and a model leaves its region, by more than a share of the response."""
        size = np.where(self.known, np.abs(self.response), 0.0)
        near = np.where(self.known, np.abs(self.model(process) - self.response), 0.0)
        return np.asarray(near > np.where(self.known, self.radius, 0.0) + beyond * size)


def frequency_response(records: Record | Sequence[Record], points: int = POINTS) -> FrequencyResponse:
    """Estimate the frequency response from one record or several of the same process, open or closed loop.

    Parameters
    ----------
    records : Record or sequence of Record
        Of one sample time. A gap in the samples ends a piece, and each piece has an operating point and a drift of its
        own. Where a sensor reads more seldom than that, its readings count.
    points : int
        How many frequencies, in equal ratios.

    Raises
    ------
    InputError
        If there is no record, or the sample times differ.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> control, noise = rng.standard_normal(600), 0.1 * rng.standard_normal(600)
    >>> measured = np.zeros(600)
    >>> for k in range(599):
    ...     measured[k + 1] = 0.9 * measured[k] + 0.1 * control[k]
    >>> found = frequency_response(Record(np.arange(600.0), control, measured + noise))
    >>> true = 0.1 / (np.exp(1j * found.frequency) - 0.9)
    >>> inside = np.abs(found.response - true)[found.known] <= found.radius[found.known]
    >>> bool(found.known.mean() > 0.5), bool(inside.mean() > 0.8)
    (True, True)
    """
    several = [sound(record)[0] for record in ([records] if isinstance(records, Record) else records)]
    if not several:
        raise InputError("no records; allowed: one or more")
    usual = [float(np.median(np.diff(record.time))) for record in several]
    if max(usual) > 1.05 * min(usual):
        raise InputError(f"records with sample times {min(usual):.4g} to {max(usual):.4g} s; allowed: the same of all")
    pieces = _most([piece for record in several for piece in _pieces(record)])
    longest = pieces[0].time.size
    h = pieces[0].sample_time
    lags = _lags(longest)
    highest = _HIGHEST * np.pi / (h * max(longest / _DENSEST, 1.0))
    frequency = np.geomspace(2.0 * np.pi * _PERIODS / (longest * h), highest, points)
    reason = _unfit(several, pieces)
    signals = [(piece.measurement - piece.measurement.mean(), piece.control - piece.control.mean()) for piece in pieces]
    memory = 0 if reason else _memory(signals, lags)
    if not memory:
        little = f"the control moves too little after the first {max(longest // _LEAST_MEMORY, 1)} samples"
        return _nothing(frequency, h, reason or f"{little}, or its moves follow from each other")
    response, radius = _estimate(signals, lags[: memory + 1], frequency * h)
    known = radius < TELLS * np.abs(response)
    return FrequencyResponse(
        frequency, np.where(known, response, complex(np.nan, np.nan)), np.where(known, radius, np.inf),
        h, int(lags[memory]) - 1, "" if known.any() else "the noise hides it at all frequencies",
    )  # fmt: skip


def contradicts(response: FrequencyResponse, process: Process, share: float = SHARE) -> str:
    """How a model contradicts the response without one, at more than a share of the frequencies; empty otherwise."""
    outside, known = int(response.outside(process, BEYOND).sum()), int(response.known.sum())
    if outside <= max(FEWEST, share * known):
        return ""
    return f"the model leaves what the record shows without one at {outside} of {known} frequencies"


def _nothing(frequency: Floats, h: float, reason: str) -> FrequencyResponse:
    nowhere = np.full(frequency.size, np.inf)
    return FrequencyResponse(frequency, np.full(frequency.size, complex(np.nan, np.nan)), nowhere, h, 0, reason)


def _unfit(records: Sequence[Record], pieces: Sequence[Record]) -> str:
    """Why no response can be estimated, whatever the signals do; or nothing."""
    for piece in pieces:
        even = np.linspace(piece.time[0], piece.time[-1], piece.time.size)
        if np.abs(piece.time - even).max() > _UNEVEN * piece.sample_time:
            return "the samples are uneven"
    if not any(moved_from_outside(record, InitialCondition(step=True)) for record in records):
        return "the control only answers the measurement"
    return ""


def _pieces(record: Record) -> list[Record]:
    """The record between its gaps; of pieces too short to say anything the longest."""
    steps = np.diff(record.time)
    ends = np.flatnonzero(steps > _GAP * np.median(steps)) + 1
    if not ends.size:
        return [record]
    edges = np.concatenate([[0], ends, [record.time.size]])
    enough = [(a, b) for a, b in pairwise(edges.tolist()) if b - a >= FEWEST_SAMPLES]
    return [record.part(float(record.time[a]), float(record.time[b - 1])) for a, b in enough] or [record]


def _most(pieces: Sequence[Record]) -> list[Record]:
    """The longest of many pieces, with as many samples as tell enough, the longest first."""
    ordered = sorted(pieces, key=lambda piece: -piece.time.size)
    before = np.cumsum([0, *(piece.time.size for piece in ordered[:-1])])
    allowed = _ENOUGH * max(_DENSEST, ordered[0].time.size)
    return [piece for piece, samples in zip(ordered, before, strict=True) if samples < allowed]


def _lags(longest: int) -> Indexes:
    """Where the steps of the longest memory begin, and where the last one ends, in samples back."""
    if longest <= _LEAST_MEMORY * _LONGEST:
        return np.arange(1, _LONGEST + 2)
    lags = [1]
    while lags[-1] < longest // _REACH:
        lags.append(lags[-1] + max(lags[-1] // _FINE, 1))
    return np.array(lags)


def _regression(signals: Sequence[tuple[Floats, Floats]], lags: Indexes) -> tuple[Floats, Floats, int]:
    """Y and u from the last sample back and what they are to predict, in columns; their lengths; columns left out.

    The offset and the ramp of each piece are taken out of the others, which are at unit length before that: as if they
    were columns as well (Frisch and Waugh, Econometrica 1, 1933).
    """
    reach = int(lags[-1]) - 1
    kept = [(y, u) for y, u in signals if y.size > reach]
    fold = -(-sum(y.size - reach for y, _ in kept) // _ROWS)
    rows, squares = [], np.zeros(2 * lags.size - 1)
    for y, u in kept:
        sums = [np.concatenate([[0.0], np.cumsum(signal)]) for signal in (y, u)]
        piece = np.concatenate([_equations(y, sums, lags, at, fold) for at in _blocks(reach, y.size, fold)])
        squares += np.einsum("ij,ij->j", piece[:, _COLUMNS:], piece[:, _COLUMNS:])
        own = np.linalg.qr(piece[:, :_COLUMNS])[0]
        rows.append(piece[:, _COLUMNS:] - own @ (own.T @ piece[:, _COLUMNS:]))
    sizes = np.maximum(np.sqrt(squares), 1e-300)
    return np.concatenate(rows) / sizes, sizes, _COLUMNS * len(kept)


def _blocks(first: int, end: int, fold: int) -> list[Indexes]:
    """The samples to be predicted, some thousands at once."""
    size = -(-_BLOCK // fold) * fold
    return [np.arange(begin, min(begin + size, end)) for begin in range(first, end, size)]


def _equations(y: Floats, sums: Sequence[Floats], lags: Indexes, at: Indexes, fold: int) -> Floats:
    """Offset, ramp, the past in the order of its lag and what it is to predict; added up by ``fold`` in each row.

    The sums of y and u before each sample tell the past.
    """
    begins = at[:, np.newaxis] + 1 - lags
    past = [-np.diff(one[begins], axis=1) for one in sums]
    own = np.vander(2.0 * at / y.size - 1.0, _COLUMNS)
    equations = np.concatenate([own, np.stack(past, axis=2).reshape(at.size, -1), y[at, np.newaxis]], axis=1)
    if fold == 1:
        return equations
    signs = np.random.default_rng(int(at[0])).choice([-1.0, 1.0], at.size)
    return np.add.reduceat(equations * signs[:, np.newaxis], np.arange(0, at.size, fold), axis=0)


def _triangle(signals: Sequence[tuple[Floats, Floats]], lags: Indexes) -> tuple[Floats, Floats, int, int]:
    """R of the regression's columns, their lengths, how many rows there are, and how many columns are not here."""
    matrix, sizes, own = _regression(signals, lags)
    triangle: Floats = np.linalg.qr(matrix, mode="r")  # type: ignore[assignment]
    return triangle, sizes, matrix.shape[0], own


def _memory(signals: Sequence[tuple[Floats, Floats]], lags: Indexes) -> int:
    """How many steps the predictor looks back; 0 where the signals bear none.

    The columns stand in the order of their lag, so that one factorisation tells what every shorter memory leaves.
    """
    lengths = np.array([y.size for y, _ in signals])
    longest = int(lengths.max())
    tried = np.arange(1, min(longest // 2, lags.size - 1) + 1)
    rows = np.minimum(np.maximum(lengths[:, np.newaxis] - lags[tried] + 1, 0).sum(axis=0), _ROWS)
    bearable = tried[rows >= _EACH * tried + _COLUMNS * len(signals)]
    if not bearable.size:
        return 0
    most = int(bearable[-1])
    triangle, _, count, own = _triangle(signals, lags[: max(most // _LONGER, 1) + 1])
    left = np.cumsum(triangle[::-1, -1] ** 2)[::-1]
    numbers = np.arange(2, triangle.shape[1], 2)
    independent = np.minimum.accumulate(np.abs(np.diag(triangle)[:-1]))[numbers - 1] > _DEPENDENT
    if not independent[0]:
        return 0
    numbers = numbers[independent]
    learnt = numbers + own
    criterion = count * np.log(np.maximum(left[numbers], 1e-300)) + 2.0 * learnt * count / (count - learnt - 1)
    asked = int(np.argmin(criterion)) + 1
    wished = min(max(_LONGER * asked + 2, longest // _LEAST_MEMORY), most)
    if independent.all() or wished <= numbers.size:
        return wished
    return numbers.size if left[numbers[-1]] <= _EXACT else 0  # without noise a short memory leaves nothing out


def _estimate(signals: Sequence[tuple[Floats, Floats]], lags: Indexes, theta: Floats) -> tuple[Complexes, Floats]:
    """The response at z = exp(j theta), and the radius of the disc about it."""
    triangle, sizes, count, own = _triangle(signals, lags)
    size = sizes.size - 1
    if np.abs(np.diag(triangle)[:size]).min() <= _DEPENDENT:
        return np.full(theta.size, np.nan + 0j), np.full(theta.size, np.inf)
    root = solve_triangular(triangle[:size, :size], np.eye(size)) / sizes[:size, np.newaxis]
    numbers = root @ triangle[:size, -1] * sizes[-1]
    level = abs(float(triangle[-1, -1])) * float(sizes[-1]) / np.sqrt(count - own - size)
    a, b = numbers[::2], numbers[1::2]
    delays = np.add.reduceat(np.exp(-1j * np.outer(theta, np.arange(1, lags[-1]))), lags[:-1] - 1, axis=1)
    denominator, numerator = 1.0 - delays @ a, delays @ b
    moved = level * np.stack([np.zeros_like(delays), delays], axis=2).reshape(theta.size, -1) @ root
    turned = level * np.stack([-delays, np.zeros_like(delays)], axis=2).reshape(theta.size, -1) @ root
    memory = int(lags[-1]) - 1
    freedom = sum(max(y.size - memory, 0) for y, _ in signals) / memory
    return _disc((numerator, moved), (denominator, turned), freedom)


def _disc(
    numerator: tuple[Complexes, Complexes], denominator: tuple[Complexes, Complexes], freedom: float
) -> tuple[Complexes, Floats]:
    """The disc that holds the true ratio: its centre and its radius, which is infinite where no bounded one does.

    Both come with the independent parts of their errors, of shape (frequencies, parts). Whatever the true ratio G, the
    error of numerator - G denominator is normal, also where that of the ratio is not (Fieller 1954): where feedback
    hides the process, the denominator may be zero, and the ratio comes out near the controller's -1/C.

    The noise's power at a frequency is itself an estimate: by a predictor with so many numbers to learn its colour it
    has no more degrees of freedom than there are memories in the records (Berk 1974).
    A square of an error is a sum of two chi-squared variables, of the variances along the axes of the ellipse, and near
    to one with between one and two degrees of freedom (Satterthwaite 1946): exact for a line and for a circle.
    """
    (above, of_above), (below, of_below) = numerator, denominator
    ratio = above / below
    parts = of_above - ratio[:, np.newaxis] * of_below
    power = np.sum(np.abs(parts) ** 2, axis=1)
    eccentric = np.abs(np.sum(parts**2, axis=1))  # the difference of the two variances
    degrees = 2.0 * power**2 / (power**2 + eccentric**2)
    sure = fdtri(degrees, freedom, CONFIDENCE)
    bounded = np.abs(below) ** 2 - sure * np.sum(np.abs(of_below) ** 2, axis=1)
    middle = above * below.conj() - sure * np.sum(of_above * of_below.conj(), axis=1)
    last = np.abs(above) ** 2 - sure * np.sum(np.abs(of_above) ** 2, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        centre = middle / bounded
        radius = np.sqrt(np.maximum(np.abs(centre) ** 2 - last / bounded, 0.0))
    return np.where(bounded > 0.0, centre, ratio), np.asarray(np.where(bounded > 0.0, radius, np.inf))
