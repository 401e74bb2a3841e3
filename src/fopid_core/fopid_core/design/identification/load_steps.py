"""Steps of a load during a record: found where a model's residual speaks for one, by least squares."""

from __future__ import annotations

import numpy as np

from fopid_core.design.identification.fit import Fit
from fopid_core.model.arrays import Floats

_EDGE = 0.03
"""A load in this share of a record at either end cannot be told from its beginning, or is not yet felt."""
_TRIED, _NEAR = 128, 9
"""So many instants are tried, and so many again about the best of them."""


def likeliest_load(found: Fit) -> float:
    """When a step of a load, beside all that small changes of the model's numbers explain, explains most [s].

    Parameters
    ----------
    found : Fit
        A model with what it leaves unexplained.
    """
    span = float(found.response.time[-1])
    known = np.linalg.qr(_normed(found.sensitivity[found.rows].T).T)[0]
    left = found.residual[found.rows]
    left = left - known @ (known.T @ left)
    tried = np.linspace(_EDGE * span, (1.0 - _EDGE) * span, _TRIED)
    best = _best(found, tried, known, left)
    distance = tried[1] - tried[0]
    return _best(found, best + np.linspace(-distance, distance, _NEAR), known, left)


def _best(found: Fit, instants: Floats, known: Floats, left: Floats) -> float:
    shapes = _normed(found.response.load_shapes(found.x, found.gains, instants)[:, found.rows])
    shapes = shapes - (shapes @ known) @ known.T
    power = np.einsum("ij,ij->i", shapes, shapes)
    return float(instants[np.argmax((shapes @ left) ** 2 / np.maximum(power, 1e-6))])


def _normed(rows: Floats) -> Floats:
    normed: Floats = rows / np.maximum(np.linalg.norm(rows, axis=1), 1e-300)[:, np.newaxis]
    return normed
