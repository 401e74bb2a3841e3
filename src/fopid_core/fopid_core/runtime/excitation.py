"""Experiments that make a loop show what its process does: relay, step and pseudo-random moves, within bounds.

Each adds something to the setpoint or to the control, tick by tick; time is passed in. An experiment ends when it is
over, and at once when the measurement leaves its band.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

from fopid_core.errors import InputError

Kind = Literal["relay", "step", "prbs"]
ActsOn = Literal["setpoint", "control"]

_TAPS = {3: 2, 4: 3, 5: 3, 6: 5, 7: 6, 9: 5, 10: 7, 11: 9}
"""Orders of shift registers and the second tap that makes their sequence as long as can be."""


@dataclass(frozen=True)
class ExcitationSettings:
    """An experiment around the operating point.

    Attributes
    ----------
    kind : {"relay", "step", "prbs"}
        ``relay``: up while the measurement is below the setpoint and down while it is above, until it has switched
        ``switches`` times. ``step``: up for ``hold``, then back for ``hold``. ``prbs``: up and down by a shift register
        of the given ``order``, each bit for ``hold``.
    amplitude : float
        How far up and down, in units of what it acts on. For a relay with the sign of the process's gain.
    low, high : float
        The band that the measurement must not leave.
    hold : float
        [s]; for a relay the longest time between two switches.
    acts_on : {"setpoint", "control"}
        What the added value is added to. A relay acts on the control, with the controller in manual.
    rest : float
        Time before anything is moved [s].
    switches, order : int
    hysteresis : float
        How far the measurement must pass the setpoint before a relay switches: more than the noise.
    """

    kind: Kind
    amplitude: float
    low: float
    high: float
    hold: float
    acts_on: ActsOn = "setpoint"
    rest: float = 0.0
    switches: int = 8
    order: int = 6
    hysteresis: float = 0.0

    def __post_init__(self) -> None:
        for name, allowed in (("kind", get_args(Kind)), ("acts_on", get_args(ActsOn))):
            if getattr(self, name) not in allowed:
                raise InputError(f"{name} = {getattr(self, name)!r}; allowed: {', '.join(allowed)}")
        if self.kind == "relay" and self.acts_on != "control":
            raise InputError("acts_on = 'setpoint' for a relay; allowed: control")
        if not (math.isfinite(self.amplitude) and self.amplitude):
            raise InputError(f"amplitude = {self.amplitude}; allowed: a finite number other than 0")
        if not self.low < self.high:
            raise InputError(f"low = {self.low}, high = {self.high}; allowed: low < high")
        for name, least in (("hold", 0.0), ("rest", -1e-300), ("hysteresis", -1e-300)):
            if not least < getattr(self, name) < math.inf:
                raise InputError(f"{name} = {getattr(self, name)}; allowed: {'above 0' if least == 0 else '0 or more'}")
        if self.order not in _TAPS:
            raise InputError(f"order = {self.order}; allowed: {', '.join(map(str, _TAPS))}")
        if self.switches < 2:
            raise InputError(f"switches = {self.switches}; allowed: 2 or more")

    @property
    def duration(self) -> float:
        """How long it takes [s]; a relay at most so long."""
        holds = {"relay": self.switches, "step": 2, "prbs": (1 << self.order) - 1}[self.kind]
        return self.rest + holds * self.hold


class Excitation:
    """A running experiment: ``added = excitation.step(setpoint, measurement, control, time)``.

    Parameters
    ----------
    settings : ExcitationSettings

    Attributes
    ----------
    finished : bool
        Whether it is over; nothing is added from then on.
    completed : bool
        Whether it came to its proper end.
    outside : bool
        Whether it ended since the measurement left its band.
    reason : str
        Why it ended; empty while it runs.

    Examples
    --------
    >>> excitation = Excitation(ExcitationSettings("step", 0.5, low=-1.0, high=1.0, hold=2.0, rest=1.0))
    >>> excitation.settings.duration
    5.0
    >>> [excitation.step(0.0, 0.0, 0.0, time) for time in (10.0, 11.0, 12.0, 13.0, 15.0)]
    [0.0, 0.5, 0.5, 0.0, 0.0]
    >>> excitation.finished, excitation.reason
    (True, 'over after 5 s')
    """

    def __init__(self, settings: ExcitationSettings) -> None:
        self.settings = settings
        self.finished, self.completed, self.outside, self.reason = False, False, False, ""
        self._begin: float | None = None
        self._elapsed = 0.0
        self._bits = _shift_register(settings.order) if settings.kind == "prbs" else []
        self._up = True
        self._switches: list[float] = []

    @property
    def progress(self) -> float:
        """Share of the announced duration that has passed, 0 to 1."""
        return 1.0 if self.finished else min(self._elapsed / self.settings.duration, 1.0)

    @property
    def period(self) -> float:
        """Of a relay's oscillation, from its last two full swings [s]; NaN before there are any."""
        last = self._switches[-5:]
        return 2.0 * (last[-1] - last[0]) / (len(last) - 1) if len(last) >= 3 else math.nan

    def step(self, setpoint: float, measurement: float, control: float, time: float) -> float:
        """One tick.

        Parameters
        ----------
        setpoint : float
            Of the operating point, without what was added.
        measurement, control : float
        time : float
            [s], on any clock that only goes forward.

        Returns
        -------
        float
            What to add to the setpoint or to the control until the next tick; 0 when it is over.

        Raises
        ------
        InputError
            If a signal is not finite.
        """
        if not math.isfinite(setpoint + measurement + control + time):
            given = f"setpoint = {setpoint}, measurement = {measurement}, control = {control}, time = {time}"
            raise InputError(f"{given}; allowed: finite numbers")
        if self._begin is None:
            self._begin = time
        self._elapsed = time - self._begin
        self._check_band(measurement)
        if self.finished or self._elapsed < self.settings.rest:
            return 0.0
        since = self._elapsed - self.settings.rest
        added = {"relay": self._relay, "step": self._step, "prbs": self._prbs}[self.settings.kind]
        return self.settings.amplitude * added(since, setpoint - measurement)

    def cancel(self) -> None:
        """End it now."""
        if not self.finished:
            self._end("cancelled", completed=False)

    def _check_band(self, measurement: float) -> None:
        low, high = self.settings.low, self.settings.high
        if not self.finished and not low <= measurement <= high:
            band, self.outside = f"{low:g} to {high:g}", True
            self._end(f"measurement {measurement:.4g} left the band {band} after {self._elapsed:.4g} s", False)

    def _end(self, reason: str, completed: bool) -> float:
        self.finished, self.completed, self.reason = True, completed, reason
        return 0.0

    def _over(self) -> float:
        return self._end(f"over after {self._elapsed:.4g} s", completed=True)

    def _step(self, since: float, error: float) -> float:
        del error
        hold = self.settings.hold
        if since >= 2.0 * hold:
            return self._over()
        return 1.0 if since < hold else 0.0

    def _prbs(self, since: float, error: float) -> float:
        del error
        place = int(since / self.settings.hold)
        return self._bits[place] if place < len(self._bits) else self._over()

    def _relay(self, since: float, error: float) -> float:
        """Up until the measurement has risen past the setpoint, down until it has fallen past it."""
        if error < -self.settings.hysteresis if self._up else error > self.settings.hysteresis:
            self._up = not self._up
            self._switches.append(since)
        if len(self._switches) >= self.settings.switches:
            return self._over()
        if since - (self._switches[-1] if self._switches else 0.0) >= self.settings.hold:
            return self._end(f"the relay did not switch within {self.settings.hold:g} s", completed=False)
        return 1.0 if self._up else -1.0


def _shift_register(order: int) -> list[float]:
    """The longest sequence of a shift register, as 1 and -1."""
    state, tap, bits = [1] * order, _TAPS[order], []
    for _ in range((1 << order) - 1):
        bits.append(1.0 if state[-1] else -1.0)
        state = [state[order - 1] ^ state[tap - 1], *state[:-1]]
    return bits
