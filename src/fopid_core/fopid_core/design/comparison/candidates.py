"""The designs that are compared: rules, frequency, each time index, each structure."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from fopid_core.design.frequency.proposal import propose_frequency
from fopid_core.design.rules import RULES, Foptd, foptd_of
from fopid_core.design.specification import STRUCTURES, Progress, TuningRequest, no_progress
from fopid_core.design.time.objectives import Objective
from fopid_core.design.time.proposal import time_specification
from fopid_core.design.time.specification import TimeSpecification
from fopid_core.design.time.tuning import TimeDesign, tune_time
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.indices import INDEX_NAMES
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process

INDEX = "iae"
"""Of the search over structures: the field's default."""
STRUCTURE_NAMES = tuple(STRUCTURES)


@dataclass(frozen=True)
class Candidate:
    """A design and how it was come by.

    Attributes
    ----------
    method : str
        ``rule NAME``, ``frequency`` or ``time INDEX``.
    structure : str
    loop : Loop or None
        None where the method has no answer.
    reason : str
        Why it has none.
    """

    method: str
    structure: str
    loop: Loop | None
    reason: str = ""


def candidates(request: TuningRequest, progress: Progress = no_progress) -> Iterator[Candidate]:
    """Every design for a request, whose method is left aside; bounds and weights are those of time tuning."""
    progress(0.05, "rules")
    yield from _by_rule(request.process)
    progress(0.1, "frequency")
    yield _by_frequency(request)
    yield from _in_time(request, progress)


def structure_of(controller: Fopid) -> str:
    """The simplest structure that a controller is.

    Examples
    --------
    >>> structure_of(Fopid(1.0, 0.5, 0.0, 0.9)), structure_of(Fopid(1.0, 0.5, 0.1))
    ('fopi', 'pid')
    """
    numbers = {"ki": controller.ki, "kd": controller.kd}
    numbers["lam"] = controller.lam if controller.ki else 1.0
    numbers["mu"] = controller.mu if controller.kd else 1.0
    return next(name for name, kept in STRUCTURES.items() if all(numbers[key] == kept[key] for key in kept))


def _by_rule(process: Process) -> Iterator[Candidate]:
    try:
        model: Foptd | None = foptd_of(process)
        refusal = ""
    except InputError as error:
        model, refusal = None, str(error)
    for name, rule in RULES.items():
        controller = rule.controller(model) if model else None
        if controller is None:
            yield Candidate(f"rule {name}", "", None, refusal or f"valid for {rule.valid}")
        else:
            yield Candidate(f"rule {name}", structure_of(controller), Loop(process, controller))


def _by_frequency(request: TuningRequest) -> Candidate:
    asked = replace(request, method="frequency", input="setpoint", structure=None, filter_order=0, solver=None)
    try:
        proposal = propose_frequency(asked, no_progress, lambda: False)
    except InputError as error:
        return Candidate("frequency", "", None, str(error))
    if proposal.controller is None:
        return Candidate("frequency", "", None, "; ".join(proposal.unmet))
    return Candidate("frequency", structure_of(proposal.controller), Loop(request.process, proposal.controller))


def _in_time(request: TuningRequest, progress: Progress) -> Iterator[Candidate]:
    """IAE with each structure, each other index with PID and FOPID from there."""
    asked = time_specification(replace(request, method="time", index=INDEX, structure=None))
    progress(0.15, "time: fopid")
    whole = tune_time(request.process, asked)
    found: dict[str, TimeDesign] = {}
    for i, name in enumerate(STRUCTURE_NAMES):
        progress(0.4 + 0.04 * i, f"time: {name}")
        design = whole if name == "fopid" else _restricted(request.process, asked, whole, name)
        if design is None:
            yield Candidate(f"time {INDEX}", name, None, "no stable controller found")
            continue
        found[name] = design
        yield Candidate(f"time {INDEX}", name, _loop(request.process, design))
    near = [found[name].variables for name in ("pid", "fopid") if name in found]
    for i, index in enumerate(name for name in INDEX_NAMES if name != INDEX and near):
        progress(0.7 + 0.05 * i, f"time: {index}")
        other = replace(asked, objective=Objective.of(index, {}))
        best = tune_time(request.process, other, near=near)
        if best is not None:
            yield Candidate(f"time {index}", "fopid", _loop(request.process, best))


def _restricted(process: Process, asked: TimeSpecification, whole: TimeDesign | None, name: str) -> TimeDesign | None:
    kept = replace(asked, fixed={**asked.fixed, **STRUCTURES[name]})
    if whole is None or name not in whole.simpler:
        return tune_time(process, kept)
    return tune_time(process, kept, near=[whole.simpler[name][1]])


def _loop(process: Process, design: TimeDesign) -> Loop:
    return Loop(process, design.controller, design.filter, design.weights)
