"""What a page asks, read: numbers, sets of gains, a process that was typed; what cannot be used is an InputError."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from fopid_core.errors import InputError
from fopid_core.model.arrays import Floats
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process, read_process
from fopid_core.model.response import HORIZON_RANGE
from fopid_core.model.two_degrees import FILTER_ORDERS, NO_FILTER, WHOLE_SETPOINT, MeasurementFilter, SetpointWeights

MOST_SETS = 8
LONGEST_PROCESS = 2000
"""Characters of a process that is typed into a page."""

GAINS = ("kp", "ki", "kd", "lam", "mu")
_MORE = ("filter_order", "filter_time", "setpoint_weight", "derivative_setpoint_weight")
_FIELDS = ("sets", "process", "horizon", "sample_time", "quick")


@dataclass(frozen=True)
class GainSet:
    """What a controller is set to: five numbers, the filter of the measurement, the weights of the setpoint."""

    gains: Fopid
    filter: MeasurementFilter = NO_FILTER
    weights: SetpointWeights = WHOLE_SETPOINT

    @property
    def row(self) -> Floats:
        """All as the search has it, shape (1, 8), or (1, 5) where the five numbers are all."""
        row = [getattr(self.gains, name) for name in GAINS]
        if not self.filter.is_idle or self.weights != WHOLE_SETPOINT:
            row += [self.filter.time, self.weights.proportional, self.weights.derivative]
        return np.array([row])


@dataclass(frozen=True)
class PredictionRequest:
    """What shall be shown.

    Attributes
    ----------
    process : Process
    sets : tuple of GainSet
        One or more.
    horizon : float or None
        Last instant [s]; None where it is to be chosen.
    sample_time : float
        Tick of the controller as it will run [s].
    quick : bool
        Whether responses may be the search's.
    """

    process: Process
    sets: tuple[GainSet, ...]
    horizon: float | None
    sample_time: float
    quick: bool


def read_request(fields: Mapping[str, Any], process: Process | None = None) -> PredictionRequest:
    """A request for a prediction from a JSON object; its process is a text where none is given here.

    Raises
    ------
    InputError
        Naming the field, its value and what is allowed.
    """
    for name in fields:
        if name not in _FIELDS:
            raise InputError(f"field = {name[:40]!r}; allowed: {', '.join(_FIELDS)}")
    if process is None:
        text = fields.get("process")
        if not isinstance(text, str):
            raise InputError("process missing; allowed: a text such as 1/(s+1)^3")
        process = typed_process(text)
    given = fields.get("sets")
    if not isinstance(given, list) or not 1 <= len(given) <= MOST_SETS:
        raise InputError(f"sets; allowed: a list of 1 to {MOST_SETS} objects with kp, ki, kd, lam, mu")
    horizon = fields.get("horizon")
    return PredictionRequest(
        process, tuple(gain_set(one) for one in given),
        None if horizon is None else number("horizon", horizon, *HORIZON_RANGE),
        number("sample_time", fields.get("sample_time", 0.01), 1e-9, 1e9), fields.get("quick", False) is True,
    )  # fmt: skip


@lru_cache(32)
def typed_process(text: str) -> Process:
    """A process from text or P1 ... P4; files are not read for a page.

    Raises
    ------
    InputError
        An ``ExpressionError`` where it is the text.
    """
    if len(text) > LONGEST_PROCESS:
        raise InputError(f"process has {len(text)} characters; allowed: up to {LONGEST_PROCESS}")
    return read_process(text) if text.strip() in ("P1", "P2", "P3", "P4") else Process.parse(text)


def gain_set(fields: object) -> GainSet:
    """A set from a JSON object; what is missing is as a controller has it that was told nothing.

    Raises
    ------
    InputError
        For what is no number, or out of range.

    Examples
    --------
    >>> gain_set({"kp": 2, "ki": 0.5}).gains
    Fopid(kp=2.0, ki=0.5, kd=0.0, lam=1.0, mu=1.0)
    """
    if not isinstance(fields, Mapping):
        raise InputError("a set of gains; allowed: an object with kp, ki, kd, lam, mu")
    for name in fields:
        if name not in (*GAINS, *_MORE):
            raise InputError(f"field = {str(name)[:40]!r}; allowed: {', '.join((*GAINS, *_MORE))}")
    kp, ki, kd, lam, mu = (
        number(name, fields.get(name, 1.0 if name in ("lam", "mu") else 0.0)) for name in GAINS
    )  # fmt: skip
    order = number("filter_order", fields.get("filter_order", 0))
    if order not in FILTER_ORDERS:
        raise InputError(f"filter_order = {order:g}; allowed: 0, 1 or 2")
    slow = MeasurementFilter(int(order), number("filter_time", fields.get("filter_time", 0.0)))
    weights = [number(name, fields.get(name, 1.0)) for name in _MORE[2:]]
    return GainSet(Fopid(kp, ki, kd, lam, mu), slow, SetpointWeights(*weights))


def number(name: str, value: object, low: float = -math.inf, high: float = math.inf) -> float:
    """A finite number from JSON, within a range."""
    good = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max
    if not good or not low <= value <= high:  # type: ignore[operator]
        allowed = "a number" if math.isinf(low) else f"{low:g} to {high:g}"
        raise InputError(f"{name} = {str(value)[:40]}; allowed: {allowed}")
    return float(value)  # type: ignore[arg-type]
