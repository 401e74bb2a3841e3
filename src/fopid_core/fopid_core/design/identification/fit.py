"""The fit of one structure to a record: separable least squares (Golub and Pereyra 1973, Kaufman 1975).

Gains, offset and what the beginning adds are linear, so for given time constants, orders and delay they are known;
only the latter are searched. Kaufman's Jacobian leaves out what the linear numbers gain by moving along.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares

from fopid_core.design.identification.response import RecordResponse
from fopid_core.design.identification.structure import Structure
from fopid_core.model.arrays import Booleans, Floats
from fopid_core.model.process import Process

NO_DELAY = 1e-3
"""A delay of a smaller share of the sample time is none: it changes no sample, and responses behind it take minutes."""
_DEPENDENT = 1e-7
"""Columns whose singular value is this share of the largest are as good as dependent."""


@dataclass(frozen=True)
class Fit:
    """A structure with numbers, and what it leaves unexplained.

    Attributes
    ----------
    response : RecordResponse
    x : ndarray
        The structure's free numbers.
    coefficients : ndarray
        The linear numbers: gains, beginning, offset and ramp.
    residual : ndarray, shape (n,)
        Measurement less model, on all samples.
    error : float
        Root mean square of the residual on the samples that were fitted.
    rows : ndarray of bool, shape (n,)
        These samples.
    """

    response: RecordResponse
    x: Floats
    coefficients: Floats
    residual: Floats
    error: float
    rows: Booleans

    @property
    def structure(self) -> Structure:
        """What was fitted."""
        return self.response.structure

    @property
    def gains(self) -> Floats:
        """The numerator's coefficients."""
        return self.coefficients[: self.structure.zeros + 1]

    @property
    def ramp(self) -> float:
        """How fast the operating point moves, in units of the measurement per second."""
        return float(self.coefficients[-1] / self.response.time[-1]) if self.response.start.ramp else 0.0

    @cached_property
    def process(self) -> Process:
        """The model."""
        return self.structure.process(self.x, self.gains)

    @cached_property
    def sensitivity(self) -> Floats:
        """Derivatives of the model's output with respect to the free numbers and the linear ones, shape (n, k)."""
        free = self.response.slopes(self.x, self.coefficients)
        return np.column_stack([free, self.response.columns(self.x)])


def fit(response: RecordResponse, start: Floats, rows: Booleans, evaluations: int, tolerance: float = 1e-9) -> Fit:
    """The best numbers near a start, on some of the samples.

    Parameters
    ----------
    response : RecordResponse
    start : ndarray
        Of the free numbers.
    rows : ndarray of bool, shape (n,)
        The samples that count.
    evaluations : int
        How many times at most the model is evaluated.
    tolerance : float
        Relative change of the squared error at which to stop.
    """
    low, high = response.structure.bounds(response.sample_time, float(response.time[-1]))
    projection = _Projection(response, rows)
    inside = np.clip(start, low + 1e-9 * (high - low), high - 1e-9 * (high - low))
    size = float(np.ptp(response.measurement)) or 1.0  # when to stop must not depend on the measurement's unit

    def residual(x: Floats) -> Floats:
        return projection.residual(x) / size

    def jacobian(x: Floats) -> Floats:
        return projection.jacobian(x) / size

    found = least_squares(
        residual,
        inside,
        jacobian,
        bounds=(low, high),
        x_scale="jac",
        max_nfev=evaluations,
        ftol=tolerance,
        xtol=1e-9,
        gtol=1e-12,
    )
    x = found.x
    if x[-1] < NO_DELAY * response.sample_time:
        x[-1] = 0.0
    return at(response, x, rows)


def at(response: RecordResponse, x: Floats, rows: Booleans) -> Fit:
    """The linear numbers that fit best, at given free ones."""
    projection = _Projection(response, rows)
    error = float(np.sqrt(np.mean(projection.residual(x) ** 2)))
    coefficients = projection.coefficients
    return Fit(response, x, coefficients, response.target(x) - projection.columns @ coefficients, error, rows)


class _Projection:
    """The residual without what the linear numbers explain, by the singular values of their columns."""

    def __init__(self, response: RecordResponse, rows: Booleans) -> None:
        self._response, self._rows = response, rows

    def residual(self, x: Floats) -> Floats:
        self.columns: Floats = self._response.columns(x)
        columns = self.columns[self._rows]
        sizes = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        left, values, right = np.linalg.svd(columns / sizes, full_matrices=False)
        kept = values > _DEPENDENT * values[0]
        self._left = left[:, kept]
        target = self._response.target(x)[self._rows]
        explained = self._left.T @ target
        self.coefficients: Floats = right[kept].T @ (explained / values[kept]) / sizes
        residual: Floats = target - self._left @ explained
        return residual

    def jacobian(self, x: Floats) -> Floats:
        slopes = self._response.slopes(x, self.coefficients)[self._rows]
        projected: Floats = self._left @ (self._left.T @ slopes) - slopes
        return projected
