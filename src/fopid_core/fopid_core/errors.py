"""The one family of errors that bad input raises.

Every message names the input, its value and what is allowed, in one line.
"""

from __future__ import annotations

import math
from collections.abc import Iterable


class InputError(ValueError):
    """An input that cannot be used."""


class UnknownResponseError(InputError):
    """A response that is asked for and cannot be had to an accuracy that is known.

    Attributes
    ----------
    reason : str
        Why, without what was asked for and what is allowed.
    """

    def __init__(self, reason: str, allowed: str = "", horizon: float = math.nan) -> None:
        self.reason = reason
        asked = f"horizon = {horizon:g} s: " if math.isfinite(horizon) else ""
        super().__init__(f"{asked}{reason}{f'; allowed: {allowed}' if allowed else ''}")


class UnboundedResponseError(UnknownResponseError):
    """A response that grows beyond all numbers within the time that is asked for."""


class ExpressionError(InputError):
    """A process text that cannot be read.

    Attributes
    ----------
    text : str
        The text as given.
    position : int
        Index of the first character that does not fit (``len(text)`` when the text ends too soon).
    reason : str
        What is wrong there.
    """

    def __init__(self, text: str, position: int, reason: str) -> None:
        self.text, self.position, self.reason = text, position, reason
        super().__init__(f"process text {text!r}, character {position + 1}: {reason}")

    def pointer(self) -> str:
        """Two lines: the text, and a caret under the character that does not fit."""
        return f"{self.text}\n{' ' * self.position}^"


def did_you_mean(given: str, known: Iterable[str]) -> str:
    """The nearest of the names that are known, as the end of a message; empty where none is near.

    Examples
    --------
    >>> did_you_mean("ITAE", ["iae", "itae"]), did_you_mean("--phasemargin", ["--phase-margin"])
    ('; did you mean itae?', '; did you mean --phase-margin?')
    """
    from difflib import get_close_matches

    lower = {name.lower(): name for name in known}
    found = get_close_matches(given.lower(), lower, 1, 0.6)
    return f"; did you mean {lower[found[0]]}?" if found and lower[found[0]] != given else ""
