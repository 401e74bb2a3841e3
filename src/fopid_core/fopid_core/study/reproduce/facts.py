"""What the paper prints, as values of the engine."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from fopid_core.data import paper_tables
from fopid_core.design.specification import NUMBERS, Bound
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process, read_process
from fopid_core.model.templates import TEMPLATES

PROCESSES = ("P1", "P2", "P3", "P4")
INDICES = ("IAE", "ISE", "ITAE", "ITSE", "ISTES", "ISTSE", "SUM")
HORIZON = float(paper_tables()["horizon"])
"""Over which the indices of Tables 4 to 7 are integrated [s]."""

_BOUNDS = paper_tables()["specification"]
T_MAX = Bound(_BOUNDS["t_max_db"], _BOUNDS["t_frequency"])
"""Of Table 3, eq. (4)."""
S_MAX = Bound(_BOUNDS["s_max_db"], _BOUNDS["s_frequency"])
"""Of Table 3, eq. (5)."""


@dataclass(frozen=True)
class PrintedModel:
    """A reduced model of Table 2 and its objective in Table 1."""

    process: str
    template: str
    parameters: Mapping[str, float]
    objective: float

    @property
    def title(self) -> str:
        """What the paper calls the template."""
        return TEMPLATES[self.template].title

    @property
    def model(self) -> Process:
        """The model as a process."""
        return TEMPLATES[self.template].process(self.parameters)


@dataclass(frozen=True)
class PrintedDesign:
    """A controller of Table 3 and what was asked of it: phase margin [rad], crossover [rad/s]."""

    process: str
    controller: Fopid
    phase_margin: float
    crossover: float

    @property
    def loop(self) -> Loop:
        """With the full process."""
        return Loop(read_process(self.process), self.controller)

    @property
    def model(self) -> Process:
        """The printed NIOPTD-II model, which it was designed on."""
        return printed_model(self.process, "nioptd2").model


@dataclass(frozen=True)
class PrintedTuning:
    """A row of Tables 4 to 7: the controller and what is printed of its step response.

    ``value`` is the index; ``overshoot_pct`` [%] and ``rise_time`` [s] have one and two decimals.
    """

    process: str
    index: str
    controller: Fopid
    value: float
    overshoot_pct: float
    rise_time: float

    @property
    def loop(self) -> Loop:
        """With the full process, which it was tuned on."""
        return Loop(read_process(self.process), self.controller)


@cache
def printed_models() -> tuple[PrintedModel, ...]:
    """The 16 rows of Tables 1 and 2.

    Examples
    --------
    >>> len(printed_models()), printed_models()[0].parameters
    (16, {'K': 1, 'T': 2.029, 'L': 1.1349})
    """
    by_title = {template.title: template for template in TEMPLATES.values()}
    found = []
    for row in paper_tables()["table1_table2"]:
        template = by_title[row["template"]]
        parameters = {name: row["paper_model"][name] for name in template.parameters}
        found.append(PrintedModel(row["process"], template.name, parameters, row["paper_J_table1"]))
    return tuple(found)


def printed_model(process: str, template: str) -> PrintedModel:
    """One of them."""
    return next(model for model in printed_models() if (model.process, model.template) == (process, template))


@cache
def printed_designs() -> tuple[PrintedDesign, ...]:
    """The four rows of Table 3."""
    return tuple(
        PrintedDesign(row["process"], _controller(row), math.radians(row["phase_margin_deg"]), row["crossover"])
        for row in paper_tables()["table3"]
    )


@cache
def printed_tunings() -> tuple[PrintedTuning, ...]:
    """The 28 rows of Tables 4 to 7.

    Examples
    --------
    >>> [len([t for t in printed_tunings() if t.process == process]) for process in PROCESSES]
    [7, 7, 7, 7]
    """
    return tuple(
        PrintedTuning(
            row["process"], row["index"], _controller(row),
            row["paper"]["J"], row["paper"]["overshoot_pct"], row["paper"]["rise_time"],
        )
        for row in paper_tables()["table4_to_7"]
    )  # fmt: skip


def printed_design(process: str) -> PrintedDesign:
    """The frequency-domain design for a process."""
    return next(design for design in printed_designs() if design.process == process)


def printed_tuning(process: str, index: str = "") -> PrintedTuning:
    """The time-domain design for a process and an index; without one, the design that section 5 compares.

    Examples
    --------
    >>> printed_tuning("P1").index, printed_tuning("P2").index
    ('IAE', 'ITAE')
    """
    index = index or paper_tables()["best_time_index"][process]
    return next(tuning for tuning in printed_tunings() if (tuning.process, tuning.index) == (process, index))


def _controller(row: Mapping[str, Any]) -> Fopid:
    return Fopid(**{name: row[name] for name in NUMBERS})
