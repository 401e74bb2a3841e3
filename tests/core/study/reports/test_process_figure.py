"""The page of a run shows what it says of the process without a model, beside the process that the bag names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fopid_core.study.reports.process_figure import process_figure
from fopid_core.study.reports.run import Run, Signal

from ...design.identification.frequency_response_campaign import Sample, open_loop, prbs

H = 0.1
TRUE = Sample([2.0], [1.0, 2.0, 1.0], 0.5, 3.0)


def run_of(process: str, samples: int = 600) -> Run:
    record = open_loop(
        TRUE, prbs(samples, samples // 10, 1), H, 0.02 * np.random.default_rng(0).standard_normal(samples)
    )
    signals = {"measurement": Signal(record.time, record.measurement), "control": Signal(record.time, record.control)}
    return Run(Path("bag"), signals, metadata={"process": process} if process else {})


def bars(run: Run) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies, and the ends of the bars of the size [dB]."""
    drawn = process_figure(run)
    assert drawn is not None
    sizes = [shape for shape in drawn["layout"]["shapes"] if "yref" not in shape]
    w, low, high = (np.array([shape[name] for shape in sizes]) for name in ("x0", "y0", "y1"))
    return w, low, high


def test_the_bars_hold_the_true_process() -> None:
    w, low, high = bars(run_of(TRUE.text))
    true = 20.0 * np.log10(np.abs(TRUE.held(H, w)))
    assert w.size >= 8
    assert ((low <= true) & (true <= high)).mean() > 0.85


@pytest.mark.parametrize("process", [TRUE.text, "", "(s+1)/(s+2)"])
def test_the_process_that_the_bag_names_is_drawn_as_the_run_would_show_it(process: str) -> None:
    drawn = process_figure(run_of(process))
    assert drawn is not None
    named = [trace for trace in drawn["data"] if trace["name"] == "the process named"]
    assert len(named) == (2 if process == TRUE.text else 0)
    for trace, true in zip(named, (lambda g: 20.0 * np.log10(np.abs(g)), lambda g: np.degrees(np.unwrap(np.angle(g)))),
                           strict=False):  # fmt: skip
        assert trace["y"] == pytest.approx(true(TRUE.held(H, np.array(trace["x"]))), abs=0.01)


def test_a_run_that_shows_too_little_has_none() -> None:
    still = run_of(TRUE.text)
    short = {name: Signal(signal.time[:20], signal.value[:20]) for name, signal in still.signals.items()}
    control = Signal(still.signals["control"].time, np.zeros(600))
    assert process_figure(Run(Path("bag"), short)) is None
    assert process_figure(Run(Path("bag"), {**still.signals, "control": control})) is None
    assert process_figure(Run(Path("bag"), {"measurement": still.signals["measurement"]})) is None
