"""A step of the control that is made bit by bit."""

from __future__ import annotations


class Instalments:
    """What is left of it, and in how many ticks it goes.

    Examples
    --------
    >>> way = Instalments()
    >>> way.left, way.ticks = 3.0, 2
    >>> way.pay(), way.pay(), way.ticks
    (1.5, 1.5, 0)
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Nothing is left."""
        self.left, self.ticks = 0.0, 0

    def pay(self) -> float:
        """One tick's part."""
        part = self.left / self.ticks
        self.left -= part
        self.ticks -= 1
        return part
