"""How fast a loop a record may answer for: one that ran slowly shows little of what a much faster one would meet."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fopid_core.design.identification.frequency_response import frequency_response
from fopid_core.design.identification.identified_model import IdentifiedModel
from fopid_core.design.identification.record import Record
from fopid_core.design.recorded_law import recorded_law
from fopid_core.design.sampled_loop import sampled_process
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process
from fopid_core.model.two_degrees import MeasurementFilter

FASTER = 5.0
"""A record of a loop answers for its process up to so many times that loop's crossover, and as far as it shows it."""
SHARE = 0.6
"""Of a loop gain of 1 beyond that each part of a controller may have, when gains are searched for: the parts add up."""
CLOSE = 95.0
"""From this fit [%] on a process is taken for a lag where the record does not show it."""
STAYS = 2.0
"""Below that its gain is taken to stay, and a loop gain of so much beyond is allowed: no process keeps it for ever."""
_POINTS = 400


@dataclass(frozen=True)
class RecordedReach:
    """Up to where a record answers for its process.

    Attributes
    ----------
    frequency : float
        [rad/s]; infinite where nothing is known of the loop that ran.
    gain : float
        Of the process there.
    sample_time : float
        Of the record [s].
    falls : bool
        Whether the process is taken for a lag beyond that; else its gain stays: in noise a model has the fall of its
        template, and a dead time before a short lag has none for long.
    """

    frequency: float = math.inf
    gain: float = 0.0
    sample_time: float = 1.0
    falls: bool = True

    def refusal(self, controller: Fopid | None, slow: MeasurementFilter) -> str:
        """Why a controller works too fast: a loop gain above 1 further out.

        Examples
        --------
        >>> from fopid_core.model.two_degrees import NO_FILTER
        >>> reach = RecordedReach(0.1, gain=0.5, sample_time=1.0)
        >>> reach.refusal(Fopid(1.9), NO_FILTER)
        ''
        >>> reach.refusal(Fopid(2.1), NO_FILTER)
        'it works beyond 0.1 rad/s, far faster than the loop that ran and than what the record shows without a model'
        """
        nyquist = math.pi / self.sample_time
        if controller is None or self.frequency >= nyquist:
            return ""
        w = np.geomspace(self.frequency, nyquist, _POINTS)
        gain = self.gain * (self.frequency / w if self.falls else 1.0 / STAYS)
        if (np.abs(controller(1j * w) * slow(1j * w)) * gain).max() <= 1.0:
            return ""
        said = "far faster than the loop that ran and than what the record shows without a model"
        return f"it works beyond {self.frequency:.3g} rad/s, {said}"

    def boxes(self, process: Process) -> list[dict[str, tuple[float, float]]]:
        """Ranges of the gains in which a search finds few that are refused, to be tried in turn."""
        if math.isinf(self.frequency):
            return []
        most, sign = SHARE / self.gain, math.copysign(1.0, process.steady_state_gain)
        sizes = {"kp": most, "ki": most * self.frequency, "kd": most / self.frequency}
        box = {name: (min(0.0, sign * size), max(0.0, sign * size)) for name, size in sizes.items()}
        return [box] if self.falls else [box, {**box, "kd": (0.0, 0.0)}]


def recorded_reach(record: Record, learnt: IdentifiedModel) -> RecordedReach:
    """Up to where a record answers for the process that was learnt from it.

    Parameters
    ----------
    record : Record
        Where the law shows by which its control was made, that of the loop that ran.
    learnt : IdentifiedModel

    References
    ----------
    Lee, W. S., Anderson, B. D. O., Kosut, R. L., Mareels, I. M. Y. A new approach to adaptive robust control. Int. J.
    Adaptive Control and Signal Processing 7 (1993) 183-211: the bandwidth widened in rounds.
    """
    law, h = recorded_law(record, in_part=True), record.sample_time
    if law is None:
        return RecordedReach()
    w = np.geomspace(math.pi / record.span, math.pi / h, _POINTS)
    gain = np.abs(sampled_process(learnt.process, h, w * h))
    crossed = w[np.abs(law.response(w * h)) * gain >= 1.0]
    seen = frequency_response(record)
    shown = seen.frequency[seen.known & ~seen.outside(learnt.process)]
    reach = max(FASTER * float(crossed.max(initial=w[0])), float(shown.max(initial=0.0)))
    return RecordedReach(reach, float(np.interp(reach, w, gain)), h, learnt.fit_pct >= CLOSE)
