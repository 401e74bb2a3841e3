"""The pictures of the command line: a response, a region of gains, a trade-off."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fopid_core.design.sampled_loop import sampled_process
from fopid_core.drawing import draw_over_time, draw_signals, new_figure
from fopid_core.errors import InputError
from fopid_core.model.response import Source, step_response

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from fopid_core.design.front.front import Front
    from fopid_core.design.identification.frequency_response import FrequencyResponse
    from fopid_core.design.identification.identified_model import IdentifiedModel
    from fopid_core.design.identification.record import Record
    from fopid_core.model.loop import Loop
    from fopid_core.model.response import Response
    from fopid_core.model.stability_region import StabilityRegion
    from fopid_core.study.replay import Replay

SOURCES: tuple[Source, ...] = ("setpoint", "load")
_FINE = 300  # points of a curve over frequency


def plot_response(response: Response, title: str, path: Path) -> None:
    """Output and control over time, one above the other."""
    _save(response.plot(title=title), path)


def plot_steps(loops: Mapping[str, Loop], horizon: float, sample_time: float, title: str, path: Path) -> None:
    """Unit steps of the setpoint and of the load side by side: output above, control from the first tick on below."""
    figure = new_figure()
    grid = figure.subplots(2, 2, sharex=True)
    for column, source in enumerate(SOURCES):
        for name, loop in loops.items():
            response = step_response(loop, horizon, source)
            runs = response.time >= sample_time  # before, the ideal derivative may be without bound
            grid[0, column].plot(response.time, response.output, label=name)
            grid[1, column].plot(response.time[runs], response.control[runs], label=name)
        grid[0, column].set_title(f"{source} step")
        grid[1, column].set_xlabel("time [s]")
    for axes in grid.flat:
        axes.grid(True, alpha=0.3)
    for row, name in enumerate(("output", "control")):
        grid[row, 0].set_ylabel(name)
    if loops:
        grid[0, 0].legend()
    figure.suptitle(title if len(title) < 70 else "")
    _save(figure, path)


def fit_figure(model: IdentifiedModel, record: Record, seen: FrequencyResponse | None = None) -> Figure:
    """Measurement and model over time, above the control that both answer; beside them both over frequency."""
    time, measured, simulated = model.simulated
    rows = [
        (
            "measurement",
            {"measurement": (time, measured), f"{model.template}, {model.fit_pct:.1f} %": (time, simulated)},
        ),
        ("control", {"": (record.time, record.control)}),
    ]
    title = str(model.process) if len(str(model.process)) < 70 else ""
    if seen is None or not seen.known.any():
        return draw_over_time(rows, title=title)
    figure = new_figure()
    figure.set_size_inches(12.0, 5.0)
    grid = figure.subplots(2, 2, sharex="col")
    draw_signals(grid[:, 0].tolist(), rows)
    figure.suptitle(title)
    _draw_over_frequency(grid[0, 1], grid[1, 1], model, seen)
    return figure


def _draw_over_frequency(sizes: Axes, angles: Axes, model: IdentifiedModel, seen: FrequencyResponse) -> None:
    """Size and angle as the record shows them, with regions of 95 %, beside the model's."""
    known = seen.known
    frequency, size, radius = seen.frequency[known], np.abs(seen.response[known]), seen.radius[known]
    fine = np.geomspace(frequency[0], frequency[-1], _FINE)
    modelled = sampled_process(model.process, seen.sample_time, fine * seen.sample_time)
    angle = np.unwrap(np.angle(modelled))
    # Near to the model's, so that both are seen on the same turn.
    beside = np.interp(frequency, fine, angle)
    near = beside + np.angle(seen.response[known] * np.exp(-1j * beside))
    spread = np.arcsin(radius / size)
    sizes.errorbar(frequency, size, radius, fmt="o", markersize=3, label="without a model, 95 %")
    angles.errorbar(frequency, np.degrees(near), np.degrees(spread), fmt="o", markersize=3)
    sizes.plot(fine, np.abs(modelled), label=model.template)
    angles.plot(fine, np.degrees(angle))
    sizes.set(xscale="log", yscale="log", ylabel="size", title="behind its hold, sampled")
    angles.set(xscale="log", ylabel="angle [deg]", xlabel="frequency [rad/s]")
    for axes in (sizes, angles):
        axes.grid(True, alpha=0.3)
    sizes.legend()


def plot_fit(model: IdentifiedModel, record: Record, path: Path, seen: FrequencyResponse | None = None) -> None:
    """The fit of a model."""
    _save(fit_figure(model, record, seen), path)


def plot_replay(found: Replay, record: Record, path: Path) -> None:
    """The recorded day and the other one with its bands."""
    if found.measurement is None or found.control is None:
        return
    rows = [
        ("measurement", {"setpoint": (found.time, found.setpoint), "recorded": (record.time, record.measurement),
                         "replayed": (found.time, found.measurement.expected)}),
        ("control", {"": (record.time, record.control)}),
    ]  # fmt: skip
    figure = draw_over_time(rows, title="with other gains, and bands of 95 %", steps=True)
    figure.axes[1].plot(found.time, found.control.expected, color="C2", drawstyle="steps-post")
    figure.axes[1].lines[0].set_color("C1")
    for axes, band in zip(figure.axes, (found.measurement, found.control), strict=True):
        axes.fill_between(found.time, band.low, band.high, color="C2", alpha=0.25, linewidth=0.0)
    _save(figure, path)


def plot_region(region: StabilityRegion, title: str, path: Path) -> None:
    """The stabilising gains and the curve that bounds them."""
    figure = new_figure()
    axes = figure.subplots()
    axes.contourf(region.x, region.y, region.stable, levels=(0.5, 1.5), colors=("#9ecae1",))
    border = region.curve.copy()
    border[:, ~region.border] = float("nan")
    axes.plot(*region.curve, color="#bbbbbb", linewidth=0.8, label="a pole on the imaginary axis")
    axes.plot(*border, color="#08519c", linewidth=1.6, label="border of the stable region")
    axes.set(
        title=title, xlabel=region.plane[0], ylabel=region.plane[1],
        xlim=(region.x[0], region.x[-1]), ylim=(region.y[0], region.y[-1]),
    )  # fmt: skip
    axes.legend()
    _save(figure, path)


def plot_front(front: Front, taken: int | None, path: Path) -> None:
    """The IAE of a load over Ms, by colour for how much noise moves the control; a ring around the design taken."""
    figure = new_figure()
    axes = figure.subplots()
    dots = axes.scatter(front.ms, front.iae_load, c=front.noise_gain, norm="log", s=18, cmap="viridis")
    if taken is not None:
        axes.plot(front.ms[taken], front.iae_load[taken], "o", markersize=11, markerfacecolor="none", color="#d62728")
    text = str(front.process)
    axes.set(xlabel="Ms", ylabel="IAE of a load step", yscale="log",
             title=f"{front.structure} on {text if len(text) < 50 else 'the process'}")  # fmt: skip
    axes.grid(True, which="both", alpha=0.3)
    figure.colorbar(dots, label="gain from measurement noise to control")
    _save(figure, path)


def _save(figure: Figure, path: Path) -> None:
    try:
        figure.savefig(path)
    except (OSError, ValueError) as error:
        raise InputError(f"plot file {str(path)!r}: {' '.join(str(error).split())}") from None
