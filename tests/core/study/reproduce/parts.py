"""A reproduction that is whole in kind but small: two rows of most tables, two figures, three errata."""

from __future__ import annotations

from fopid_core.study.reproduce.claims import claims_table, compared_claims
from fopid_core.study.reproduce.conclusions import figures_table, printed_pairs
from fopid_core.study.reproduce.errata import ERRATA
from fopid_core.study.reproduce.facts import printed_model, printed_tuning
from fopid_core.study.reproduce.frequency_figures import figure_1
from fopid_core.study.reproduce.frequency_table import printed_table
from fopid_core.study.reproduce.model_table import model_row, model_table
from fopid_core.study.reproduce.page import Reproduction
from fopid_core.study.reproduce.time_figures import index_figure
from fopid_core.study.reproduce.time_table import compared_table, time_row, tuned_table


def small_reproduction() -> Reproduction:
    pairs = printed_pairs()[:2]
    models = tuple(model_row(printed_model("P1", name)) for name in ("foptd", "nioptd2"))
    rows = tuple(time_row(printed_tuning("P1", index)) for index in ("ITAE", "SUM"))
    return Reproduction(
        claims_table(compared_claims(pairs, pairs)),
        figures_table(pairs, pairs),
        (model_table(models), printed_table(), compared_table(4, rows), tuned_table(4, rows)),
        rows,
        (figure_1(), index_figure(6, "P4")),
        ERRATA[:3],
    )
