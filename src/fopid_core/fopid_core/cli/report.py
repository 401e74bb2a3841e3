"""The verbs ``fopid report`` and ``fopid repair``: what became of a recorded run."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from fopid_core.cli.options import ARGUMENTS, as_json
from fopid_core.cli.output import emit
from fopid_core.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from fopid_core.study.reports.run import Run


@click.command("report", context_settings=ARGUMENTS)
@click.argument("bags", nargs=-1, required=True, metavar="BAG...", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), metavar="FILE", help="The page; report.html in the first bag.")
@click.option("--figures", type=click.Path(path_type=Path), metavar="DIR", help="Every figure as png, svg and pdf.")
@click.option("--namespace", metavar="NAME", help="Which loop, when a bag holds several.")
@click.option("--topic", "topics", multiple=True, metavar="SIGNAL=TOPIC[:FIELD]",
              help="Where a signal is, when its topic has another name.")  # fmt: skip
@click.option("--process", metavar="PROCESS", help="What was controlled, when the bag does not say it.")
@as_json
def report_verb(
    bags: tuple[Path, ...], out: Path | None, figures: Path | None, namespace: str | None, topics: tuple[str, ...],
    process: str | None, as_json: bool,
) -> None:  # fmt: skip
    """One self-contained page with plots of recorded runs, and its main figure as PNG beside it.

    BAG is a rosbag2 bag, the folder of an experiment, or one that ``fopid simulate --out`` wrote.
    """
    from fopid_core.study.bags.bag import read_bag
    from fopid_core.study.experiments.stored import is_simulated, read_simulated
    from fopid_core.study.reports.completeness import samples
    from fopid_core.study.reports.report import write_report
    from fopid_core.study.reports.segment_table import print_segments
    from fopid_core.study.reports.segments import segments

    places = _places(topics)
    runs = [
        _with_process(read_simulated(bag) if is_simulated(bag) else read_bag(bag, namespace, topics=places), process)
        for bag in bags
    ]
    folder = bags[0] if bags[0].is_dir() else bags[0].parent
    page, image = write_report(runs, out or folder / "report.html", figures)
    rows = [
        {
            "bag": str(bag),
            "whole": run.whole,
            "samples": {name: asdict(found) for name, found in samples(run).items()},
            "segments": [asdict(segment) for segment in segments(run)],
        }
        for bag, run in zip(bags, runs, strict=True)
    ]
    files = {"report": str(page), "image": str(image), "figures": str(figures) if figures else None}
    told = {**files, **_samples(runs)}
    emit({**files, "runs": rows}, [("Report", {name: text for name, text in told.items() if text})], as_json)
    if not as_json:
        for run in runs:
            print_segments(segments(run))


def _samples(runs: Sequence[Run]) -> dict[str, str]:
    """What is missing in each run."""
    from fopid_core.study.reports.completeness import samples

    return {f"{run.path}: {name}": str(found) for run in runs for name, found in samples(run).items()}


def _places(topics: Sequence[str]) -> dict[str, str]:
    for topic in topics:
        if "=" not in topic:
            raise InputError(f"topic {topic!r}; allowed: SIGNAL=TOPIC or SIGNAL=TOPIC:FIELD")
    return dict(topic.split("=", 1) for topic in topics)


def _with_process(run: Run, process: str | None) -> Run:
    from fopid_core.model.process import read_process

    if process is None:
        return run
    read_process(process)
    return replace(run, metadata={**run.metadata, "process": process})


@click.command("repair", context_settings=ARGUMENTS)
@click.argument("bag", type=click.Path(path_type=Path))
@as_json
def repair_verb(bag: Path, as_json: bool) -> None:
    """Give a bag that was cut off (by a kill, a full disk) its index back, in place."""
    from fopid_core.study.bags.repair import repair

    content = repair(bag)
    emit({"bag": str(bag), "messages": content.counts}, [("Messages", content.counts)], as_json)
