"""The verb ``fopid design``: one report from a process or a csv file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from fopid_core.cli.options import ARGUMENTS, CANNOT_BE_MET, NewFile, as_json, design_options
from fopid_core.cli.output import emit, write_file


@click.command("design", context_settings=ARGUMENTS)
@click.argument("source", metavar="PROCESS|CSV")
@click.option(
    "--columns", metavar="PV,OP,SP", help="Of a csv file: names or numbers of its columns; the fourth is time."
)
@click.option("--index", default="iae", show_default=True, help="What is made small.")
@design_options("ms_max")
@click.option("--sample-time", type=float, metavar="S", help="Of the controller as it runs [s]; 0.01, or the record's.")
@click.option("--out", type=NewFile(), metavar="FILE", help="The report; design.html.")
@as_json
def design_verb(
    source: str,
    columns: str | None,
    index: str,
    ms_max: float | None,
    sample_time: float | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """One report: the fit, the best PI, PID and FOPID for the same bounds, gains in standard, series, parallel form."""
    from fopid_core.cli.plots import fit_figure
    from fopid_core.model.process import read_process
    from fopid_core.study.design_report import design_structures, report

    facts: dict[str, Any] = {}
    fit, record = None, None
    if Path(source).suffix.lower() == ".csv" or columns is not None:
        from fopid_core.design.identification.frequency_response import frequency_response
        from fopid_core.design.response_verification import doubt_of, to_design_for
        from fopid_core.study.records import read_record

        record = read_record(source, columns=columns)
        found = to_design_for(record, source)
        assert found.best is not None
        behind = found.behind_actuator(record)
        process, fit = found.best.process, fit_figure(found.best, behind, frequency_response(behind))
        message = "; ".join(told for told in (found.message, doubt_of(behind, found.best)) if told)
        facts = {"fit_pct": found.best.fit_pct, "template": found.best.template, "message": message,
                 "rows_left_out": record.left_out}  # fmt: skip
        sample_time = record.sample_time if sample_time is None else sample_time
    else:
        process = read_process(source)
    facts = {"process": str(process), **facts}
    designs = design_structures(process, index, ms_max, 0.01 if sample_time is None else sample_time)
    page = out or Path("design.html")
    write_file("out", page, report(process, designs, fit, facts))
    rows = [
        {
            "structure": one.structure,
            "success": one.result.success,
            "message": one.result.message,
            "cost": one.result.cost,
            "ms": None if one.result.achieved is None else one.result.achieved.ms,
            "forms": one.forms,
        }
        for one in designs
    ]
    success = all(one.result.success for one in designs)
    data = {"success": success, **facts, "structures": rows, "report": str(page)}
    tables: list[tuple[str, Any]] = [("Process", facts)]
    for one in designs:
        told = {"cost": one.result.cost, "success": one.result.success}
        flat = {f"{form} {name}": value for form, parts in one.forms.items() for name, value in parts.items()}
        tables.append((one.structure.upper(), told | flat))
    emit(data, [*tables, ("Report", {"report": str(page)})], as_json)
    if not success:
        click.get_current_context().exit(CANNOT_BE_MET)
