"""What people hand over, as the objects that the core computes with."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from inspect import signature
from typing import TYPE_CHECKING, TypeAlias, cast

from fopid_core.errors import InputError, did_you_mean
from fopid_core.model.fopid import Fopid, read_gains
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process, read_process

if TYPE_CHECKING:
    import control

    from fopid_core.design.specification import TuningResult

    ProcessLike: TypeAlias = Process | str | control.TransferFunction | control.StateSpace
    ControllerLike: TypeAlias = Fopid | TuningResult | str | Sequence[float]


def as_process(value: ProcessLike) -> Process:
    """A process from a process, a text or an object of python-control.

    Examples
    --------
    >>> as_process("1/(s+1)").steady_state_gain
    1.0
    """
    if isinstance(value, Process):
        return value
    if isinstance(value, str):
        return read_process(value)
    if "control" in sys.modules and type(value).__module__.partition(".")[0] == "control":
        from fopid_core.model.rational import from_control

        return from_control(value)
    raise InputError(
        f"process of type {type(value).__name__}; allowed: a text such as '1/(s+1)^3', a Process, "
        "or a TransferFunction or StateSpace of python-control"
    )


def as_controller(value: ControllerLike) -> Fopid:
    """A controller from a controller, the result of a tuning, a text or five numbers.

    Examples
    --------
    >>> as_controller("1,0.5,0,0.9,1") == as_controller((1, 0.5, 0, 0.9, 1))
    True
    """
    if isinstance(value, Fopid):
        return value
    if isinstance(value, str):
        return read_gains(value)
    if hasattr(value, "controller"):
        tuned = cast("TuningResult", value)
        if tuned.controller is None:
            raise InputError(f"a tuning without a design ({tuned.message}); allowed: one with a controller")
        return tuned.controller
    try:
        numbers = [float(number) for number in value]
    except (TypeError, ValueError):
        numbers = []
    if not 1 <= len(numbers) <= 5:
        raise InputError(f"controller {value!r}; allowed: a Fopid, a tuning, or the numbers kp, ki, kd, lam, mu")
    return Fopid(*numbers)


def as_loop(process: ProcessLike | Loop, controller: ControllerLike | None = None) -> Loop:
    """A loop from a loop, or from a process and a controller.

    Examples
    --------
    >>> as_loop("1/(s+1)", [2]).controller.kp
    2.0
    """
    if isinstance(process, Loop):
        if controller is not None:
            raise InputError("a loop and a controller; allowed: a loop alone, or a process and a controller")
        return process
    if controller is None:
        raise InputError("no controller; allowed: a process and a controller, or a loop")
    numbers = as_controller(controller)
    if hasattr(controller, "controller"):
        tuned = cast("TuningResult", controller)  # filter and setpoint weights are part of a design
        return Loop(as_process(process), numbers, tuned.filter, tuned.weights)
    return Loop(as_process(process), numbers)


def refuse_unknown(given: Sequence[str], known: Sequence[str]) -> None:
    """Refuse the first name that means nothing here."""
    for name in given:
        if name not in known:
            raise InputError(f"{name} is no argument here{did_you_mean(name, known)}; allowed: {', '.join(known)}")


def refuse_unknown_of(function: Callable[..., object], given: Iterable[str]) -> None:
    """Refuse the first name that a function does not take; its process does not count."""
    refuse_unknown(tuple(given), tuple(signature(function).parameters)[1:])
