"""What the loop did between two events: one row per phase, retuning, or step of setpoint or disturbance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fopid_core.design.specification import NUMBERS
from fopid_core.design.verification import achieved
from fopid_core.model.arrays import Floats
from fopid_core.model.fopid import Fopid
from fopid_core.model.indices import indices, overshoot_pct, peak, rise_time, settling_time
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process
from fopid_core.model.stability import stability
from fopid_core.study.reports.run import Run, Signal, Tuning

TOGETHER = 10
"""Events closer than this many samples are one: what follows the last of them is what counts."""

PROMPT = 0.5
"""On a wall clock, so are events of different kinds closer than this [s]: processes take time to react."""

SETTLED = 0.02
"""The band of the settling time, as a share of the step of the setpoint."""


@dataclass(frozen=True)
class Retuning:
    """Gains that came into force at ``time`` [s].

    ``method`` is the tuner's, or ``start`` for the first gains, or ``by hand``; ``tuning`` is None for the latter two.
    """

    time: float
    gains: Fopid
    method: str
    tuning: Tuning | None = None

    def loop(self, process: Process) -> Loop:
        """The loop with these gains, and with the filter and the weights that were tuned with them."""
        designed = self.tuning.loop(process) if self.tuning else None
        return designed or Loop(process, self.gains)


@dataclass(frozen=True)
class Segment:
    """A stretch of a run in which one thing happens, and what the loop made of it; NaN where a measure has no meaning.

    Attributes
    ----------
    name : str
        Of the experiment's phase, or what happened.
    method : str
        How the gains were found: ``start``, ``frequency``, ``time``, ``rule``, ``by hand``, or empty when not known.
    gains : Fopid or None
    start, end : float
        [s]; all times below count from ``start``.
    overshoot_pct, rise_time, settling_time : float
        After a step of the setpoint, in per cent of the step and [s] (10-90 %, and 2 % of the step). After a step of
        the disturbance only the settling time, to the same band.
    iae, itae : float
        Integrals of abs(e) and t abs(e).
    error_peak, control_peak : float
        Largest abs(e) and abs(u).
    ms, phase_margin : float
        Of the loop with these gains and the nominal process; [rad].
    """

    name: str
    method: str
    gains: Fopid | None
    start: float
    end: float
    overshoot_pct: float
    rise_time: float
    settling_time: float
    iae: float
    itae: float
    error_peak: float
    control_peak: float
    ms: float
    phase_margin: float


@dataclass(frozen=True)
class _Event:
    """What starts a segment; a step comes from the value ``before``."""

    time: float
    kind: str
    name: str = ""
    before: float = math.nan
    after: float = math.nan


@dataclass(frozen=True)
class _Stretch:
    """A segment to be measured, with the latest step of the setpoint and whether it starts the segment."""

    name: str
    start: float
    end: float
    step: _Event | None
    stepped: bool


def segments(run: Run) -> tuple[Segment, ...]:
    """Cut a run at its events and measure each piece.

    Parameters
    ----------
    run : Run
        With measurement and control; without a setpoint there is no error, and its measures are NaN.

    Examples
    --------
    >>> from pathlib import Path
    >>> time = np.arange(0.0, 10.0, 0.01)
    >>> one, answer = Signal(time, np.ones_like(time)), Signal(time, 1.0 - np.exp(-time))
    >>> run = Run(Path("run"), {"setpoint": one, "measurement": answer, "control": one})
    >>> [round(segment.rise_time, 2) for segment in segments(run)]
    [2.2]
    """
    changes, slack = retunings(run), _slack(run)
    return tuple(_measure(run, stretch, _latest(changes, stretch.start + slack)) for stretch in _stretches(run))


def beginning(run: Run) -> float:
    """Where the first thing happens [s]: the same place in all runs of an experiment."""
    return _stretches(run)[0].start


def _step(run: Run) -> float:
    """The sample time [s], 0 of a single sample."""
    return run.sample_time if math.isfinite(run.sample_time) else 0.0


def _slack(run: Run) -> float:
    return max(TOGETHER * _step(run), PROMPT if run.start else 0.0)


def retunings(run: Run) -> tuple[Retuning, ...]:
    """The gains at the start of a run and every change of them."""
    applied = [tuning for tuning in run.tunings if tuning.applied and tuning.gains]
    if not run.state:
        return tuple(Retuning(t.time, t.gains, t.method, t) for t in applied if t.gains)
    rows = np.column_stack([run.state[name] for name in NUMBERS])
    changed = [0, *(np.flatnonzero(np.any(np.diff(rows, axis=0) != 0.0, axis=1)) + 1)]
    found = []
    for i in changed:
        gains, time = Fopid(*rows[i]), float(run.state["time"][i])
        tuning = next((t for t in reversed(applied) if t.gains == gains), None)
        by_hand = "by hand" if i else "start"
        found.append(Retuning(time, gains, tuning.method if tuning else by_hand, tuning))
    return tuple(found)


def _latest(changes: Sequence[Retuning], time: float) -> Retuning | None:
    return next((change for change in reversed(changes) if change.time <= time), None)


def _events(run: Run) -> list[_Event]:
    """All that starts a segment, in the order of time."""
    events = [_Event(phase.time, "phase", phase.name) for phase in run.phases]
    events += [_Event(change.time, "retuning", change.method) for change in retunings(run)[1:]]
    measured = run.signals["measurement"].value[0]
    if "setpoint" in run.signals:
        events += _steps(run, "setpoint", _origin(run.signals["setpoint"], measured))
    if "disturbance" in run.signals:
        events += _steps(run, "disturbance", 0.0)
    first = run.phases[0].time if run.phases else _first(run)
    events = [event for event in events if first - _slack(run) <= event.time < run.end]
    if all(event.time > first for event in events):
        events.append(_Event(first, "phase", "start"))
    return sorted(events, key=lambda event: event.time)


def _first(run: Run) -> float:
    """When the loop had a setpoint and a measurement."""
    return float(max(run.signals[name].time[0] for name in ("setpoint", "measurement") if name in run.signals))


def _origin(setpoint: Signal, measured: float) -> float:
    """Where the first setpoint steps from: the measurement, unless that is there already."""
    first = float(setpoint.value[0])
    return measured if abs(first - measured) > SETTLED * np.max(np.abs(setpoint.value)) else first


def _steps(run: Run, name: str, origin: float) -> list[_Event]:
    """Changes between two stretches in which the signal is held; a ramp has none."""
    signal = run.signals[name]
    values = np.concatenate(([origin], signal.value))
    at = np.flatnonzero(np.diff(values))
    times = signal.time[at]
    held = np.diff(np.concatenate(([-math.inf], times, [math.inf]))) > TOGETHER * _step(run)
    found = at[held[:-1] & held[1:]]
    return [_Event(float(signal.time[i]), name, name, float(values[i]), float(values[i + 1])) for i in found]


def _together(run: Run, events: list[_Event]) -> list[list[_Event]]:
    """Events in groups; within a group each comes soon after the one before."""
    groups: list[list[_Event]] = []
    for event in events:
        seen = {earlier.kind for earlier in groups[-1]} if groups else set()
        gap = TOGETHER * _step(run) if event.kind in seen else _slack(run)
        if groups and event.time - groups[-1][-1].time <= gap:
            groups[-1].append(event)
        else:
            groups.append([event])
    return groups


def _start(group: list[_Event]) -> float:
    """The step, where there is one, and else the last event."""
    steps = [event.time for event in group if event.kind in ("setpoint", "disturbance")]
    return (steps or [event.time for event in group])[-1]


def _stretches(run: Run) -> list[_Stretch]:
    groups = _together(run, _events(run))
    starts = [_start(group) for group in groups]
    found: list[_Stretch] = []
    phase, step = "", None
    for group, start, end in zip(groups, starts, [*starts[1:], run.end], strict=True):
        named = next((event.name for event in group if event.kind == "phase"), None)
        new_step = next((event for event in reversed(group) if event.kind == "setpoint"), None)
        phase, step = named or phase, new_step or step
        happened = " and ".join(_describe(event) for event in group)
        name = named or (f"{phase}: {happened}" if phase else happened)
        found.append(_Stretch(name, start, end, step, stepped=new_step is not None))
    return found


def _describe(event: _Event) -> str:
    if event.kind == "retuning":
        return f"retuned ({event.name})"
    return f"{event.name} {event.before:.4g} → {event.after:.4g}"


def _measure(run: Run, stretch: _Stretch, force: Retuning | None) -> Segment:
    time, error = _error(run, stretch.start, stretch.end)
    step = stretch.step
    # 0 where the step began, 1 where it shall end; a load pushes it away from 1
    scaled = 1.0 - error / (step.after - step.before if step else math.nan)
    integrals = indices(time, error)
    ms, phase_margin = _robustness(run, force)
    return Segment(
        name=stretch.name,
        method=force.method if force else "",
        gains=force.gains if force else None,
        start=stretch.start,
        end=stretch.end,
        overshoot_pct=overshoot_pct(scaled) if stretch.stepped else math.nan,
        rise_time=rise_time(time, scaled) if stretch.stepped else math.nan,
        settling_time=settling_time(time, scaled, band=SETTLED) if step else math.nan,
        iae=integrals.iae,
        itae=integrals.itae,
        error_peak=peak(error),
        control_peak=_control_peak(run.signals["control"], stretch),
        ms=ms,
        phase_margin=phase_margin,
    )


def _error(run: Run, start: float, end: float) -> tuple[Floats, Floats]:
    """Time from ``start`` [s] and setpoint less measurement; at the very end with the setpoint that was."""
    measurement, half = run.signals["measurement"], 0.5 * _step(run)
    inside = (measurement.time >= start - half) & (measurement.time <= end + half)
    time, output = measurement.time[inside], measurement.value[inside]
    if "setpoint" not in run.signals:
        return time - start, np.full_like(time, math.nan)
    wanted = run.signals["setpoint"].held_at(np.clip(time, start, end - half))
    return np.maximum(time - start, 0.0), wanted - output


def _control_peak(control: Signal, stretch: _Stretch) -> float:
    inside = (control.time >= stretch.start) & (control.time < stretch.end)
    return peak(control.value[inside]) if np.any(inside) else math.nan


def _robustness(run: Run, force: Retuning | None) -> tuple[float, float]:
    """Ms and phase margin [rad] of the loop: from its process, or else as the tuner gave them."""
    if force and run.process:
        loop = force.loop(run.process)
        found = achieved(loop) if stability(loop).stable else None
    else:
        found = force.tuning.achieved if force and force.tuning else None
    return (found.ms, found.phase_margin) if found else (math.nan, math.nan)
