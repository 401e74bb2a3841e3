"""A process learnt from a record, behind a filter that leaves white noise where its residual would have memory."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from fopid_core.design.identification.coloured_noise import behind
from fopid_core.design.identification.coloured_noise import whitener as whitener_of
from fopid_core.design.identification.identified_model import IdentifiedModel
from fopid_core.design.identification.identify import IdentificationResult, refit
from fopid_core.design.identification.record import Record
from fopid_core.design.identification.response import InitialCondition
from fopid_core.model.arrays import Floats

_SECOND = 0.15
"""A second lag with which a fit begins anew, as a share of the first."""


@dataclass(frozen=True)
class WhiteFit:
    """A process learnt from a record, behind a filter where its residual would have memory without.

    Of a residual with memory, least squares make more than it says, and loads that wander pull at the model. A filter
    of both signals leaves a linear process as it is: generalised least squares (Clarke 1967).
    """

    identified: IdentificationResult
    record: Record
    whitener: Floats

    def again(self, record: Record, start: InitialCondition) -> WhiteFit:
        """Fitted to another record, of the same beginning, behind the same filter."""
        if self.whitener.size > 1:
            record = _filtered(record, self.whitener)
            start = InitialCondition(float(record.control[0]), step=True, free=True)
        return replace(self, identified=refit(record, self.best, start, self._begins()), record=record)

    def _begins(self) -> tuple[Floats, Floats]:
        """The numbers as they are, and with a second lag taken from the delay: none at all is an end without slope."""
        log_tau, log_c, delay = self.best.numbers.tolist()
        lag = math.exp(log_tau + log_c)
        second = _SECOND * lag
        log_mean = 0.5 * math.log(lag * second)
        return self.best.numbers, np.array([log_mean, math.log(lag + second) - log_mean, max(delay - second, 0.0)])

    def whiter(self, record: Record, start: InitialCondition) -> WhiteFit:
        """Behind a filter that takes the memory out of the residual."""
        _, measured, modelled = self.best.simulated
        whitener = np.convolve(self.whitener, whitener_of(measured - modelled))
        return replace(self, whitener=whitener).again(record, start)

    @property
    def best(self) -> IdentifiedModel:
        """The model."""
        assert self.identified.best is not None
        return self.identified.best


def _filtered(record: Record, whitener: Floats) -> Record:
    """Control and measurement behind a filter; without the samples it takes to begin."""
    first = whitener.size - 1
    control, measurement = behind(
        whitener, np.stack([record.control, record.measurement]) - [[record.control[0]], [record.measurement[0]]]
    )
    return Record(record.time[first:], control, measurement)
