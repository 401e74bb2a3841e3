"""What would happen with other gains: responses, Bode, Nyquist, margins and the verdict, as fast as a hand moves.

``answer`` takes what a page asks and gives what it draws. The verdict is the argument principle on the process itself
(``model.stability``); what is not known is null, with its reason beside it.

While the hand moves (``quick``) responses come from the search's inverse FFT, right to about 1 %: exact ones
take 15 ms, with a delay some hundred. As soon as it rests the page asks for the exact ones.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from fopid_core.design.control_peak import first_control
from fopid_core.design.defaults import PHASE_MARGIN, natural_crossover
from fopid_core.design.time.search_response import ResponseGrid
from fopid_core.design.verification import SMOOTH_TICKS
from fopid_core.errors import InputError
from fopid_core.model.arrays import Floats
from fopid_core.model.evaluation import default_horizon
from fopid_core.model.indices import overshoot_pct, rise_time, settling_time, total_variation
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import Process
from fopid_core.model.response import step_response
from fopid_core.model.stability import Stability, stability
from fopid_core.study.page.requests import GAINS, GainSet, read_request

POINTS = 501
"""Instants of a response."""

FREQUENCIES = 301
DECADES = 2.5
"""The frequency response is drawn so far below and above the process's natural crossover."""

_WITH_REST = 2.5  # settling times that a picture shows
_TURN = 30.0  # of the phase between two frequencies, that a curve can be drawn through [deg]
_QUICK_STEPS = 4  # of the quick response, per instant drawn


@dataclass(frozen=True)
class Picture:
    """On what everything is drawn.

    Attributes
    ----------
    process : Process
    horizon : float
        Last instant [s].
    sample_time : float
        Tick of the controller as it will run [s]; the control right after a step depends on it.
    """

    process: Process
    horizon: float
    sample_time: float

    @property
    def time(self) -> Floats:
        """Instants [s], shape (POINTS,)."""
        return np.linspace(0.0, self.horizon, POINTS)

    @property
    def frequency(self) -> Floats:
        """Frequencies [rad/s], shape (FREQUENCIES,)."""
        return natural_frequency(self.process) * np.logspace(-DECADES, DECADES, FREQUENCIES)


@lru_cache(32)
def natural_frequency(process: Process) -> float:
    """The middle of a Bode plot [rad/s]; 1 where the process does not say, being infinite at some frequency."""
    try:
        return natural_crossover(process, PHASE_MARGIN)
    except InputError:
        return 1.0


def answer(request: Mapping[str, Any], process: Process | None = None) -> dict[str, Any]:
    """What a page shows of some sets of gains, as JSON knows it.

    Parameters
    ----------
    request : mapping
        ``sets``, a list of up to 8 objects with kp, ki, kd, lam, mu and optionally filter_order, filter_time,
        setpoint_weight, derivative_setpoint_weight; ``process``, a text, where none is given here; ``horizon`` [s] and
        ``sample_time`` [s], optional; ``quick``, whether responses may be the search's.
    process : Process, optional

    Returns
    -------
    dict
        ``process, horizon, sample_time, time, frequency`` and for each set what ``judged`` says.

    Raises
    ------
    InputError
        For what cannot be used.

    Examples
    --------
    >>> shown = answer({"process": "1/(s+1)^3", "sets": [{"kp": 2}, {"kp": 9}]})
    >>> [one["verdict"]["badge"] for one in shown["sets"]], shown["horizon"]
    (['stable', 'unstable'], 30.0)
    >>> round(shown["sets"][0]["margins"]["gain_margin"]["value"], 6)
    4.0
    """
    asked = read_request(request, process)
    span = picture_horizon(asked.process, asked.sets[0]) if asked.horizon is None else asked.horizon
    picture = Picture(asked.process, span, asked.sample_time)
    return {
        "process": str(picture.process), "horizon": picture.horizon, "sample_time": picture.sample_time,
        "time": digits(picture.time), "frequency": digits(picture.frequency),
        "sets": [judged(picture, one, asked.quick) for one in asked.sets],
    }  # fmt: skip


@lru_cache(256)
def picture_horizon(process: Process, first: GainSet) -> float:
    """How long a picture is that begins with a set [s]."""
    loop = Loop(process, first.gains, first.filter, first.weights)
    if first.gains.kp == first.gains.ki == first.gains.kd == 0.0 or not stability(loop).stable:
        return _round_up(8.0 / natural_frequency(process) + 4.0 * process.delay)
    longest = default_horizon(loop)
    try:
        step = step_response(loop, longest, "setpoint", POINTS)
    except InputError:
        return longest
    moving = np.abs(step.output - step.output[-1]) > 0.02 * np.abs(step.output).max()
    settled = float(step.time[moving].max(initial=process.delay))
    # What is over with its first instant, a peak of the derivative, says nothing of how long to look.
    return min(_round_up(_WITH_REST * settled), longest) if settled > 0.0 else longest


def _round_up(wished: float) -> float:
    decade = 10.0 ** math.floor(math.log10(wished))
    return float(next(n * decade for n in (1, 1.5, 2, 3, 4, 5, 6, 8, 10) if n * decade >= wished))


