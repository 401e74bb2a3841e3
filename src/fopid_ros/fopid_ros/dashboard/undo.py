"""The gains that ran before."""

from __future__ import annotations

from collections.abc import Mapping

Gains = Mapping[str, float]

MOST_STEPS = 50


class Undo:
    """Remembers each set of gains that another one took the place of.

    It only watches, so it does not matter who changed the gains; going back is seen as a step back, not as a new one.

    Examples
    --------
    >>> undo = Undo()
    >>> for kp in (1.0, 2.0, 3.0):
    ...     undo.record({"kp": kp})
    >>> undo.previous
    {'kp': 2.0}
    >>> undo.record(undo.previous)
    >>> undo.previous
    {'kp': 1.0}
    """

    def __init__(self) -> None:
        self._present: Gains | None = None
        self._before: list[Gains] = []

    @property
    def previous(self) -> Gains | None:
        """What to go back to; None when nothing came before."""
        return self._before[-1] if self._before else None

    def record(self, gains: Gains) -> None:
        """Take note of the gains that run now."""
        if gains == self._present:
            return
        if gains == self.previous:
            self._before.pop()
        elif self._present is not None:
            self._before = [*self._before, self._present][-MOST_STEPS:]
        self._present = gains
