"""Pictures of signals, with matplotlib, which is loaded when one is drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def new_figure() -> Figure:
    """An empty figure that needs no display; a notebook shows it by itself."""
    from matplotlib.figure import Figure

    return Figure(figsize=(7.0, 5.0), layout="constrained")


def draw_over_time(
    rows: Sequence[tuple[str, Mapping[str, tuple[Any, Any]]]],
    figure: Figure | None = None,
    title: str = "",
    steps: bool = False,
) -> Figure:
    """Signals over time, one row of axes above the other.

    Parameters
    ----------
    rows : sequence of (name of the axis, {label: (time, value)})
        A label that is empty shows in no legend.
    figure : Figure, optional
        One that this function has made, to draw into.
    title : str
        Above all.
    steps : bool
        Whether values are held until the next.
    """
    if figure is None:
        figure = new_figure()
        figure.subplots(len(rows), 1, sharex=True, squeeze=False)
    draw_signals(figure.axes, rows, title, steps)
    return figure


def draw_signals(
    column: Sequence[Axes],
    rows: Sequence[tuple[str, Mapping[str, tuple[Any, Any]]]],
    title: str = "",
    steps: bool = False,
) -> None:
    """The same into axes that stand one above the other."""
    for axes, (name, signals) in zip(column, rows, strict=True):
        for label, (time, value) in signals.items():
            axes.plot(time, value, label=label or None, drawstyle="steps-post" if steps else "default")
        axes.set_ylabel(name)
        axes.grid(True, alpha=0.3)
    if title:
        column[0].set_title(title)
    if column[0].get_legend_handles_labels()[0]:
        column[0].legend()
    column[-1].set_xlabel("time [s]")
