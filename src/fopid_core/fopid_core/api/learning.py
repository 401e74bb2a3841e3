"""Tuning, reduction and identification, from what people have at hand."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fopid_core.api.reading import as_process, refuse_unknown
from fopid_core.design import tuner
from fopid_core.design.specification import Bound, TuningRequest, TuningResult
from fopid_core.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from fopid_core.api.reading import ProcessLike
    from fopid_core.design.identification.identify import IdentificationResult
    from fopid_core.design.identification.record import Record
    from fopid_core.design.reduction import ReducedModel

_FREQUENCY = {"phase_margin", "crossover", "t_max", "s_max", "via", "criterion"}
_NUMBERS = {"phase_margin_deg"} | {field.name for field in fields(TuningRequest) if str(field.type).startswith("float")}
_OPTIONS = tuple(field.name for field in fields(TuningRequest) if field.name not in ("process", "method"))


def tune(process: ProcessLike, method: str | None = None, **options: Any) -> TuningResult:
    """Choose the controller's five numbers, and verify the loop with the process itself.

    Parameters
    ----------
    process : Process, str or python-control object
        What is to be controlled, such as ``"2/(s+1)^3 * exp(-0.2s)"``.
    method : str, optional
        ``frequency``, ``time`` or ``rule``; without it what the options belong to: ``rule`` with a rule, ``frequency``
        with a phase margin, a crossover or bounds on |T| and |S|, ``time`` otherwise.
    **options
        The fields of ``TuningRequest``, among them ``phase_margin_deg`` [deg] in place of ``phase_margin`` [rad],
        ``crossover`` [rad/s], ``t_max`` and ``s_max`` as (dB, rad/s); ``index``, ``ms_max``, ``u_max``, ``fixed``;
        ``rule``. What is not given is chosen from the process.

    Returns
    -------
    TuningResult
        ``success`` only when every specification is met and the loop is stable for certain.

    Examples
    --------
    >>> result = tune("P1", phase_margin_deg=80, crossover=0.3)
    >>> result.success, round(result.achieved.phase_margin_deg, 3)
    (True, 80.0)
    """
    for name in _NUMBERS & options.keys():
        if isinstance(options[name], str):
            raise InputError(f"{name} = {options[name]!r}; allowed: a number")
    if "phase_margin_deg" in options:
        if "phase_margin" in options:
            raise InputError("phase_margin and phase_margin_deg; allowed: one of them")
        degrees = options.pop("phase_margin_deg")
        if not 0.0 < degrees < 180.0:
            raise InputError(f"phase_margin_deg = {degrees:g}; allowed: above 0 and below 180 degrees")
        options["phase_margin"] = math.radians(degrees)
    refuse_unknown(tuple(options), (*_OPTIONS, "phase_margin_deg"))
    for name in ("t_max", "s_max"):
        if isinstance(options.get(name), tuple):
            options[name] = Bound(*options[name])
    return tuner.tune(TuningRequest(as_process(process), method or _method(options), **options))


def _method(options: dict[str, Any]) -> str:
    if "rule" in options:
        return "rule"
    return "frequency" if _FREQUENCY & options.keys() else "time"


def reduce(process: ProcessLike, template: str | None = None, *, keep_gain: bool = False) -> ReducedModel:
    """The nearest low-order model in the H2 norm.

    Parameters
    ----------
    process : Process, str or python-control object
        Stable and strictly proper.
    template : str, optional
        ``foptd``, ``soptd``, ``nioptd1`` or ``nioptd2``; without it the simplest of those that are about as near as the
        nearest.
    keep_gain : bool
        Whether the model shall have the process's own steady-state gain.

    Examples
    --------
    >>> reduce("1/(2s+1)*exp(-s)").template
    'foptd'
    """
    from fopid_core.design import reduction

    full = as_process(process)
    if template is not None:
        return reduction.reduce(full, template, keep_gain)
    return reduction.preferred(reduction.reduce_all(full, keep_gain)).model


def identify(
    record: Record | Path | str | None = None,
    *,
    time: ArrayLike | None = None,
    control: ArrayLike | None = None,
    measurement: ArrayLike | None = None,
    template: str = "all",
    control_before: float | None = None,
    columns: str | None = None,
) -> IdentificationResult:
    """Learn a process from a record of its signals.

    Parameters
    ----------
    record : Record, Path or str, optional
        A record, a csv file with the columns time, control, measurement, or a bag.
    time, control, measurement : array_like, shape (n,), optional
        In place of it the signals themselves: instants [s], the control held from each on, the measurement at each.
    template : str
        ``foptd``, ``soptd``, ``nioptd1``, ``nioptd2``, ``rational:N/M`` or ``all``.
    control_before : float, optional
        The control at which the process rested before the record, where that is known.
    columns : str, optional
        Of a csv file: ``PV,OP[,SP[,TIME]]``, names or numbers of its columns.

    Raises
    ------
    InputError
        If they cannot be read, or an argument says nothing of what was given.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.arange(0.0, 20.0, 0.05)
    >>> found = identify(time=t, control=t >= 0, measurement=2 - 2 * np.exp(-t), template="foptd")
    >>> found.success, round(found.best.parameters["T"], 3)
    (True, 1.0)
    """
    from fopid_core.design.identification import identify as identification
    from fopid_core.design.identification.record import Record as Signals
    from fopid_core.design.recorded_law import made_prompt
    from fopid_core.design.response_verification import checked

    signals = (time, control, measurement)
    if (record is None) == all(signal is None for signal in signals):
        raise InputError("a record and signals, or neither; allowed: a record, or time, control and measurement")
    if columns is not None and (record is None or isinstance(record, Signals)):
        raise InputError(f"columns = {columns!r} without a file; allowed: with a csv file")
    if record is None:
        missing = [name for name, signal in zip(("time", "control", "measurement"), signals, strict=True)
                   if signal is None]  # fmt: skip
        if missing:
            raise InputError(f"{missing[0]} is not given; allowed: time, control and measurement")
        found = made_prompt(Signals(*signals, control_before=control_before))  # type: ignore[arg-type]
    elif isinstance(record, Signals):
        found = made_prompt(record if control_before is None else replace(record, control_before=control_before))
    else:
        from fopid_core.study.records import read_record

        found = read_record(record, control_before=control_before, columns=columns)
    return checked(found, identification.identify(found, template), template)
