"""A legend that takes no place from the axes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure


def legend_outside(
    canvas: Figure, handles: Iterable[Artist], labels: Iterable[str], *, above: bool = False, **style: Any
) -> None:
    """A legend below or above all axes of a figure with constrained layout.

    matplotlib has places of its own for it, "outside lower center" and its like, but only since 3.7.
    """
    style |= {"loc": "upper center" if above else "lower center", "borderaxespad": 0.0}
    legend = canvas.legend(list(handles), list(labels), **style)
    share = legend.get_window_extent().height / canvas.bbox.height
    engine: Any = canvas.get_layout_engine()
    engine.set(rect=(0.0, 0.0 if above else share, 1.0, 1.0 - share))
