"""Gains held against what a record shows without a model, where the model that was learnt does not show it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fopid_core.design.identification.frequency_response import FrequencyResponse
from fopid_core.design.specification import TuningResult
from fopid_core.model.process import Process

BEYOND = 0.05
"""A model leaves a region when it is further out than this share of the response, besides."""
FEWEST, SHARE = 3, 0.3
"""So many frequencies must be left, and such a share of those known, for its structure to be wrong."""


def contradicts(response: FrequencyResponse, process: Process) -> str:
    """How a model contradicts the response without one; empty where it does not."""
    outside, known = int(response.outside(process, BEYOND).sum()), int(response.known.sum())
    if outside <= max(FEWEST, SHARE * known):
        return ""
    return f"the model leaves what the record shows without one at {outside} of {known} frequencies"


def held_without_a_model(response: FrequencyResponse, ms_max: float) -> Callable[[TuningResult], str]:
    """A judge of designs: why one may not be used, or nothing.

    At each known frequency |S| is bounded over the whole disc: 1 / (|1 + C F G| - |C F| r), with C as it is in
    continuous time and G behind its hold. Nothing is said between the frequencies, nor of stability.

    Parameters
    ----------
    response : FrequencyResponse
    ms_max : float

    Examples
    --------
    >>> from fopid_core.design.specification import TuningRequest
    >>> from fopid_core.design.tuner import tune
    >>> w = np.geomspace(0.1, 5.0, 15)
    >>> seen = FrequencyResponse(w, 1.0 / (1j * w + 1.0) ** 3, np.full(15, 0.01), 0.01, 10)
    >>> judge = held_without_a_model(seen, 2.2)
    >>> judge(tune(TuningRequest(Process.parse("1/(s+1)^3"), "rule", rule="simc-pi")))
    ''
    >>> judge(tune(TuningRequest(Process.parse("0.4/(s+1)^3"), "rule", rule="simc-pi")))
    'max |S| above 2.2 at 1.24 rad/s, by what the record shows without a model'
    """
    known = response.known
    w, seen, radius = response.frequency[known], response.response[known], response.radius[known]

    def judge(tuning: TuningResult) -> str:
        if tuning.controller is None:
            return ""
        controller = tuning.controller(1j * w) * tuning.filter(1j * w)
        nearest = np.abs(1.0 + controller * seen) - np.abs(controller) * radius
        worst = int(np.argmin(nearest))
        if nearest[worst] * ms_max >= 1.0:
            return ""
        return f"max |S| above {ms_max:g} at {w[worst]:.3g} rad/s, by what the record shows without a model"

    return judge