@lru_cache(64)
def judged(picture: Picture, one: GainSet, quick: bool = False) -> dict[str, Any]:
    """All that is shown of one set.

    Returns
    -------
    dict
        ``gains``; ``verdict`` {badge (stable, unstable, undecided), reason, unstable_poles}; ``margins`` and
        ``measures``, each value with its reason where it is null; ``setpoint`` and ``load`` {output, control, reason};
        ``bode`` {gain_db, phase_deg}; ``nyquist`` {re, im}; ``exact``, whether the responses are.
    """
    loop = Loop(picture.process, one.gains, one.filter, one.weights)
    verdict = stability(loop)
    is_quick = quick and verdict.stable and picture.process.steady_state_gain != 0.0
    steps = _quick_steps(picture, one) if is_quick else _exact_steps(picture, loop)
    gain, phase = _frequency_response(picture, loop)
    with np.errstate(all="ignore"):
        curve = 10.0 ** (gain / 20.0) * np.exp(1j * np.radians(phase))
    curve[np.abs(np.gradient(phase)) > _TURN] = np.nan  # a delay's turns, too dense to draw
    return {
        "gains": {name: getattr(one.gains, name) for name in GAINS},
        "verdict": {"badge": _badge(verdict), "reason": verdict.reason,
                    "unstable_poles": verdict.unstable_poles if verdict.unstable_poles >= 0 else None},
        "exact": not is_quick,
        "margins": _margins(loop, verdict),
        "measures": _measures(picture, one, steps["setpoint"], verdict),
        "bode": {"gain_db": digits(gain), "phase_deg": digits(phase)},
        "nyquist": {"re": digits(curve.real), "im": digits(curve.imag)},
        **{name: {"output": digits(step["output"]), "control": digits(step["control"]), "reason": step["reason"]}
           for name, step in steps.items()},
    }  # fmt: skip


def _badge(verdict: Stability) -> str:
    if not verdict.decided:
        return "undecided"
    return "stable" if verdict.stable else "unstable"


def _exact_steps(picture: Picture, loop: Loop) -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}
    for source in ("setpoint", "load"):
        try:
            step = step_response(loop, picture.horizon, source, POINTS)
        except InputError as error:
            found[source] = {"output": None, "control": None, "reason": str(error)}
        else:
            found[source] = {"output": step.output, "control": step.control, "reason": ""}
    return found


@lru_cache(8)
def _grid(process: Process, horizon: float, filter_order: int) -> ResponseGrid:
    points = _QUICK_STEPS * (POINTS - 1)
    return ResponseGrid(process, horizon, points, natural_frequency(process), filter_order)


def _quick_steps(picture: Picture, one: GainSet) -> dict[str, dict[str, Any]]:
    grid = _grid(picture.process, picture.horizon, one.filter.order)
    row, thin = one.row, slice(None, None, _QUICK_STEPS)
    return {
        "setpoint": {"output": 1.0 - grid.errors(row)[0, thin], "control": grid.controls(row)[0, thin], "reason": ""},
        "load": {"output": -grid.load_errors(row)[0, thin], "control": grid.load_controls(row)[0, thin], "reason": ""},
    }  # fmt: skip


def _frequency_response(picture: Picture, loop: Loop) -> tuple[Floats, Floats]:
    """Gain [dB] and phase [deg] of L, the phase without jumps: a delay's turns are added by themselves."""
    w = picture.frequency
    with np.errstate(all="ignore"):
        value = loop(1j * w)
        prompt = value * np.exp(1j * w * picture.process.delay)
        phase = np.unwrap(np.angle(prompt)) - w * picture.process.delay
        return np.asarray(20.0 * np.log10(np.abs(value))), np.asarray(np.degrees(phase))


_ENDLESS = {
    "phase_margin_deg": "infinite: the loop gain never crosses 1",
    "gain_margin": "infinite: no gain takes the loop to the border",
    "delay_margin": "infinite: no delay takes the loop to the border",
    "ms": "infinite", "mt": "infinite", "crossover": "the loop gain never crosses 1",
}  # fmt: skip


def _margins(loop: Loop, verdict: Stability) -> dict[str, dict[str, Any]]:
    if not verdict.stable:
        return {name: {"value": None, "reason": verdict.reason} for name in _ENDLESS}
    found = margins(loop, jitter=False)
    return {name: told(getattr(found, name), reason) for name, reason in _ENDLESS.items()}


def told(value: float, reason: str) -> dict[str, Any]:
    """A number, or null with its reason."""
    known = math.isfinite(value)
    return {"value": value if known else None, "reason": "" if known else reason}


def _measures(picture: Picture, one: GainSet, step: Mapping[str, Any], verdict: Stability) -> dict[str, dict[str, Any]]:
    names = ("overshoot_pct", "settling_time", "rise_time", "control_peak", "total_variation")
    if not verdict.stable or step["output"] is None:
        reason = step["reason"] if verdict.stable else verdict.reason
        return {name: {"value": None, "reason": reason} for name in names}
    time, output = picture.time, step["output"]
    later = step["control"][np.isfinite(step["control"]) & (time >= SMOOTH_TICKS * picture.sample_time)]
    begins = abs(float(first_control(one.row, picture.sample_time)[0]))
    values = (
        overshoot_pct(output), settling_time(time, output), rise_time(time, output),
        max(begins, float(np.abs(later).max(initial=0.0))), float(total_variation(later)),
    )  # fmt: skip
    return {name: told(value, "not within this time") for name, value in zip(names, values, strict=True)}


def digits(values: Floats | None) -> list[float | None] | None:
    """Five digits of each, null for what is no number."""
    if values is None:
        return None
    values = np.asarray(values, dtype=float)
    with np.errstate(all="ignore"):
        scale = 10.0 ** (4.0 - np.floor(np.log10(np.abs(values))))
        short = np.where(np.isfinite(scale) & (scale > 0.0), np.round(values * scale) / scale, values)
    return [value if math.isfinite(value) else None for value in short.tolist()]
