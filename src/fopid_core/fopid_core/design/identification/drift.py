"""Does a model still explain the process: its error on new data beside that on the data it was learnt from."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from fopid_core.design.identification.identified_model import IdentifiedModel
from fopid_core.design.identification.identify import IdentificationResult, identify
from fopid_core.design.identification.quality import fit_pct
from fopid_core.design.identification.record import Record
from fopid_core.design.identification.response import InitialCondition
from fopid_core.design.identification.runaway import response_to
from fopid_core.design.specification import Clock
from fopid_core.model.arrays import Floats

WORSE = 1.4
"""A model is doubted when its error is so many times what it was."""
BETTER = 0.7
"""And has drifted when one learnt from the new data has at most this share of its error: noise and disturbances that
no model explains are no drift."""
_MATERIAL = 0.05
"""And this share of the measurement's spread."""
_LEARNT = 0.07
"""A new model is proposed when its error is at most this share of the measurement's spread, or twice what it was."""
_EXCITED = 3.0
"""The process must have moved by so many times the noise for anything to be said."""


@dataclass(frozen=True)
class Drift:
    """What new data say about a model.

    Attributes
    ----------
    drifted : bool or None
        Whether another model explains the data and this one does not; None where they do not tell.
    error, error_before : float
        Root mean square of what it does not explain, now and on the data it was learnt from.
    fit_pct : float
        Of the old model on the new data [%].
    proposal : IdentificationResult or None
        What was learnt from the new data, when the model has drifted.
    message : str
        One line.
    """

    drifted: bool | None
    error: float
    error_before: float
    fit_pct: float
    proposal: IdentificationResult | None
    message: str


def model_residual(model: IdentifiedModel, record: Record, loads: tuple[float, ...] = ()) -> Floats:
    """Measurement less model, shape (n,), with the best offset, ramp and beginning but the model's own dynamics.

    Steps of a load that came at some instants [s after the first] are no fault of the model.
    """
    record = model.flaws.of_record(record)
    structure, x, gains = model.structure, model.numbers, model.gains
    start = InitialCondition(float(record.control[0]), step=True, free=True, ramp=True, loads=loads)
    response = response_to(record, structure, start)
    columns = response.columns(x)
    left = response.target(x) - columns[:, : gains.size] @ gains
    begun = columns[:, gains.size :]
    sizes = np.maximum(np.linalg.norm(begun, axis=0), 1e-300)
    coefficients = np.linalg.lstsq(begun / sizes, left, rcond=1e-6)[0]
    residual: Floats = left - begun / sizes @ coefficients
    return residual


def drift(
    model: IdentifiedModel, record: Record, template: str | None = None, clock: Clock = time.perf_counter
) -> Drift:
    """Judge a model by new data from normal operation, and learn anew where it has drifted.

    Parameters
    ----------
    model : IdentifiedModel
        Learnt before.
    record : Record
        A window of recent data; it may begin in the middle of anything.
    template : str, optional
        What to learn anew; by default the model's own.
    clock : callable
        Gives the time [s].
    """
    residual = model_residual(model, record)
    error, before = float(np.sqrt(np.mean(residual**2))), model.noise
    spread = float(np.std(record.measurement))
    fit = fit_pct(record.averaged(residual.size)[1], residual)
    if spread < _EXCITED * before or np.ptp(record.control) == 0.0:
        return Drift(None, error, before, fit, None, "the process hardly moved: nothing can be said")
    explained = max(WORSE * before, _MATERIAL * spread)
    if error <= explained:
        return Drift(False, error, before, fit, None, f"the model still explains {fit:.1f} % of the measurement")
    proposal = _behind(model, identify(model.flaws.of_record(record), template or model.template, clock))
    told = f"the model explains {fit:.1f} % of the measurement now, error {error:.3g} against {before:.3g} before"
    if not proposal.success or proposal.best is None:
        return Drift(None, error, before, fit, None, f"{told}; nothing could be learnt anew: {proposal.message}")
    if proposal.best.loads:
        return _beside_loads(model, record, proposal, before, explained)
    if proposal.best.noise > BETTER * error:
        return Drift(None, error, before, fit, None, f"{told}; nor does any model of its kind: a disturbance or noise")
    if proposal.best.noise > max(2.0 * before, _LEARNT * spread):
        waiting = "another explains more, but not enough: the process may have changed within the record"
        return Drift(True, error, before, fit, None, f"{told}; {waiting}")
    return Drift(True, error, before, fit, proposal, f"{told}; learnt anew: {proposal.message}")


def _behind(model: IdentifiedModel, learnt: IdentificationResult) -> IdentificationResult:
    """What was learnt behind the same actuator."""
    if learnt.best is None:
        return learnt
    best = replace(learnt.best, flaws=model.flaws)
    return replace(learnt, best=best, models=tuple(best if one is learnt.best else one for one in learnt.models))


def _beside_loads(
    model: IdentifiedModel, record: Record, proposal: IdentificationResult, before: float, explained: float
) -> Drift:
    """A load that came may look like another process, and a process that changed like loads: nothing is proposed."""
    assert proposal.best is not None
    residual = model_residual(model, record, proposal.best.loads)
    error, fit = float(np.sqrt(np.mean(residual**2))), fit_pct(record.averaged(residual.size)[1], residual)
    if error <= explained:
        told = f"the model still explains {fit:.1f} % of the measurement, beside a load that came"
        return Drift(False, error, before, fit, None, told)
    told = f"the model explains {fit:.1f} % of the measurement, beside loads: it may have changed within the record"
    return Drift(True, error, before, fit, None, told)
