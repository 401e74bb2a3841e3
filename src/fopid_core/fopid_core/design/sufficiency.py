"""Does a record say enough for a design: then the experiment that makes it may end.

The length of an experiment is what buys small variances (Ljung 1999, ch. 13.7); but a covariance sees no bias, such as
that of a record too short for the slow end of its process. So three things are asked where a controller works, from a
tenth of the crossover on: all processes that the record leaves possible are alike there, the process was the
same when the record was shorter, and the record is longer than what the process takes to come to rest.

It says when to stop moving a loop, no more: gains are judged afterwards, on all processes that the record leaves
possible.
"""

from __future__ import annotations

import math

import numpy as np

from fopid_core.design.identification.identified_model import IdentifiedModel
from fopid_core.design.identification.identify import behind_slow_actuator, identify
from fopid_core.design.identification.record import Record
from fopid_core.design.identification.refusal import NOISES
from fopid_core.design.robust_verification import RobustLimits, plausible_processes
from fopid_core.model.arrays import Floats
from fopid_core.model.process import Process

SPREAD, DISPUTED, CHANGE = 0.15, 0.2, 0.1
"""By how much of its size the process may be uncertain by its covariance (a standard deviation), differ from another
structure that explains as much, and from what it was taken for at the look before."""
LOWEST, PLACES = 0.1, 11
"""Frequencies at which processes are compared: from so many crossovers to one, and how many."""
EXPLAINS = 90.0
"""Where any process is enough, one that explains less [%] and leaves what is no noise is not: it lacks something that a
longer record may show, friction or an actuator that is slow."""
RESIDENCES = 3.0
"""Length of the record in average residence times of the process: 95 % of a lag's answer."""
CLOSER, IN_VAIN = 2, 5
"""After so many looks in a row that showed no process, all that follow look for dry friction and for processes that run
away as well, which takes longer; and after so many no more is expected of moves as small as these."""


class Sufficiency:
    """Looks at a growing record: ``enough = sufficiency.look(record)``.

    Parameters
    ----------
    template : str
        What is learnt, as `identify` takes it.
    noise : float
        Standard deviation of the measurement's noise.
    hold : float
        For how long the controller holds its control [s].

    Attributes
    ----------
    missing : str
        What the last look found missing; empty where nothing was.

    Examples
    --------
    >>> import math
    >>> time, added = np.arange(60.0), np.repeat([1.0, 0.0, 1.0, 1.0, 0.0, 0.0], 10)
    >>> states = [0.0]
    >>> for u in added[:-1]:
    ...     states.append(states[-1] * math.exp(-0.2) + 2.0 * -math.expm1(-0.2) * u)
    >>> measured = np.array(states) + 0.01 * np.random.default_rng(0).standard_normal(60)
    >>> sufficiency = Sufficiency("foptd", 0.01, 1.0)
    >>> [sufficiency.look(Record(time[:n], added[:n], measured[:n], control_before=0.0)) for n in (30, 45)]
    [False, True]
    """

    def __init__(self, template: str, noise: float, hold: float) -> None:
        self._template, self._noise, self._hold = template, noise, hold
        self._limits = RobustLimits()
        self._before: Process | None = None
        self._failed, self._closely = 0, False
        self.missing = "no look yet"

    @property
    def is_vain(self) -> bool:
        """Whether so many looks in a row have shown no process that no more is expected."""
        return self._failed >= IN_VAIN

    def is_over(self, record: Record, may_widen: bool, content: float = 1.0) -> bool:
        """Whether the record says enough, or nothing will in moves as small as these, where these may be larger."""
        return self.look(record, content) or (self.is_vain and may_widen)

    def look(self, record: Record, content: float = 1.0) -> bool:
        """Whether the record says enough; each look is at a longer one than the look before.

        Parameters
        ----------
        record : Record
        content : float
            Processes may differ by so many times what is wanted, and the record be so many times shorter; infinite
            where any process is enough, however uncertain, but for one that lacks something.
        """
        self._closely = self._closely or self._failed >= CLOSER
        found = identify(record, self._template, noise=self._noise, unstable=self._closely)
        before, self._before = self._before, None
        self._failed += 1
        if found.success and found.best is not None and not found.best.whiteness.white:
            found = behind_slow_actuator(record, found, self._template, self._noise) or found
        if not found.success or found.best is None:
            self.missing = found.message
            return False
        self._failed = 0
        process = self._before = found.best.process
        frequencies = found.best.crossover * np.geomspace(LOWEST, 1.0, PLACES)
        held, *others = plausible_processes(found, self._limits, self._hold)
        drawn, disputed = others[: self._limits.samples], others[self._limits.samples :]
        spread = float(np.sqrt(np.mean([differences(other, held, frequencies) ** 2 for other in drawn], axis=0)).max())
        dispute = max((float(differences(other, held, frequencies).max()) for other in disputed), default=0.0)
        change = 0.0 if before is None else float(differences(before, process, frequencies).max())
        needed = RESIDENCES / content * residence_time(process, found.best.crossover)
        self.missing = ""
        if before is None and content < math.inf:
            self.missing = "nothing to compare the process with: no shorter record showed one"
        elif spread > SPREAD and content < math.inf:
            self.missing = f"the process is known to {100 * spread:.0f} % of its size ({100 * SPREAD:.0f} % is wanted)"
        elif dispute > content * DISPUTED:
            self.missing = f"a process that differs by {100 * dispute:.0f} % explains the record as well"
        elif change > content * CHANGE:
            self.missing = f"the process differs by {100 * change:.0f} % from what a shorter record showed"
        elif content == math.inf and _lacks_something(found.best, self._noise):
            fit = f"{found.best.fit_pct:.0f} %"
            self.missing = f"the model explains {fit} of the measurement, and what it leaves is no noise"
        elif needed > record.span:
            self.missing = f"the process needs {needed:.3g} s to come to rest, and the record has {record.span:.3g} s"
        return not self.missing


def _lacks_something(model: IdentifiedModel, noise: float) -> bool:
    return model.fit_pct < EXPLAINS and not model.whiteness.white and model.noise > NOISES * noise


def differences(one: Process, other: Process, frequencies: Floats) -> Floats:
    """Of their frequency responses at these frequencies [rad/s], shape (n,), as shares of the other's size.

    Examples
    --------
    >>> differences(Process.parse("1.2/(s+1)"), Process.parse("1/(s+1)"), np.array([0.1, 1.0])).round(3)
    array([0.2, 0.2])
    """
    s = 1j * frequencies
    return np.asarray(np.abs(one(s) / other(s) - 1.0))


def residence_time(process: Process, crossover: float) -> float:
    """Average residence time, the delay and all lags [s], as the phase at a tenth of the crossover [rad/s] shows it.

    Of a lag that is much slower than that no more than a quarter of a turn is seen, 16 over the crossover; of a process
    that integrates, what lags beside that.

    References
    ----------
    Astrom, K. J., Hagglund, T. Advanced PID control. ISA, 2006, ch. 2.

    Examples
    --------
    >>> round(residence_time(Process.parse("3/((2s+1)(5s+1))*exp(-s)"), 0.5), 1)
    7.9
    >>> round(residence_time(Process.parse("3/(1000s+1)"), 0.5))
    31
    """
    slow, slowest = LOWEST * crossover, 1e-4 * LOWEST * crossover
    turned = process(1j * slow) / process(1j * slowest)
    return max(-float(np.angle(complex(turned))) / slow, 0.0)
