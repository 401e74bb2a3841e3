"""GL's differences solved one sample after the other in double precision, and what rounding makes of the indices."""

from __future__ import annotations

from functools import cache

import numpy as np

from fopid_core.model.arrays import Floats
from fopid_core.model.evaluation import PAPER_STEP
from fopid_core.model.indices import indices
from fopid_core.model.loop import Loop
from fopid_core.model.quasipolynomial import QuasiPolynomial
from fopid_core.study.reproduce.facts import HORIZON, PrintedTuning
from fopid_core.study.reproduce.time_table import index_value


def recursive_output(loop: Loop, count: int, step: float) -> Floats:
    """The output at ``count`` samples after a unit step of the setpoint, 0 at first, without delay.

    The same differences as ``gl1_response``, which has them to 1e-9. Here each is summed from its newest term on, as a
    plain loop over the past does. A difference of order a has the factor ``step**-a``, and the last bits of the output
    with it.

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> from fopid_core.model.process import Process
    >>> recursive_output(Loop(Process.parse("1/(s+1)"), Fopid(kp=1.0)), 3, 0.5).round(6).tolist()
    [0.0, 0.25, 0.375]
    """
    scale, weights = _differences(loop.characteristic, count, step)
    forward_scale, forward_weights = _differences(loop.open_loop_numerator, count, step)
    driven = np.cumsum(forward_scale @ forward_weights)
    output = np.zeros(count)
    for k in range(1, count):
        past = np.cumsum(weights[:, 1 : k + 1] * output[:k][::-1], axis=1)[:, -1]
        output[k] = (driven[k - 1] - (scale * past).sum()) / scale.sum()
    return output


def _differences(function: QuasiPolynomial, count: int, step: float) -> tuple[Floats, Floats]:
    """Of each term: its coefficient times ``step**-order``, and the binomial weights (-1)^j (order over j)."""
    orders = np.array([term.order for term in function.terms])
    coefficients = np.array([term.coefficient for term in function.terms])
    j = np.arange(1.0, count)
    factors = np.hstack((np.ones((orders.size, 1)), 1.0 - (orders[:, None] + 1.0) / j))
    return coefficients / step**orders, np.cumprod(factors, axis=1, dtype=np.float64)


@cache
def recursive_index(tuning: PrintedTuning) -> float:
    """The index of a row of Tables 4 to 7, computed so."""
    output = recursive_output(tuning.loop, round(HORIZON / PAPER_STEP) + 1, PAPER_STEP)
    time = PAPER_STEP * np.arange(output.size)
    return index_value(indices(time, 1.0 - output), tuning.index)
