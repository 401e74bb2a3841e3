"""All gain sets of the run: who set them, when, and whether they were verified."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from fopid_ros.common.design_parameters import DESIGN, GAINS, LOOP, PROVENANCE, WEIGHTS

MOST_SETS = 200
"""So many are kept; the last verified one is always among them."""


@dataclass(frozen=True)
class GainSet:
    """Gains that the controller ran with.

    Attributes
    ----------
    number : int
        Counts up from 1.
    design : mapping
        By the names of the controller's parameters.
    status : str
        ``set``, ``trial`` or ``verified``; empty where the controller does not say.
    origin : str
        Who set them, and why, as whoever set them said.
    certificate : str
        A proof that they hold the loop, where there is one.
    since : float
        When they came into force [s since 1970].
    ended : str
        What a trial came to; empty otherwise.
    """

    number: int
    design: Mapping[str, float]
    status: str
    origin: str
    certificate: str
    since: float
    ended: str = ""

    @property
    def parameters(self) -> dict[str, Any]:
        """What brings them back, with what is known of them; a trial that was given up is not known to hold."""
        known = {"gains.status": "verified", "gains.certificate": self.certificate} if self.verified else {}
        return {**self.design, **known}

    @property
    def gains(self) -> dict[str, float]:
        """The five gains."""
        return {name: self.design[name] for name in GAINS if name in self.design}

    @property
    def verified(self) -> bool:
        """Whether somebody verified them."""
        return self.status == "verified"

    def told(self, present: int) -> dict[str, Any]:
        """For the page."""
        return {
            "number": self.number, "gains": self.gains, "status": self.status, "origin": self.origin,
            "proved": bool(self.certificate), "since": self.since, "ended": self.ended,
            "present": self.number == present,
        }  # fmt: skip


class GainHistory:
    """Remembers each set of gains, whoever set it; it only watches.

    Parameters
    ----------
    now : callable
        Time [s since 1970].

    Examples
    --------
    >>> history = GainHistory(lambda: 0.0)
    >>> for kp, status in ((1.0, "verified"), (2.0, "set"), (3.0, "set")):
    ...     history.record({"kp": kp, "gains.status": status})
    >>> history.previous.gains, history.last_verified.number
    ({'kp': 2.0}, 1)
    >>> history.record({"kp": 2.0})
    >>> history.previous.gains, [one.number for one in history.sets]
    ({'kp': 1.0}, [1, 2, 3, 4])
    """

    def __init__(self, now: Callable[[], float] = time.time) -> None:
        self._now, self._count = now, 0
        self.sets: list[GainSet] = []

    @property
    def present(self) -> GainSet | None:
        """The gains in force."""
        return self.sets[-1] if self.sets else None

    @property
    def previous(self) -> GainSet | None:
        """The newest before those in force, without what was gone back over; None when nothing came before."""
        trail: list[GainSet] = []
        for one in self.sets:  # going back to the set before is a step back, and what it left is gone
            if len(trail) > 1 and one.design == trail[-2].design:
                trail.pop()
            else:
                trail.append(one)
        return trail[-2] if len(trail) > 1 else None

    @property
    def last_verified(self) -> GainSet | None:
        """The newest set that was verified."""
        return next((one for one in reversed(self.sets) if one.verified), None)

    def find(self, number: int) -> GainSet | None:
        """The set of this number."""
        return next((one for one in self.sets if one.number == number), None)

    def record(self, values: Mapping[str, Any]) -> None:
        """Take note of the controller's parameters as they are now."""
        design = {name: values[name] for name in DESIGN if name in values}
        if not design:
            return
        status, origin, certificate = (str(values.get(name, "")) for name in PROVENANCE)
        now = self.present
        if now is not None and all(now.design.get(name) == design.get(name) for name in (*LOOP, *WEIGHTS)):
            ended = "kept" if now.status == "trial" and status == "verified" else now.ended
            self.sets[-1] = replace(  # held back now, or no more
                now, design=design, ended=ended, status=status, origin=origin, certificate=certificate
            )
            return
        if now is not None and now.status == "trial":
            self.sets[-1] = replace(now, ended="taken back")
        self._count += 1
        self.sets.append(GainSet(self._count, design, status, origin, certificate, self._now()))
        if len(self.sets) > MOST_SETS:
            kept = self.last_verified
            self.sets.pop(1 if self.sets[0] is kept else 0)

    def told(self) -> list[dict[str, Any]]:
        """For the page, the newest first."""
        present = self._count
        return [one.told(present) for one in reversed(self.sets)]
