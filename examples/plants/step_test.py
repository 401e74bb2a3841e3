"""What an engineer does first: a step of the control in open loop, read as one or two lags behind a delay.

Shares no code with the package, which has its own ways to learn a process.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from foreign_plants.gallery import Exhibit
from scipy.optimize import least_squares

SIZES = (0.1, 0.05, 0.02, 0.01, 0.005)
"""Steps as shares of the control's range: the first that leaves the plant near its place is taken."""
REST, LONGEST = 0.1, 3.0
"""How long rest is looked at, and the step is waited for, in the plant's horizons."""
FAR, NEAR_LIMIT = 4.0, 0.6
"""A step ends when the measurement has gone so many moves of the setpoint; and share of the room to what is unsafe."""
LEAST_FIT = 75.0
"""Below this [%] the test shows something else than lags."""
UNSEEN_DELAY = 0.5
"""Share of the second lag that stands for the delay where the fit sees less (Skogestad's half rule)."""
SETTLED, RUNS_AWAY = 6.0, 1.5
"""Times to 63 % after which a step has told all; how much steeper than the one before its last third is where a plant
runs away."""
SLOWER = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0)
"""Closed-loop time constants that SIMC is tried with, in delays, until the plant is calm."""
SLOWEST = 30.0
"""Longest lag, in lengths of the test: beyond it a process integrates."""


@dataclass(frozen=True)
class Lags:
    """K exp(-L s) / ((T1 s + 1) (T2 s + 1)), T1 >= T2; times in seconds.

    Attributes
    ----------
    gain, delay : float
    lags : tuple of float
        T1, T2.
    fit_pct : float
    """

    gain: float
    delay: float
    lags: tuple[float, float]
    fit_pct: float


@dataclass(frozen=True)
class StepTest:
    """Outcome of a test.

    Attributes
    ----------
    one, two : Lags or None
        Read with one and with two lags; None where that does not fit.
    lasted : float
        [s]
    safe : bool
        The plant stayed where it may be.
    """

    one: Lags | None
    two: Lags | None
    lasted: float
    safe: bool


def step_test(exhibit: Exhibit, seed: int = 2) -> StepTest:
    """Make the test and read it."""
    time, moved, size, safe = _recorded(exhibit, seed)
    one, two = (_read(time, moved, size, exhibit.sample_time, count) for count in (1, 2))
    return StepTest(one, two, min(_told(time, moved), float(time[-1])) + REST * exhibit.horizon, safe)


