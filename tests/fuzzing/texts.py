"""Texts and command lines near to what people type, and what must hold for each: an answer or one line, soon."""

from __future__ import annotations

import json
import os
import signal
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

import numpy as np

from fopid_core.errors import InputError
from fopid_core.model.process import Process

from ..core.cli.runner import invoke

TEXT_SECONDS, LINE_SECONDS = 2.0, 30.0
"""Of processor time, for each."""

NUMBERS = (
    "1", "2", "0.5", "3", "10", "0", "0.02", "1.3", "100", "1e-3", "1e3", ".7", "5.", "1e9", "1e-9", "1e100", "1e308",
    "1e-320", "1e400", "0.999", "12345.678", "1e15",
)  # fmt: skip
COMMON = 12  # of the numbers; the others are rare
ALPHABET = "s()+-*/^e.0123456789 xp·,=jES\t\n#é\x00"


GAIN_FIELDS = (
    "kp", "ki", "kd", "lam", "mu", "filter_order", "filter_time", "setpoint_weight", "derivative_setpoint_weight",
)  # fmt: skip
BOUNDS = ("--ms-max", "--mt-max", "--noise-max", "--sample-time")
VERBS: dict[str, tuple[int, tuple[str, ...], tuple[str, ...]]] = {
    "evaluate": (8, ("--gains",), ("--horizon", "--method", "--step", "--filter", "--setpoint-weights")),
    "step": (6, ("--gains",), ("--horizon", "--points", "--input", "--filter", "--setpoint-weights")),
    "region": (2, (), ("--orders", "--kd", "--points")),
    "reduce": (1, (), ("--template",)),
    "tune rule": (1, (), ("--rule", "--crossover", "--sample-time")),
    "tune frequency": (
        1, (), ("--phase-margin", "--crossover", "--t-max", "--s-max", "--u-max", "--sample-time", "--criterion"),
    ),
    "tune time": (1, ("--timeout",), (*BOUNDS, "--u-max", "--horizon", "--index", "--fix", "--seed", "--structure")),
    "certify": (3, ("--gains", "--effort"), (*BOUNDS, "--box", "--confidence", "--out")),
    "compare": (1, (), (*BOUNDS, "--prefer", "--filter-order")),
    "front": (1, ("--points",), (*BOUNDS, "--ms-min", "--horizon", "--structure", "--filter-order", "--take")),
    "limit": (2, ("--cells",), (*BOUNDS, "--horizon", "--index", "--input")),
    "explore": (2, ("--port",), ()),
    "design": (1, ("--out",), ("--ms-max", "--sample-time", "--index")),
}  # fmt: skip
"""Of each: how often, the options it always has, and those it may have. ``explore`` never comes to serve."""
WEIGHTS = np.array([weight for weight, *_ in VERBS.values()], dtype=float)


class TooLongError(Exception):
    """A case takes longer than it may."""


