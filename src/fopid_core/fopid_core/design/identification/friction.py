"""Dry friction of a mechanism, where nothing linear explains a record: a body on a spring and a damper that sticks.

The body is stepped through with Coulomb's friction, implicitly, so that it comes to a stand and stays there while the
force is too small (Moreau's time stepping). What friction takes of the control is known then, and the linear part,
whatever its structure, is fitted to what is left.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from fopid_core.design.identification.quality import correlation_time
from fopid_core.design.identification.record import Record
from fopid_core.model.arrays import Floats

PROOF = 12.0
"""Twice the logarithm of the likelihood grows by so much with friction, beside the best linear model."""
LEAST_EXPLAINED = 0.3
"""Share of what a linear model leaves of the measurement that friction must explain."""
LEAST_SAMPLES, MOST_SAMPLES = 200, 8192
"""In shorter records none is looked for; of longer ones every so many samples are looked at, as many as this."""
SMOOTHED = (3.0, 6.0, 12.0, 25.0, 50.0)
"""Times in samples of the filters behind which the equation of motion is read for a start."""
MOVES = 0.6
"""Quantile of the speed above which it is read: there the body certainly moves."""
STARTS, EVALUATIONS, TOLERANCE = 2, 30, 1e-5
"""The best of these starts from which least squares begin."""
PLACES, FINER = 41, 3
"""Constant forces that are tried for a record, and how often nearer to the best."""
_NUDGE = 1e-4


@dataclass(frozen=True)
class Friction:
    """Of a body whose place is measured, in units of the control; each for one of the measurement, per s and s^2.

    Attributes
    ----------
    size : float
        Of the dry friction.
    inertia, damping, stiffness : float

    Examples
    --------
    >>> body = Body(Friction(size=0.5, inertia=1.0, damping=0.0, stiffness=0.0), sample_time=0.1)
    >>> for force in (0.4, 0.4, 1.5):
    ...     body.step(force)
    >>> round(body.measurement, 3)
    0.01
    """

    size: float
    inertia: float
    damping: float
    stiffness: float

    @property
    def numbers(self) -> Floats:
        """Logarithm of the inertia, damping, stiffness, size, and no constant force, shape (5,)."""
        return np.array([math.log(self.inertia), self.damping, self.stiffness, self.size, 0.0])

    def felt(self, record: Record) -> Floats:
        """What friction leaves of a record's control, shape (n,).

        The constant force that acts beside the control is the one that explains the record best.
        """
        about, width = float(np.median(record.control)), 2.0 * self.size
        frictions = np.zeros((record.control.size, 1))
        for _ in range(FINER):
            numbers = np.tile(self.numbers, (PLACES, 1))
            numbers[:, 4] = about + width * np.linspace(-1.0, 1.0, PLACES)
            places, frictions = moved(numbers, record.control, _holds(record.time))
            best = int(np.argmin(np.std(places - record.measurement[:, None], axis=0)))
            about, width = float(numbers[best, 4]), 2.0 * width / PLACES
        return np.asarray(record.control - frictions[:, best])

    def __str__(self) -> str:
        return f"the process moves against a dry friction of {self.size:.3g}"


class Body:
    """A body with friction, at rest at first: ``body.step(force)`` holds a force for one sample time [s]."""

    def __init__(self, friction: Friction, sample_time: float) -> None:
        self._friction, self._h = friction, sample_time
        self.measurement = self._speed = 0.0

    def step(self, force: float, load: float = 0.0) -> None:
        """Let one sample time pass."""
        own, h = self._friction, self._h
        drive = own.inertia / h * self._speed + force + load - own.stiffness * self.measurement
        left = drive - min(max(drive, -own.size), own.size)
        self._speed = left / (own.inertia / h + own.damping + h * own.stiffness)
        self.measurement += h * self._speed


def moved(numbers: Floats, control: Floats, holds: Floats) -> tuple[Floats, Floats]:
    """Places of several bodies and what friction takes, each of shape (n, m), from numbers of shape (m, 5).

    ``holds`` says for how long each control is held [s], shape (n,).
    """
    log_inertia, damping, stiffness, size, constant = numbers.T
    inertia = np.exp(np.clip(log_inertia, -50.0, 50.0))
    places, frictions = np.empty((control.size, len(numbers))), np.empty((control.size, len(numbers)))
    place, speed = np.zeros(len(numbers)), np.zeros(len(numbers))
    for k, (force, h) in enumerate(zip(control.tolist(), holds.tolist(), strict=True)):
        places[k] = place
        momentum = inertia / h
        drive = momentum * speed + (force - constant) - stiffness * place
        frictions[k] = taken = np.minimum(np.maximum(drive, -size), size)
        speed = (drive - taken) / (momentum + damping + h * stiffness)
        place = place + h * speed
    return places, frictions


def _holds(time: Floats) -> Floats:
    """For how long each sample lasts [s]; the last as long as the one before."""
    return np.diff(time, append=2.0 * time[-1] - time[-2])


def friction_of(record: Record, left: float) -> Friction | None:
    """The friction that explains what the best linear model leaves of a record; None where nothing speaks for one.

    Parameters
    ----------
    record : Record
    left : float
        Standard deviation of that.
    """
    if record.time.size < LEAST_SAMPLES:
        return None
    every = math.ceil(record.time.size / MOST_SAMPLES)
    count = record.time.size // every
    control = record.control[: count * every].reshape(count, every).mean(axis=1)
    measurement, holds = record.measurement[: count * every : every], _holds(record.time[: count * every : every])
    starts = [numbers for time in SMOOTHED for numbers in _read(control, measurement, float(holds.mean()), time)]
    if not starts:
        return None
    found = min((_fitted(start, control, measurement, holds) for start in _best(starts, control, measurement, holds)),
                key=lambda fit: float(np.std(fit[1])))  # fmt: skip
    (log_inertia, damping, stiffness, size, _), residual = found
    error = float(np.std(residual))
    independent = count / correlation_time(residual)
    if not size > 0.0 or not error < (1.0 - LEAST_EXPLAINED) * left:
        return None
    if 2.0 * independent * math.log(left / max(error, 1e-300)) < PROOF:
        return None
    return Friction(float(size), math.exp(log_inertia), float(damping), float(stiffness))


def _read(control: Floats, measurement: Floats, h: float, time: float) -> list[Floats]:
    """Numbers from the equation of motion behind a filter of so many samples, with a spring and without."""
    place, force = _smooth(measurement, time), _smooth(control, time)
    speed = np.gradient(place, h)
    moves = np.abs(speed) > np.quantile(np.abs(speed), MOVES)
    if not moves.any():
        return []
    terms = [np.gradient(speed, h), speed, np.sign(speed), np.ones_like(speed), place]
    found = []
    for count in (5, 4):  # with a spring and without
        columns = np.column_stack(terms[:count])[moves]
        inertia, damping, size, constant, *spring = np.linalg.lstsq(columns, force[moves], rcond=None)[0].tolist()
        if inertia > 0.0 and size > 0.0:
            stiffness = max(spring[0], 0.0) if spring else 0.0
            constant += stiffness * float(measurement[0])
            found.append(np.array([math.log(inertia), max(damping, 0.0), stiffness, size, constant]))
    return found


def _smooth(signal: Floats, time: float) -> Floats:
    """Behind three lags of so many samples, at rest at first."""
    share = -math.expm1(-1.0 / time)
    smooth = signal - signal[0]
    for _ in range(3):
        smooth = lfilter([share], [1.0, share - 1.0], smooth)
    return np.asarray(smooth + signal[0])


def _best(starts: list[Floats], control: Floats, measurement: Floats, holds: Floats) -> list[Floats]:
    """Those that explain most."""
    with np.errstate(over="ignore", invalid="ignore"):
        errors = np.std(_residual(np.array(starts), control, measurement, holds), axis=0)
    order = np.argsort(np.nan_to_num(errors, nan=np.inf, posinf=np.inf))
    return [starts[place] for place in order[:STARTS]]


def _fitted(start: Floats, control: Floats, measurement: Floats, holds: Floats) -> tuple[Floats, Floats]:
    """The numbers that explain a record best, near a start, and what they leave."""
    inertia, size, spread = math.exp(start[0]), start[3], float(np.ptp(measurement))
    scale = np.array([0.3, max(start[1], 0.1 * inertia), max(start[2], 0.1 * size / spread), size, size])
    low = np.array([-np.inf, 0.0, 0.0, 0.0, -np.inf])

    def residual(x: Floats) -> Floats:
        return _residual(x[None], control, measurement, holds)[:, 0] / spread

    def jacobian(x: Floats) -> Floats:
        nudged = np.vstack([x, x + _NUDGE * np.diag(scale)])
        seen = _residual(nudged, control, measurement, holds)
        return np.asarray((seen[:, 1:] - seen[:, :1]) / (_NUDGE * scale) / spread)

    inside = np.maximum(start, low + 1e-6 * scale)
    found = least_squares(residual, inside, jacobian, bounds=(low, np.full(5, np.inf)), x_scale=scale,
                          ftol=TOLERANCE, xtol=1e-6, gtol=1e-12, max_nfev=EVALUATIONS)  # fmt: skip
    return found.x, spread * found.fun


def _residual(numbers: Floats, control: Floats, measurement: Floats, holds: Floats) -> Floats:
    """What bodies leave of a measurement, whose zero is free, shape (n, m)."""
    left = moved(numbers, control, holds)[0] - measurement[:, None]
    return np.asarray(np.nan_to_num(left - left.mean(axis=0), nan=1e100, posinf=1e100, neginf=-1e100))
