"""What the page says of the loop before anything else: how it is, in the worst word that is known to be true."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

SILENCE = 1.0
"""[s] without a tick after which the controller is silent."""
MISSED_TICKS = 3.0
"""The same for a slow controller, in ticks, or in messages where it tells only some of them."""
SLOWEST = 10.0
"""[s] between two messages beyond which a pause is no pace."""
OUTDATED = 3.0
"""Diagnostics come once a second; [s] after which a node that told them is silent."""
FORGOTTEN = 60.0
"""[s] after which a silent node other than the controller is no longer spoken of."""
RECENT = 10.0
"""[s] for which a refused value is spoken of."""
PRESSED = 1.0
"""[s] at a limit after which the control is said to be there."""
HUGE = 1e12
"""A signal beyond this has diverged, whatever its unit."""
OWN = "fopid"
"""``hardware_id`` of this package's nodes."""
MOST_NODES = 200

LEVELS = ("ok", "warn", "error")
"""By DiagnosticStatus.level; what is beyond is an error, too."""


@dataclass(frozen=True)
class Problem:
    """Something that is not as it should be."""

    level: str
    who: str
    text: str


@dataclass(frozen=True)
class Report:
    """What a node told of itself, and when."""

    level: str
    text: str
    facts: Mapping[str, str]
    own: bool
    at: float


@dataclass
class Signal:
    """The newest value of a signal, and when it came."""

    value: float = math.nan
    at: float = -math.inf


def number(value: Any) -> float | None:
    """A finite number, or None: JSON has no NaN, and a page no use for one.

    Examples
    --------
    >>> number("0.25"), number("inf"), number(None), number(float("nan"))
    (0.25, None, None, None)
    """
    try:
        found = float(value)
    except (TypeError, ValueError):
        return None
    return found if math.isfinite(found) else None