class Fuzzer:
    """A source of texts and command lines; the same seed gives the same ones."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)

    def one_of(self, *choices: str) -> str:
        """Any of them."""
        return choices[int(self._rng.integers(len(choices)))]

    def happens(self, share: float) -> bool:
        """Whether it does, in this share of all cases."""
        return bool(self._rng.random() < share)

    def number(self) -> str:
        """A number as people type it."""
        return self.one_of(*(NUMBERS if self.happens(0.1) else NUMBERS[:COMMON]))

    def factor(self, depth: int) -> str:
        """A factor of a transfer function."""
        kind = int(self._rng.integers(8))
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
        for _ in range(int(self._rng.integers(3))):
            text += self.one_of("*", "", "/", " * ", "**", "·") + self.factor(depth)
        return text

    def sum(self, depth: int) -> str:
        """Products with signs."""
        text = self.one_of("", "-", "+", "") + self.product(depth)
        for _ in range(int(self._rng.integers(3))):
            text += self.one_of("+", "-") + self.product(depth)
        return text

    def usual(self) -> str:
        """A process as it mostly looks."""
        lags = "".join(f"({self.number()}s+1)" for _ in range(1 + int(self._rng.integers(3))))
        delay = f"*exp(-{self.number()}s)" if self.happens(0.4) else ""
        over = self.one_of("1", self.number(), f"(1-{self.number()}s)", "s", f"-{self.number()}")
        return f"{over}/({self.one_of('', 's*', '')}{lags}{self.one_of('', '(s^2+0.1s+1)', '')}){delay}"

    def process(self) -> str:
        """A process, often with slips."""
        kind = self._rng.random()
        text = self.usual() if kind < 0.5 else f"1/({self.sum(2)})" if kind < 0.7 else self.sum(3)
        return self.slips(text) if self.happens(0.3) else text

    def slips(self, text: str) -> str:
        """The text with some characters lost, doubled, exchanged or put in."""
        for _ in range(1 + int(self._rng.integers(4))):
            at = int(self._rng.integers(len(text) + 1))
            what = self.one_of("lose", "double", "put", "exchange", "repeat")
            middle = {
                "lose": "", "double": 2 * text[at : at + 1], "put": self.one_of(*ALPHABET) + text[at : at + 1],
                "exchange": self.one_of(*ALPHABET), "repeat": text[at : at + 9] * 40,
            }[what]  # fmt: skip
            text = text[:at] + middle + text[at + 1 :]
        return text

    def value(self) -> str:
        """The value of an option."""
        odd = ("nan", "inf", "-inf", "-1", "", "x", "1,2", "0", "1e308", "1e-308", "1000000000", "-0")
        return self.one_of(*odd) if self.happens(0.15) else self.number()

    def gains(self) -> str:
        """Five numbers, or what is taken for them."""
        orders = (self.one_of("1", "0.9", "1.2", "0.5", self.value()) for _ in range(2))
        parts = [self.number(), self.number(), self.number(), *orders]
        return ",".join(parts[: self._rng.integers(6)] if self.happens(0.05) else parts)

    def line(self) -> list[str]:
        """A command line."""
        verb = self._rng.choice(list(VERBS), p=WEIGHTS / WEIGHTS.sum())
        _, needed, options = VERBS[verb]
        line = [*verb.split(), self.process()]
        for option in needed:
            line += [option, self._option_value(option)]
        for option in options:
            if self.happens(0.2):
                line += [option, self._option_value(option)]
        return [*line, "--json"] if verb != "explore" and self.happens(0.7) else line

    def asked(self, asks: Sequence[str]) -> bytes:
        """A request of the page without ROS, as JSON: one of ``asks``, most of it as it should be."""
        gains = ", ".join(f'"{name}": {self._json()}' for name in GAIN_FIELDS if self.happens(0.4))
        fields = {
            "ask": f'"{self.one_of(*asks)}"', "process": json.dumps(self.process()), "sets": f"[{{{gains}}}]",
            "gains": f"{{{gains}}}", "kind": self.one_of('"yaml"', '"python"', '"c"'),
            "quick": self.one_of("true", "false"), "horizon": self._json(), "sample_time": self._json(),
            "ms_max": self._json(), "effort": self._json(),
        }  # fmt: skip
        wanted = {"predict": ("sets", "quick"), "take": ("gains", "kind")}.get(
            fields["ask"].strip('"'), ("ms_max", "effort")
        )
        kept = ["ask", "process", *wanted, *(name for name in ("horizon", "sample_time") if self.happens(0.2))]
        return ("{" + ", ".join(f'"{name}": {fields[name]}' for name in kept) + "}").encode()

    def _json(self) -> str:
        """A value as JSON has it, mostly a number that can be used."""
        odd = ("null", "true", "[]", "{}", '"x"', "NaN", "-Infinity", "1" + 400 * "0", "1e308", "2.0", "-1", "0")
        return self.one_of(*odd) if self.happens(0.1) else self.one_of("0.1", "0.5", "1", "1.4", "2", "10")

    def _option_value(self, option: str) -> str:
        if option == "--gains":
            return self.gains()
        words = {
            "--filter": ("1,0.1", "2,0.1", "0,0", f"2,{self.value()}", self.value()),
            "--setpoint-weights": ("0,0", "0.7,0", f"{self.value()},1"), "--structure": ("pi", "pid", "fopid", "fopd"),
            "--box": ("K=0.5,2", "L=0,0.1", f"K=1,{self.value()}"), "--confidence": ("0.9",), "--prefer": ("load",),
            "--effort": ("0.5",), "--out": (os.devnull,), "--points": ("2", "5"), "--cells": ("8", "20"),
            "--timeout": ("3",), "--port": ("-1", "65536", "x"),
            "--method": ("exact", "gl1"), "--input": ("setpoint", "load"), "--template": ("foptd", "soptd", "all"),
            "--rule": ("simc-pi", "amigo-pid", "fmigo", "dominant-poles"), "--criterion": ("peaks", "ms", "flatness"),
            "--index": ("itae", "iae", "ise", "sum", "energy"), "--fix": ("ki=0", "lam=1", f"mu={self.value()}"),
            "--t-max": (f"-{self.number()}@{self.number()}",), "--s-max": (f"-{self.number()}@{self.number()}",),
            "--orders": ("1,1", "0.8,1.2", f"{self.value()},1"), "--phase-margin": ("60", "45", "80"),
        }.get(option, ())  # fmt: skip
        sure = option in ("--out", "--effort", "--port") or (words and not self.happens(0.1))
        return self.one_of(*words) if sure else self.value()


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


def line_fault(line: list[str]) -> str:
    """What is wrong with how a command line is answered; empty when nothing is."""
    try:
        with limited(LINE_SECONDS):
            result = invoke(line)
    except TooLongError as error:
        return str(error)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        return f"{type(result.exception).__name__}: {result.exception}"
    if result.exit_code not in (0, 2, 3):
        return f"exit status {result.exit_code}"
    if result.exit_code == 2:
        return "" if result.stderr.count("\n") == 1 else f"not one line: {result.stderr!r}"
    if "--json" in line:
        try:
            json.loads(result.stdout)
        except json.JSONDecodeError as error:
            return f"no JSON: {error}"
    return ""
