"""Does anything but the measurement move the control: if not, a record shows the controller and not the process.

In a loop that only answers disturbances the model that fits best is -1/C (Ljung 1999, ch. 13.4).
"""

from __future__ import annotations

import numpy as np

from fopid_core.design.identification.record import Record
from fopid_core.design.identification.response import InitialCondition
from fopid_core.model.arrays import Floats

LEAST_SHARE = 1e-4
"""What moves the control by a smaller share of its surprises than this is the error of a short linear controller."""
_LAGS = 8
_PREDICTABLE = 1e-12


def external_share(record: Record, start: InitialCondition) -> float:
    """The share of the control's surprises, as a power, that no linear feedback of the measurement explains.

    A surprise is what the last controls do not tell. 1 where samples are uneven, since that hides a feedback.

    Parameters
    ----------
    record : Record
    start : InitialCondition
        What is known about the beginning: a step from rest in the first instant counts.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> noise = rng.standard_normal(500)
    >>> answer = Record(np.arange(500.0), -0.5 * noise - 0.1 * np.cumsum(noise), noise)
    >>> external_share(answer, InitialCondition(step=True)) < LEAST_SHARE
    True
    >>> round(external_share(Record(np.arange(500.0), rng.standard_normal(500), noise), InitialCondition(step=True)), 1)
    1.0
    """
    if not record.is_regular:
        return 1.0
    control, measurement = record.control, record.measurement
    if not start.step:
        control = np.concatenate([np.full(_LAGS, start.before), control])
        measurement = np.concatenate([np.full(_LAGS, measurement[0]), measurement])
    own, seen = _lagged(control)[:, 1:], _lagged(measurement)
    alone = _left(own, control[_LAGS:])
    if alone <= _PREDICTABLE * float(np.sum(np.diff(control) ** 2)):
        return 1.0
    return _left(np.column_stack([own, seen]), control[_LAGS:]) / alone


def _lagged(signal: Floats) -> Floats:
    """The signal now and before, one column for each lag, shape (n - lags, 1 + lags)."""
    return np.lib.stride_tricks.sliding_window_view(signal, _LAGS + 1)[:, ::-1]


def _left(columns: Floats, target: Floats) -> float:
    """The power that columns and a constant leave unexplained."""
    matrix = np.column_stack([np.ones(target.size), columns])
    sizes = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
    return float(np.sum((target - matrix @ (np.linalg.lstsq(matrix / sizes, target, rcond=1e-12)[0] / sizes)) ** 2))