@dataclass
class Health:
    """Takes in what the nodes tell; ``facts`` says what is known of it now.

    Parameters
    ----------
    controller, tuner : str
        Full names of these nodes.
    now : callable
        Time [s].
    """

    controller: str
    tuner: str
    now: Callable[[], float] = time.monotonic
    reports: dict[str, Report] = field(default_factory=dict)
    signals: dict[str, Signal] = field(default_factory=lambda: {name: Signal() for name in ("setpoint", "measurement",
                                                                                            "control")})  # fmt: skip
    _state: Any = None
    _state_at: float = -math.inf
    _gap: float = 0.0
    _free_at: float = -math.inf
    _refusals: deque[tuple[float, int]] = field(default_factory=lambda: deque(maxlen=1000))

    # What is heard.

    def take_state(self, state: Any) -> None:
        """A tick of the controller."""
        now = self.now()
        gap = now - self._state_at
        self._gap = gap if gap < SLOWEST else 0.0
        if self._state is not None and state.refused > self._state.refused:
            self._refusals.append((now, state.refused - self._state.refused))
        if not state.saturated or self._silent(now):
            self._free_at = now
        self._state, self._state_at = state, now
        for name in self.signals:
            self.signals[name] = Signal(getattr(state, name), now)

    def take_signal(self, name: str, value: float) -> None:
        """A message of the loop's own topics."""
        self.signals[name] = Signal(value, self.now())

    def take_diagnostics(self, statuses: Iterable[Any]) -> None:
        """What nodes tell of themselves."""
        for status in statuses:
            if status.name not in self.reports and len(self.reports) >= MOST_NODES:
                continue
            level = LEVELS[min(status.level[0], len(LEVELS) - 1)]
            facts = {one.key: one.value for one in status.values} if status.hardware_id == OWN else {}
            self.reports[status.name] = Report(level, status.message, facts, status.hardware_id == OWN, self.now())

    # What is known.

    @property
    def silent(self) -> bool:
        """Whether no tick comes."""
        return self._silent(self.now())

    def _silent(self, now: float) -> bool:
        interval = 0.0 if self._state is None else number(self._state.sample_interval) or 0.0
        return now - self._state_at > max(SILENCE, MISSED_TICKS * max(interval, self._gap))

    def tuner_is_alive(self) -> bool:
        """Whether the tuner has told its diagnostics lately."""
        return self._fresh(self.tuner) is not None

    def tuner_work(self) -> str:
        """What the tuner is busy with; empty when it is idle or not known."""
        report = self._fresh(self.tuner)
        return "" if report is None or report.text in ("idle", "") else report.text

    def _fresh(self, name: str) -> Report | None:
        report = self.reports.get(name)
        return report if report is not None and self.now() - report.at <= OUTDATED else None

    def facts(self) -> dict[str, Any]:
        """All of it for the page; None for what is not known."""
        now = self.now()
        problems = sorted(self._problems(now), key=lambda one: -LEVELS.index(one.level))
        known = self._state is not None or self._fresh(self.controller) is not None
        alive = self._state is not None and not self._silent(now)
        state, tuner = self._state if alive else None, self._fresh(self.tuner)
        return {
            "level": problems[0].level if problems else "ok" if known else "unknown",
            "problems": [vars(one) for one in problems[:12]],
            "values": {name: self._value(name, now) for name in self.signals},
            "ages": {name: self._age(name, now) for name in ("measurement", "setpoint")},
            "stale": None if state is None else bool(state.stale),
            "silent_for": None if alive or self._state is None else round(now - self._state_at, 1),
            "refused": None if state is None else int(state.refused),
            "refused_lately": sum(count for at, count in self._refusals if now - at <= RECENT) if alive else None,
            "saturated": None if state is None else bool(state.saturated),
            "mode": None if state is None else ("auto", "manual")[min(state.mode, 1)],
            "interval": None if state is None else number(state.sample_interval) or None,
            "overruns": None if state is None else int(state.overruns),
            "adaptation": None if tuner is None else tuner.facts.get("adaptation"),
            "tuner_work": self.tuner_work() or None,
        }

    def diagnostics(self) -> list[dict[str, Any]]:
        """All nodes that tell their diagnostics, the worst first."""
        now = self.now()
        told = [
            {"name": name, "level": "error" if self._outdated(report, now) else report.level,
             "text": "silent" if self._outdated(report, now) else report.text}
            for name, report in self.reports.items()
        ]  # fmt: skip
        return sorted(told, key=lambda one: (-LEVELS.index(str(one["level"])), one["name"]))

    def _value(self, name: str, now: float) -> float | None:
        """The newest value, unless it is too old to be called the present one."""
        signal, age = self.signals[name], self._age(name, now)
        if name == "measurement" and age is not None and age > max(SILENCE, MISSED_TICKS * self._gap):
            return None
        return number(signal.value) if now - signal.at <= max(SILENCE, MISSED_TICKS * self._gap) else None

    def _age(self, name: str, now: float) -> float | None:
        """Of an input [s]; what the controller says of it counts, since it knows repeated and refused samples."""
        if self._state is None or (self._silent(now) and self.signals[name].at > self._state_at):
            heard = self.signals[name].at
            return None if heard == -math.inf else round(now - heard, 2)
        if name == "measurement":
            age, at = number(self._state.measurement_age), self._state_at
        else:
            report = self.reports.get(self.controller)
            age = None if report is None else number(report.facts.get(f"age of the {name} [s]"))
            at = now if report is None else report.at
        return None if age is None else round(age + now - at, 2)

    def _problems(self, now: float) -> Iterable[Problem]:
        for name, signal in self.signals.items():
            if abs(signal.value) >= HUGE and now - signal.at < RECENT:
                yield Problem("error", name, f"{signal.value:.3g}: diverged")
        yield from self._problems_of_ticks(now)
        for name, report in self.reports.items():
            silent = now - report.at
            if not self._outdated(report, now):
                if report.level != "ok":
                    yield Problem(report.level, name, report.text)
            elif name == self.controller or silent < FORGOTTEN:
                level = "warn" if name == self.tuner else "error"
                yield Problem(level, name, f"no diagnostics for {silent:.0f} s")

    @staticmethod
    def _outdated(report: Report, now: float) -> bool:
        return report.own and now - report.at > OUTDATED

    def _problems_of_ticks(self, now: float) -> Iterable[Problem]:
        state = self._state
        if state is None:
            return
        if self._silent(now):
            yield Problem("error", self.controller, f"no tick for {now - self._state_at:.0f} s")
            return
        if state.stale:
            age = self._age("measurement", now) or 0.0
            interval = number(state.sample_interval) or 0.0
            which = f"measurement stale, {age:.3g} s old" if age > MISSED_TICKS * interval else "an input is stale"
            yield Problem("error", self.controller, which)
        lately = sum(count for at, count in self._refusals if now - at <= RECENT)
        if lately:
            yield Problem("warn", self.controller, f"{lately} values refused in the last {RECENT:.0f} s")
        if state.saturated and now - self._free_at > PRESSED:
            yield Problem("warn", self.controller, f"the control is at a limit for {now - self._free_at:.0f} s")
