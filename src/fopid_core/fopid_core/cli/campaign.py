"""The verb ``fopid campaign``: thousands of runs, on all cores or on a cluster, resumed where they were left."""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fopid_core.cli.options import ARGUMENTS, as_json
from fopid_core.cli.output import emit
from fopid_core.cli.progress import progress
from fopid_core.errors import InputError

if TYPE_CHECKING:
    from fopid_core.study.campaigns.campaign import Campaign
    from fopid_core.study.campaigns.run import CampaignProgress
    from fopid_core.study.verdict.survey import Survey


@click.command("campaign", context_settings=ARGUMENTS)
@click.argument("file", type=click.Path(path_type=Path))
@click.option(
    "--out", type=click.Path(path_type=Path), metavar="FILE", help="Results, .parquet or .csv; runs/NAME.parquet."
)
@click.option("--workers", type=int, metavar="N", help="Processes on this machine; as many as it has cores.")
@click.option("--scheduler", metavar="ADDRESS", help="Of a Dask cluster, whose workers do the work instead.")
@as_json
def campaign_verb(file: Path, out: Path | None, workers: int | None, scheduler: str | None, as_json: bool) -> None:
    """Designs on varied processes, or a survey of structures: one row per run. Start it again to go on after a kill."""
    from fopid_core.study.campaigns.campaign import read_campaign
    from fopid_core.study.campaigns.run import read_results, run_campaign
    from fopid_core.study.verdict.survey import is_survey, read_survey

    if workers is not None and scheduler is not None:
        raise InputError(f"workers = {workers} with a scheduler; allowed: one of the two")
    workers = len(os.sched_getaffinity(0)) if workers is None else workers
    if workers < 1:
        raise InputError(f"workers = {workers}; allowed: 1 or more")
    campaign: Campaign | Survey = read_survey(file) if is_survey(file) else read_campaign(file)
    out = out or Path("runs") / f"{campaign.name}.parquet"
    begun = time.monotonic()
    with progress(campaign.name) as bar:
        kept = run_campaign(campaign, out, workers, scheduler, _Told(bar))
    results = read_results(out, campaign.schema)
    counts = {pair["values"]: pair["counts"] for pair in results["status"].value_counts().to_pylist()}
    data: dict[str, Any] = {"results": str(out), "runs": campaign.runs, "done_before": kept, "status": counts}
    data |= {"elapsed_s": time.monotonic() - begun, **_draw(campaign, out)}
    emit(data, [("Campaign", {name: value for name, value in data.items() if name != "status"} | counts)], as_json)


class _Told:
    """The progress as a bar on a terminal, and else as a line for each tenth of the runs."""

    def __init__(self, bar: Callable[[float, str], None]) -> None:
        self._bar, self._tenth = bar, -1

    def __call__(self, runs: CampaignProgress) -> None:
        left = "" if math.isnan(runs.left) else f"about {_duration(runs.left)} left"
        text = f"{runs.done:,} of {runs.total:,} runs {left}".rstrip()
        self._bar(runs.done / runs.total, text)
        tenth = 10 * runs.done // runs.total
        if not sys.stderr.isatty() and tenth > self._tenth:
            self._tenth = tenth
            print(text, file=sys.stderr, flush=True)


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s" if minutes else f"{rest} s"


def _draw(campaign: Campaign | Survey, out: Path) -> dict[str, str]:
    """Figure and summary, where the campaign asks for one."""
    if not campaign.figure:
        return {}
    from fopid_core.study.campaigns.figure import summary, write_figure, write_summary
    from fopid_core.study.campaigns.run import read_results

    results = read_results(out)
    figure, table = out.with_suffix(".png"), out.with_name(f"{out.stem}-summary.csv")
    write_figure(results, campaign.figure, campaign.name, figure)
    write_summary(summary(results, campaign.figure), table)
    return {"figure": str(figure), "summary": str(table)}
