"""What a record says of its sensor: the noise where it rests, and the step in which it is quantised."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import detrend

from fopid_core.design.identification.noise_spectrum import NoiseSpectrum, noise_spectrum
from fopid_core.design.identification.record import Record
from fopid_core.model.arrays import Floats, Indexes

_BLOCKS, _SHORTEST, _LONGEST = 20, 16, 200
"""A record is looked at in so many blocks, each of so many samples at least and at most."""
_STILL = 1.5
"""A block rests when it spreads by no more than so many times its noise."""
_WHOLE = 1e-3
_NOTHING_ELSE = 1.05
"""Noise of no more than so many times what steps make is made by them."""
_FLICKERS, _MOVES_AT_REST = 0.02, 0.03
"""Unless at more than this share of the ticks a signal goes there and back three times in a row, as noise of a seventh
of the step makes it go, and so shows where between two steps it is, on the average; and moves at that share of the
ticks at rest, where a lively loop that hunts about a step is not."""
_FEWEST, _LEVEL = 100, 1.2
"""So many samples show a spectrum; they rest where a line through them takes no more of their spread than that."""

FAR_OFF, MAD, FEW = 10.0, 1.4826, 0.05
"""A value that is so many standard deviations off the others, these told from the median distance, is no noise; such a
share of all may be."""
_DROPPED, _BACK, _SEEN, _USUAL_RANGE = 5, 0.2, 0.1, (5.0, 95.0)
"""So many samples in a row may drop out: they jump by `FAR_OFF` and by a share of the measurement's range between these
per cent of it, stay there, and come back to where they were but for a share of the jump."""
_FEWEST_REPORTS, _ALIKE = 10, 1.5
"""A measurement told by exception shows so many moves, half of them no larger than so many times the least."""
_OUTLYING = 5
"""So many samples are compared to tell one that is far off both before and after it."""


@dataclass(frozen=True)
class SensorNoise:
    """The noise of a measurement.

    Attributes
    ----------
    level : float
        Standard deviation, quantisation included; NaN where the measurement nowhere rests.
    step : float
        In which it is quantised, or by which it has to move to be told; 0 where nothing speaks for one.
    spectrum : NoiseSpectrum or None
        None where it may be white.
    """

    level: float
    step: float
    spectrum: NoiseSpectrum | None = None

    @property
    def at_rest(self) -> bool:
        """Whether it could be measured at rest."""
        return not math.isnan(self.level)


def sensor_noise(record: Record) -> SensorNoise:
    """The noise in those stretches of a record in which the measurement does nothing else.

    Where it rests until somebody moves it, and what it does there is not white, that stretch alone counts. Samples that
    drop out are no noise.

    Examples
    --------
    >>> time = np.arange(0.0, 60.0, 0.1)
    >>> noise = 0.01 * np.random.default_rng(0).standard_normal(600)
    >>> moved = np.where(time < 30.0, 0.0, 1.0 - np.exp(-0.3 * (time - 30.0)))
    >>> found = sensor_noise(Record(time, time >= 30.0, moved + noise))
    >>> round(found.level, 3), found.step
    (0.01, 0.0)
    """
    measured, dropped = bridged(record.measurement)
    record, step = replace(record, measurement=measured) if dropped.size else record, reported_step(measured)
    rest = _before_the_first_move(record)
    coloured = noise_at_rest(rest, record.sample_time) if rest is not None else None
    if coloured is not None:
        return coloured
    each = min(max(measured.size // _BLOCKS, _SHORTEST), _LONGEST)
    blocks = measured[: measured.size // each * each].reshape(-1, each)
    levels = white_level(blocks)
    still = (np.std(blocks, axis=1) <= _STILL * levels) | (np.ptp(blocks, axis=1) == 0.0)
    if not still.any():
        return SensorNoise(math.nan, step)
    return SensorNoise(max(float(np.sqrt(np.mean(levels[still] ** 2))), step / math.sqrt(12.0)), step)


def noise_at_rest(rest: Floats, sample_time: float) -> SensorNoise | None:
    """The noise of a measurement that does nothing else, shape (n,), where it is not white; else None.

    Few samples tell no spectrum, nor do those that are mostly rounded.
    """
    if rest.size < _FEWEST:
        return None
    level, step = float(np.std(detrend(rest))), resolution(rest)
    spectrum = noise_spectrum(rest, sample_time) if level > step else None
    return SensorNoise(level, step, spectrum) if spectrum else None


def _before_the_first_move(record: Record) -> Floats | None:
    """The measurement until something is moved that answers no noise, if it rests there; None where it does not."""
    asked = [each for each in (record.setpoint, record.excitation) if each is not None and np.ptp(each)]
    signals = asked or [record.control]
    first = min(int(np.argmax(signal != signal[0])) or signal.size for signal in signals)
    rest = record.measurement[: first + 1]  # what is moved at an instant is felt after it
    if not (_FEWEST <= rest.size < record.time.size and record.is_regular):
        return None
    straight = detrend(rest)
    return rest if np.std(rest) <= _LEVEL * np.std(straight) else None


def white_level(values: Floats) -> Floats:
    """Standard deviation of the white noise in signals, shape (..., n): third differences leave little else.

    They leave white noise sqrt(20) times as large, and little of what swings.
    """
    level: Floats = np.std(np.diff(values, 3, axis=-1), axis=-1) / math.sqrt(20.0)
    return level


def outlying_power(values: Floats) -> float:
    """Mean square of what is far off before and after it; 0 where that is not seldom, or the others do not move.

    Examples
    --------
    >>> measured = np.random.default_rng(0).standard_normal(1000)
    >>> outlying_power(measured)
    0.0
    >>> measured[500] += 30.0
    >>> round(outlying_power(measured), 1)  # 30^2 / 1000
    0.9
    """
    if values.size < _OUTLYING:
        return 0.0
    off = values - median_filter(values, _OUTLYING, mode="nearest")
    noise = max(_white_part(np.diff(values)), resolution(values) / math.sqrt(12.0))
    far = np.abs(off) > FAR_OFF * noise
    return float(np.sum(off[far] ** 2)) / values.size if noise and far.sum() <= FEW * values.size else 0.0


def bridged(values: Floats) -> tuple[Floats, Indexes]:
    """A signal without the samples that dropped out, a line in their place, and which these are.

    They are away from one sample to the next and back where they were soon after, beside a steady signal. What happens
    often is no dropout.

    Examples
    --------
    >>> measured = 50.0 + 0.1 * np.random.default_rng(0).standard_normal(100)
    >>> measured[[40, 60, 61]] = 0.0
    >>> found, dropped = bridged(measured)
    >>> dropped, bool(found.min() > 49.0)
    (array([40, 60, 61]), True)
    """
    moves = np.diff(values)
    noise = max(_white_part(moves), resolution(values) / math.sqrt(12.0))
    low, high = np.percentile(values, _USUAL_RANGE)
    jumps = np.flatnonzero(np.abs(moves) > max(FAR_OFF * noise, _SEEN * (high - low))).tolist()
    found: list[int] = []
    while len(jumps) > 1:
        away, back = jumps[:2]
        near = _BACK * abs(moves[away])
        stays, returns = np.ptp(values[away + 1 : back + 1]) <= near, abs(values[back + 1] - values[away]) <= near
        steady = min(abs(values[away] - values[max(away - 1, 0)]), np.ptp(values[back + 1 : back + 3])) <= near
        drops = back - away <= _DROPPED and stays and returns and steady
        if drops:
            found += range(away + 1, back + 1)
        jumps = jumps[2 if drops else 1 :]
    dropped = np.array(found if len(found) <= FEW * values.size else [], dtype=np.intp)
    kept = np.delete(np.arange(values.size), dropped)
    return (np.interp(np.arange(values.size), kept, values[kept]) if dropped.size else values), dropped


def _white_part(moves: Floats) -> float:
    """Standard deviation of white noise that moves so from sample to sample, however far few of these are off."""
    return MAD * float(np.median(np.abs(moves))) / math.sqrt(2.0)


def resolution(values: Floats) -> float:
    """The step of a quantised signal; 0 where nothing speaks for one.

    Examples
    --------
    >>> resolution(np.array([0.5, 0.75, 0.5, 1.25, 1.0, 0.5]))
    0.25
    >>> resolution(np.array([0.1, 0.12, 0.17, 0.18]))
    0.0
    """
    moves = np.diff(values)
    sizes = np.abs(moves[moves != 0.0])
    if sizes.size < 2:
        return 0.0
    step = float(sizes.min())
    multiples = sizes / step
    if np.abs(multiples - np.round(multiples)).max() >= _WHOLE:
        return 0.0
    moving = np.flatnonzero(moves)
    straight = np.ptp(moves[moving[0] : moving[-1] + 1]) <= _WHOLE * step  # a line is no staircase
    return 0.0 if straight else step


def reported_step(values: Floats) -> float:
    """The step of a quantised signal, or the least by which one moves that is told only when it has moved so far.

    The latter stands still most of the time and then moves at once, now by that and now by a little more.

    Examples
    --------
    >>> told, values = 0.0, []
    >>> for value in np.sin(0.1 * np.arange(200.0)) + 0.01 * np.random.default_rng(0).standard_normal(200):
    ...     told = float(value) if abs(value - told) >= 0.25 else told
    ...     values.append(told)
    >>> resolution(np.array(values)), round(reported_step(np.array(values)), 2)
    (0.0, 0.25)
    """
    step, moves = resolution(values), np.diff(values)
    moving = np.flatnonzero(moves)
    if step or moving.size < _FEWEST_REPORTS or 2 * moving.size > values.size or np.median(np.diff(moving)) < 2.0:
        return step
    sizes = np.abs(moves[moving])
    return float(sizes.min()) if np.median(sizes) <= _ALIKE * sizes.min() else 0.0


def hidden_by_steps(values: Floats, noise: float, moves_at_rest: float = 1.0) -> float:
    """How far a signal may be off without showing it: half of its step, where there is no noise beside that; else 0.

    Noise makes it go from step to step and back, and so shows on the average what is less than one.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Of a signal that has moved.
    noise : float
        Standard deviation at rest, quantisation included.
    moves_at_rest : float
        At what share of the ticks at rest it moved: a lively loop may go back and forth between two steps by itself.

    Examples
    --------
    >>> moved = np.array([0.5, 0.75, 0.75, 0.5, 1.25, 1.25, 1.25, 1.25, 1.0, 1.0, 1.0, 0.5])
    >>> hidden_by_steps(moved, noise=0.0722), hidden_by_steps(moved, noise=0.1)
    (0.125, 0.0)
    >>> slow, noise = np.linspace(0.0, 2.0, 1000), np.random.default_rng(0).standard_normal(1000)
    >>> hidden_by_steps(np.round(slow), 0.28), hidden_by_steps(np.round(slow + 0.25 * noise), 0.28)
    (0.5, 0.0)
    >>> hidden_by_steps(np.round(slow + 0.25 * noise), 0.28, moves_at_rest=0.0)
    0.5
    """
    step = reported_step(values)
    if noise > _NOTHING_ELSE * step / math.sqrt(12.0):
        return 0.0
    moves = np.sign(np.diff(values))
    turns = moves[1:] * moves[:-1] < 0.0
    is_noisy = moves_at_rest > _MOVES_AT_REST and np.mean(turns[1:] & turns[:-1]) > _FLICKERS
    return 0.0 if is_noisy else 0.5 * step
