"""The one family of errors that bad input raises.

Every message names the input, its value and what is allowed, in one line.
"""

from __future__ import annotations


class InputError(ValueError):
    """An input that cannot be used."""


class UnknownResponseError(InputError):
    """A response that is asked for and cannot be had to an accuracy that is known."""


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
