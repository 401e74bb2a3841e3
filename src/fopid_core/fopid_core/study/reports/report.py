"""The report: one HTML page that needs nothing else, and its main figure as PNG."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np

from fopid_core.design.verification import achieved
from fopid_core.errors import InputError
from fopid_core.model.process import TEST_BENCH
from fopid_core.model.stability import stability
from fopid_core.study.reports.completeness import samples
from fopid_core.study.reports.limit_figures import limit_lines, limits_text, saturation_curve
from fopid_core.study.reports.loop_figures import loop_figures
from fopid_core.study.reports.page import page
from fopid_core.study.reports.parts import (
    comparison_table,
    controller_text,
    definitions,
    equation,
    facts,
    folded,
    measures,
    plot,
    table,
)
from fopid_core.study.reports.plotly_parts import Figure
from fopid_core.study.reports.print_figures import save, save_all
from fopid_core.study.reports.process_figure import process_figure
from fopid_core.study.reports.run import Run
from fopid_core.study.reports.segment_table import number
from fopid_core.study.reports.segments import Retuning, retunings, segments
from fopid_core.study.reports.signal_figures import comparison_figure, signals_figure
from fopid_core.study.reports.step_figures import step_figures

MOST_TUNINGS = 12
"""Tunings shown; of more, the last ones."""

_LONG = 200  # characters of a text that is folded away

_CAPTIONS = {
    "bode": "Open loop L = C P",
    "sensitivity": "Sensitivity S and complementary sensitivity T",
    "nyquist": "L(jω), the unit circle, and the circle around −1 that L touches",
    "isodamping": "Step responses when the process's gain is off by a factor",
}

_NO_PROCESS = "The bag does not say which process was controlled: no loop to draw (fopid report --process)."

_MEASURES = """Rise from 10 to 90 %, settling to 2 % of the step of the setpoint. IAE and ITAE from the start of the
phase. Ms and phase margin with the nominal process."""

_PROCESS = "The process behind its held control: what the run shows without a model, with 95 %"

_ORIGINS = {
    "start": "starting gains",
    "frequency": "tuned by frequency",
    "time": "tuned in the time domain",
    "rule": "tuned by a rule",
    "by hand": "set by hand",
}

_STEPS = {
    "setpoint-steps": "Each step of the setpoint as a unit step from rest, by the gains that were in force",
    "load-steps": "Each step of the load, divided by its size",
}

Figures = dict[str, Figure]


def write_report(runs: Sequence[Run], out: Path, figures: Path | None = None) -> tuple[Path, Path]:
    """Write the report of one or more runs.

    Parameters
    ----------
    runs : sequence of Run
    out : Path
        The HTML page; the PNG of its main figure gets the same name with ``.png``.
    figures : Path, optional
        A folder for every figure as png, svg and pdf.

    Returns
    -------
    page, image : Path

    Raises
    ------
    InputError
        Without runs, when a file cannot be written, and for a page called ``.png``.
    """
    if not runs:
        raise InputError("runs = (); allowed: at least one")
    image = out.with_suffix(".png")
    if image == out:
        raise InputError(f"report {str(out)!r}; allowed: another ending, since the picture beside the page gets .png")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        text, drawn = _page(runs)
        out.write_text(text, encoding="utf-8")
        save(next(iter(drawn.values())), image)
        if figures is not None:
            save_all(drawn, figures)
    except OSError as error:
        raise InputError(f"report {str(error.filename or out)!r} cannot be written: {error.strerror}") from None
    return out, image


def render(runs: Sequence[Run]) -> str:
    """The page as text."""
    return _page(runs)[0]


def _page(runs: Sequence[Run]) -> tuple[str, Figures]:
    """The page, and its figures, of which the first is the main one."""
    names, figures = _names(runs), Figures()
    content = [_comparison(runs, names, figures)] if len(runs) > 1 else []
    content += [_run(run, name, f"run{i}", figures) for i, (run, name) in enumerate(zip(runs, names, strict=True), 1)]
    return page(", ".join(names), "\n".join(content), figures), figures


def _names(runs: Sequence[Run]) -> list[str]:
    """The experiment's name and process, or the bag's name; several runs are told apart by their bags."""
    bags = [_bag_name(run) for run in runs]
    bags = [f"{name} ({i})" if bags.count(name) > 1 else name for i, name in enumerate(bags, 1)]
    experiment = runs[0].experiment
    if len(runs) > 1 or "name" not in experiment:
        return bags
    process = str(experiment.get("process", ""))
    return [f"{experiment['name']} on {process}" if process in TEST_BENCH else str(experiment["name"])]


def _bag_name(run: Run) -> str:
    path = run.path.resolve()
    return (path.parent.name if path.name == "bag" else path.name) + run.namespace


def _comparison(runs: Sequence[Run], names: Sequence[str], figures: Figures) -> str:
    figures["comparison"] = comparison_figure(runs, names)
    found = [segments(run) for run in runs]
    return f"""<header><h1>{len(runs)} runs side by side</h1></header>
{plot("comparison", "Measurement and control of all runs, aligned where the first thing happens", "signals")}
{comparison_table(found, names)}
<p class="quiet">Small: difference to {escape(names[0])}. {_MEASURES}</p>"""


def _run(run: Run, name: str, key: str, figures: Figures) -> str:
    figures[f"{key}-signals"] = signals_figure(run)
    return f"""<header><h1>{escape(name)}</h1>
{equation("P", _process_text(run)) if run.process else ""}
{_facts(run)}{_warnings(run)}</header>
<h2>Signals</h2>
{plot(f"{key}-signals", _signals_caption(run), "signals")}
{_steps(run, key, figures)}
<h2>Phases</h2>
{table(segments(run))}
<p class="quiet">{_MEASURES}</p>
{_tunings(run, key, figures)}
{_learnt(run, key, figures)}
{_what_was_run(run)}"""


def _steps(run: Run, key: str, figures: Figures) -> str:
    """The steps over each other, where the gains changed between them."""
    drawn = step_figures(run)
    figures |= {f"{key}-{name}": figure for name, figure in drawn.items()}
    places = "\n".join(plot(f"{key}-{name}", _STEPS[name], "signals") for name in drawn)
    return f"<h2>Before and after</h2>\n{places}" if drawn else ""


def _process_text(run: Run) -> str:
    """The process as it was typed, where the bag has that."""
    typed = run.metadata.get("process") or str(run.experiment.get("process") or run.process)
    return TEST_BENCH.get(typed, typed)


def _signals_caption(run: Run) -> str:
    parts = ["Red lines: new gains."] if retunings(run)[1:] else []
    parts += ["Dotted: limits of the control."] if limit_lines(run) else []
    parts += ["Thick: control at a limit."] if saturation_curve(run) else []
    return " ".join([*parts, "Drag to zoom, double-click to go back."])


def _facts(run: Run) -> str:
    time, found = run.signals["measurement"].time, samples(run)
    return facts(
        {
            "duration": f"{number(run.end - float(time[0]))} s",
            "samples": f"{np.unique(time).size:,}",
            "sample time": f"{number(run.sample_time)} s",
            "ran in": str(run.experiment.get("trigger", "") or ("simulated time" if run.start == 0 else "real time")),
            "limits of the control": limits_text(run),
            "late ticks": f"{late:,}" if (late := max((one.late for one in found.values()), default=0)) else "",
            "recorded": "every sample" if found and not any(one.missing for one in found.values()) else "",
        }
    )


def _warnings(run: Run) -> str:
    """What is wrong with the recording."""
    told = [] if run.whole else ["The recording was cut off or damaged; this is what it holds."]
    kind = "lost" if run.start == 0 else "late or lost"
    told += [
        f"{name}: {one.missing:,} of {one.expected:,} samples {kind}, the first one at {number(one.first_gap)} s."
        for name, one in samples(run).items()
        if one.missing
    ]
    told += [
        f"{name}: {count:,} values that are no numbers."
        for name, signal in run.signals.items()
        if (count := int(np.count_nonzero(~np.isfinite(signal.value))))
    ]
    return "".join(f'<p class="warning">{escape(text)}</p>' for text in told)


def _tunings(run: Run, key: str, figures: Figures) -> str:
    changes = retunings(run)
    shown = list(enumerate(changes, 1))[-MOST_TUNINGS:]
    if not shown:
        return ""
    unknown = "" if run.process else f'<p class="quiet">{_NO_PROCESS}</p>'
    left_out = f'<p class="quiet">The last {MOST_TUNINGS} of {len(changes)}.</p>' if len(changes) > len(shown) else ""
    return f"<h2>Gains</h2>{unknown}{left_out}" + "\n".join(
        _tuning(run, c, f"{key}-gains{i}", figures) for i, c in shown
    )


def _learnt(run: Run, key: str, figures: Figures) -> str:
    """What the run shows of its process without any model, where it shows enough."""
    drawn = process_figure(run)
    if drawn is None:
        return ""
    figures[f"{key}-process"] = drawn
    return f"<h2>Process</h2>{plot(f'{key}-process', _PROCESS)}"


def _tuning(run: Run, change: Retuning, key: str, figures: Figures) -> str:
    origin = _ORIGINS.get(change.method, change.method)
    title = f'<h3>From {number(change.time)} s <span class="tag">{escape(origin)}</span></h3>'
    parts = [title, equation("C", controller_text(change.gains))]
    if change.tuning:
        parts.append(f'<p class="quiet">{escape(change.tuning.message)}</p>')
        parts += [f'<p class="warning">Not met: {escape(unmet)}</p>' for unmet in change.tuning.unmet]
    parts.append(_loop(run, change, key, figures))
    return f'<section class="tuning">{"".join(parts)}</section>'


def _loop(run: Run, change: Retuning, key: str, figures: Figures) -> str:
    """Measures and figures of the loop; only the tuner's word where the process is not known."""
    if run.process is None:
        return measures(change.tuning.achieved) if change.tuning else ""
    if not any((change.gains.kp, change.gains.ki, change.gains.kd)):
        return '<p class="quiet">All three gains are zero: there is no feedback, and no loop to judge.</p>'
    loop = change.loop(run.process)
    verdict = stability(loop)
    if not verdict.stable:
        return f'<p class="warning">With its nominal process this loop is not stable: {escape(verdict.reason)}.</p>'
    drawn = loop_figures(loop)
    figures |= {f"{key}-{name}": figure for name, figure in drawn.items()}
    places = "".join(plot(f"{key}-{name}", _CAPTIONS[name]) for name in drawn)
    return f'{measures(achieved(loop))}<div class="plots">{places}</div>'


def _what_was_run(run: Run) -> str:
    texts = {"bag": str(run.path.resolve()), **run.metadata}
    short = {name: text for name, text in texts.items() if "\n" not in text and len(text) <= _LONG}
    long = [folded(name, text) for name, text in texts.items() if name not in short]
    return f"<h2>What was run</h2>{definitions(short)}{''.join(long)}"