def _told(time: np.ndarray, moved: np.ndarray) -> float:
    """When a step has told all [s]."""
    end = np.mean(moved[-max(moved.size // 10, 1) :])
    return SETTLED * float(time[np.argmax(moved / end > 0.632)])


def _recorded(exhibit: Exhibit, seed: int) -> tuple[np.ndarray, np.ndarray, float, bool]:
    dt, (low, high) = exhibit.sample_time, exhibit.unsafe
    for share in SIZES:
        plant = exhibit.plant(seed)
        size = share * (plant.actuator.high - plant.actuator.low)
        if plant.control_at_rest + size > plant.actuator.high:
            size = -size
        rest = np.mean([plant.step(plant.control_at_rest, dt) for _ in range(round(REST * exhibit.horizon / dt))])
        room = min(high - rest, rest - low)
        moved = [0.0]
        while len(moved) * dt < LONGEST * exhibit.horizon and abs(moved[-1]) < FAR * exhibit.move:
            moved.append(plant.step(plant.control_at_rest + size, dt) - rest)
        if abs(moved[-1]) < NEAR_LIMIT * room and len(moved) > 100:
            return dt * np.arange(len(moved)), np.array(moved), size, True
    return dt * np.arange(len(moved)), np.array(moved), size, bool(low < moved[-1] + rest < high)


def _read(time: np.ndarray, moved: np.ndarray, size: float, dt: float, lags_count: int) -> Lags | None:
    """By least squares over the lags and the delay, as logarithms; the gain is linear."""
    thirds = np.array_split(moved, 3)
    middle, last = (float(part[-part.size // 5 :].mean() - part[: part.size // 5].mean()) for part in thirds[1:])
    if abs(last) > RUNS_AWAY * abs(middle) and abs(last) > 0.3 * abs(moved[-1]):
        return None
    told = int(np.searchsorted(time, _told(time, moved)))
    thin = slice(None, told, max(told // 2000, 1))
    t, y = time[thin], moved[thin]
    span = float(t[-1])

    def response(x: np.ndarray) -> np.ndarray:
        return _unit_step(np.maximum(t - math.exp(x[0]), 0.0), [math.exp(v) for v in x[1:]])

    def residual(x: np.ndarray) -> np.ndarray:
        shape = response(x)
        return np.asarray(y - (shape @ y) / max(shape @ shape, 1e-300) * shape)

    bounds = np.log([[0.01 * dt, 0.5 * span]] + [[0.1 * dt, SLOWEST * span]] * lags_count)
    starts = [
        np.log([0.02 * span * a, 0.3 * span * a, *([0.05 * span * a] * (lags_count - 1))])
        for a in (0.03, 0.2, 1.0, 5.0)
    ]
    tried = [
        least_squares(residual, np.clip(x, bounds[:, 0] + 1e-6, bounds[:, 1] - 1e-6), bounds=bounds.T) for x in starts
    ]
    best = min(tried, key=lambda found: found.cost)
    shape = response(best.x)
    fit = 100.0 * (1.0 - math.sqrt(2.0 * best.cost / t.size) / float(np.std(y)))
    if fit < LEAST_FIT:
        return None
    delay, *lags = np.exp(best.x).tolist()
    slow, fast = sorted([*lags, 0.0], reverse=True)[:2]
    return Lags(float(shape @ y / (shape @ shape)) / size, delay, (slow, fast), fit)


def _unit_step(t: np.ndarray, lags: list[float]) -> np.ndarray:
    if len(lags) == 1:
        return np.asarray(-np.expm1(-t / lags[0]))
    slow, fast = max(lags), min(lags)
    fast = min(fast, 0.999 * slow)
    return np.asarray(1.0 - (slow * np.exp(-t / slow) - fast * np.exp(-t / fast)) / (slow - fast))


@dataclass(frozen=True)
class Pid:
    """kp, ki, kd, and the time of the lag before the derivative [s]."""

    kp: float
    ki: float
    kd: float = 0.0
    filter_time: float = 0.0


def simc(test: StepTest, sample_time: float, slower: float) -> dict[str, Pid]:
    """PI and PID of S. Skogestad, J. Process Control 13 (2003), 291-309, the hold of the control counted as delay.

    The closed-loop time constant is so many times the delay; the derivative has a filter of a tenth of its time.
    """
    found: dict[str, Pid] = {}
    if test.one is not None:
        t, d = test.one.lags[0], test.one.delay + 0.5 * sample_time
        kp = t / (test.one.gain * (1.0 + slower) * d)
        found["SIMC PI"] = Pid(kp, kp / min(t, 4.0 * (1.0 + slower) * d))
    if test.two is not None:
        t, second = test.two.lags
        d = max(test.two.delay, UNSEEN_DELAY * second) + 0.5 * sample_time
        series, ti = t / (test.two.gain * (1.0 + slower) * d), min(t, 4.0 * (1.0 + slower) * d)
        found["SIMC PID"] = Pid(series * (1.0 + second / ti), series / ti, series * second, 0.1 * second)
    return found


def amigo(test: StepTest, sample_time: float) -> dict[str, Pid]:
    """PI and PID of K. J. Astrom and T. Hagglund, Advanced PID Control, ISA 2006, as for ``simc``."""
    if test.one is None:
        return {}
    k, t, d = test.one.gain, test.one.lags[0], test.one.delay + 0.5 * sample_time
    pi = 0.15 / k + (0.35 - d * t / (d + t) ** 2) * t / (k * d)
    pid, td = (0.2 + 0.45 * t / d) / k, 0.5 * d * t / (0.3 * d + t)
    return {
        "AMIGO PI": Pid(pi, pi / (0.35 * d + 13.0 * d * t**2 / (t**2 + 12.0 * d * t + 7.0 * d**2))),
        "AMIGO PID": Pid(pid, pid / ((0.4 * d + 0.8 * t) / (d + 0.1 * t) * d), pid * td, 0.1 * td),
    }
