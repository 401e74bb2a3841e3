"""Tables 1 and 2: the reduced models, their printed objective, and the H2 norm it should be."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.integrate import trapezoid

from fopid_core.design.reduction import ReducedModel, reduce
from fopid_core.model.process import Process, read_process
from fopid_core.study.reproduce.facts import PrintedModel, printed_model
from fopid_core.study.reproduce.table import Cell, Column, Table

_LOG_W = np.linspace(math.log(1e-6), math.log(1e6), 100_001)  # the H2 norm to five digits for all of Table 2


@dataclass(frozen=True)
class ModelRow:
    """A row: the printed model, the H2 error it really has, and the nearest model of the same template."""

    printed: PrintedModel
    h2_error: float
    best: ReducedModel

    @property
    def remark(self) -> str:
        """Where the printed figure and the computed one differ."""
        share = self.printed.objective / self.h2_error
        text = f"J is {share:.2f} times the norm; the error is {self.h2_error / self.best.h2_error:.2f} times the least"
        simpler = {"nioptd2": "soptd", "nioptd1": "foptd"}.get(self.printed.template)
        if simpler and self.h2_error > h2_error_of(printed_model(self.printed.process, simpler)):
            text += f"; worse than {simpler.upper()}, which it contains"
        return text


def h2_error(process: Process, model: Process) -> float:
    """||P - Pr||_2, eqs. (10) and (11), by the trapezoid rule over the logarithm of frequency.

    Examples
    --------
    >>> round(h2_error(Process.parse("1/(s+1)"), Process.parse("1/(s+2)")), 4)  # 1 / sqrt(12)
    0.2887
    """
    w = np.exp(_LOG_W)
    squared = np.abs(process(1j * w) - model(1j * w)) ** 2 * w
    return math.sqrt(float(trapezoid(squared, _LOG_W)) / math.pi)


def h2_error_of(printed: PrintedModel) -> float:
    """Of a printed model."""
    return h2_error(read_process(printed.process), printed.model)


def model_row(printed: PrintedModel) -> ModelRow:
    """A row, computed."""
    return ModelRow(printed, h2_error_of(printed), reduce(read_process(printed.process), printed.template))


def model_table(rows: tuple[ModelRow, ...]) -> Table:
    """Tables 1 and 2 in one."""
    columns = (
        Column("process"), Column("template"), Column("printed J", form=".4f"),
        Column("H2 error of the printed model", form=".5f"), Column("J / H2 error", form=".2f"),
        Column("H2 error of our optimum", form=".5f"), Column("printed model / ours", form=".2f"),
        Column("what it means", under=True), Column("printed model", under=True), Column("our optimum", under=True),
    )  # fmt: skip
    note = (
        "J of Table 1 beside the H2 norm of the difference, eqs. (10) and (11), of the model that Table 2 prints, and "
        "the smallest one that the template allows. a1 = 2ζωₙ and a0 = ωₙ²; delays L in s."
    )
    return Table("table1_2", "Tables 1 and 2: reduced models", note, columns, tuple(_cells(row) for row in rows))


def _cells(row: ModelRow) -> tuple[Cell, ...]:
    printed, best = row.printed, row.best
    return (
        printed.process, printed.title, printed.objective, row.h2_error, printed.objective / row.h2_error,
        best.h2_error, row.h2_error / best.h2_error,
        row.remark, _parameters(printed.parameters), _parameters(best.parameters),
    )  # fmt: skip


def _parameters(values: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {value:.5g}" for name, value in values.items())
