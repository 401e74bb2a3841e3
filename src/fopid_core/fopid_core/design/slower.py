"""A design made slower, for a loop that did not bear it as it was, or a record that forbids it; or hardly another."""

from __future__ import annotations

from dataclasses import replace

from fopid_core.design.specification import NUMBERS, TuningRequest, TuningResult, require
from fopid_core.design.tuner import verify
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.two_degrees import MeasurementFilter

_ABOUT, _ALIKE = (0.3, 1.0, 3.0), 0.2


def slower_gains(controller: Fopid, share: float) -> Fopid:
    """A C(s / a): with a process that falls like 1/s about the crossover the same loop, 1/a times as slow.

    Parameters
    ----------
    controller : Fopid
    share : float
        a, the share of its speed that is left.

    Examples
    --------
    >>> slower_gains(Fopid(kp=2.0, ki=4.0, kd=1.0), 0.5).gains[:3]
    (1.0, 1.0, 1.0)
    """
    require(0.0 < share <= 1.0, "share", share, "above 0, 1 at most")
    kp, ki, kd, lam, mu = controller.gains
    return Fopid(share * kp, share ** (1.0 + lam) * ki, share ** (1.0 - mu) * kd, lam, mu)


def act_alike(one: Fopid, other: Fopid, crossover: float) -> bool:
    """Whether two controllers make about the same loop: their answers are within a fifth about a crossover [rad/s].

    Examples
    --------
    >>> before = Fopid(kp=2.0, ki=1.0)
    >>> act_alike(Fopid(kp=2.2, ki=1.0), before, 1.0), act_alike(Fopid(kp=2.0, ki=1.0, kd=0.5), before, 1.0)
    (True, False)
    """
    answers = ((complex(one(1j * w)), complex(other(1j * w))) for w in (share * crossover for share in _ABOUT))
    return all(abs(answer - before) < _ALIKE * abs(before) for answer, before in answers)


def slower_design(request: TuningRequest, design: TuningResult, share: float) -> tuple[TuningRequest, TuningResult]:
    """A design for the request's process with its filter so much slower; and the request that leaves no other.

    Raises
    ------
    InputError
        If the design has no gains.
    """
    if design.controller is None:
        raise InputError("a tuning without gains; allowed: one that succeeded")
    controller, slow = slower_gains(design.controller, share), design.filter
    fixed = dict(zip(NUMBERS, controller.gains, strict=True))
    wanted = replace(request, method="time", rule=None, solver=None, structure=design.structure or None, fixed=fixed)
    slow, said = MeasurementFilter(slow.order, slow.time / share), f"{share:g} times as fast as {design.controller}"
    return wanted, replace(verify(wanted, controller, slow, design.weights, said), structure=design.structure)
