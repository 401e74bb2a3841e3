"""What comes back with the gains from before a trial: the integral that they held the plant with."""

from __future__ import annotations

from collections import deque

from fopid_core.model.fopid import Fopid
from fopid_core.model.two_degrees import MeasurementFilter
from fopid_core.runtime.settings import ControllerSettings

DEEPEST = 8
"""So many trials, each begun during the last, are remembered."""

_Loop = tuple[Fopid, MeasurementFilter]


class GainTrial:
    """Where the integral was when gains were put on trial.

    Gains that are taken back have often driven the control to where it must not stay, and those from before may be too
    weak to bring it home in time: they go on as if the trial had never been.

    Examples
    --------
    >>> from dataclasses import replace
    >>> before = ControllerSettings(Fopid(0.1, 0.05))
    >>> on_trial, trial = replace(before, gains=Fopid(5.5, 80.0), on_trial=True), GainTrial()
    >>> trial.change(before, on_trial, integral=0.12)
    >>> trial.change(on_trial, before, integral=-2.6)
    0.12
    """

    def __init__(self) -> None:
        self._before: deque[tuple[_Loop, float]] = deque(maxlen=DEEPEST)

    def forget(self) -> None:
        """The integral is to go on from where it is, whichever gains come."""
        self._before.clear()

    def change(self, before: ControllerSettings, after: ControllerSettings, integral: float) -> float | None:
        """Settings change: where the integral goes on from, if that takes a trial back; None where it does not.

        Parameters
        ----------
        before, after : ControllerSettings
        integral : float
            Where it is.
        """
        level, loop = None, _loop(after)
        if loop != _loop(before):
            known = [each for each, _ in self._before]
            if before.on_trial and loop in known:
                while self._before[-1][0] != loop:
                    self._before.pop()
                level = self._before.pop()[1]
            elif after.on_trial:
                self._before.append((_loop(before), integral))
        if not after.on_trial:
            self.forget()
        return level


def _loop(settings: ControllerSettings) -> _Loop:
    return settings.gains, settings.measurement_filter
