"""Transfer functions near to what people type, and what must hold for each: an answer or one line, soon."""

from __future__ import annotations

import signal
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

import numpy as np

from fopid_core.errors import InputError
from fopid_core.model.process import Process

TEXT_SECONDS = 2.0
"""Of processor time, for each."""

NUMBERS = (
    "1", "2", "0.5", "3", "10", "0", "0.02", "1.3", "100", "1e-3", "1e3", ".7", "5.", "1e9", "1e-9", "1e100", "1e308",
    "1e-320", "1e400", "0.999", "12345.678", "1e15",
)  # fmt: skip
COMMON = 12  # of the numbers; the others are rare
ALPHABET = "s()+-*/^e.0123456789 xp·,=jES\t\n#é\x00"


class TooLongError(Exception):
    """A case takes longer than it may."""


class TextFuzzer:
    """A source of texts; the same seed gives the same ones."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)

    def one_of(self, *choices: str) -> str:
        """Any of them."""
        return choices[int(self.rng.integers(len(choices)))]

    def happens(self, share: float) -> bool:
        """Whether it does, in this share of all cases."""
        return bool(self.rng.random() < share)

    def number(self) -> str:
        """A number as people type it."""
        return self.one_of(*(NUMBERS if self.happens(0.1) else NUMBERS[:COMMON]))

    def factor(self, depth: int) -> str:
        """A factor of a transfer function."""
        kind = int(self.rng.integers(8))
        if depth == 0 or kind < 3:
            return self.one_of(
                "s", f"({self.number()}s+1)", f"s^{self.number()}", self.number(), f"(s+{self.number()})"
            )
        if kind == 3:
            return f"({self.sum(depth - 1)})"
        if kind == 4:
            return f"({self.sum(depth - 1)})^{self.one_of('2', '3', '0', '-1', self.number())}"
        if kind == 5:
            return self.one_of(
                f"exp(-{self.number()}s)", f"e^(-{self.number()}s)", f"e^-{self.number()}s", "e", "exp(-s)"
            )
        if kind == 6:
            return f"({self.number()}s^2+{self.number()}s+{self.number()})"
        return f"(s^{self.number()}-{self.number()})"

    def product(self, depth: int) -> str:
        """Factors with or without operators."""
        text = self.factor(depth)
        for _ in range(int(self.rng.integers(3))):
            text += self.one_of("*", "", "/", " * ", "**", "·") + self.factor(depth)
        return text

    def sum(self, depth: int) -> str:
        """Products with signs."""
        text = self.one_of("", "-", "+", "") + self.product(depth)
        for _ in range(int(self.rng.integers(3))):
            text += self.one_of("+", "-") + self.product(depth)
        return text

    def usual(self) -> str:
        """A process as it mostly looks."""
        lags = "".join(f"({self.number()}s+1)" for _ in range(1 + int(self.rng.integers(3))))
        delay = f"*exp(-{self.number()}s)" if self.happens(0.4) else ""
        over = self.one_of("1", self.number(), f"(1-{self.number()}s)", "s", f"-{self.number()}")
        return f"{over}/({self.one_of('', 's*', '')}{lags}{self.one_of('', '(s^2+0.1s+1)', '')}){delay}"

    def process(self) -> str:
        """A process, often with slips."""
        kind = self.rng.random()
        text = self.usual() if kind < 0.5 else f"1/({self.sum(2)})" if kind < 0.7 else self.sum(3)
        return self.slips(text) if self.happens(0.3) else text

    def slips(self, text: str) -> str:
        """The text with some characters lost, doubled, exchanged or put in."""
        for _ in range(1 + int(self.rng.integers(4))):
            at = int(self.rng.integers(len(text) + 1))
            what = self.one_of("lose", "double", "put", "exchange", "repeat")
            middle = {
                "lose": "", "double": 2 * text[at : at + 1], "put": self.one_of(*ALPHABET) + text[at : at + 1],
                "exchange": self.one_of(*ALPHABET), "repeat": text[at : at + 9] * 40,
            }[what]  # fmt: skip
            text = text[:at] + middle + text[at + 1 :]
        return text


@contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Processor time for what is done inside; more of it raises TooLongError. Warnings are errors."""

    def too_long(_signal: int, _frame: FrameType | None) -> None:
        raise TooLongError(f"more than {seconds:g} s")

    before = signal.signal(signal.SIGVTALRM, too_long)
    signal.setitimer(signal.ITIMER_VIRTUAL, seconds)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)


def text_fault(text: str) -> str:
    """What is wrong with how a process text is answered; empty when nothing is."""
    try:
        with limited(TEXT_SECONDS):
            process = Process.parse(text)
            again = Process.parse(str(process)) if len(str(process)) < 2000 else process
    except InputError as error:
        return "" if str(error) and "\n" not in str(error) else f"not one line: {error}"
    except Exception as error:  # noqa: BLE001  -- whatever it is, it is a fault
        return f"{type(error).__name__}: {error}"
    return "" if again == process else f"reads back as {again}"
