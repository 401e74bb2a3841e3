"""Command lines near to what people type, for every verb and option there is, and what must hold for each."""

from __future__ import annotations

import atexit
import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import chdir, contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import click
import numpy as np

from fopid_core.cli.main import main

from ..core.cli.runner import invoke
from .texts import TextFuzzer, TooLongError, limited

SECONDS = 30.0
"""Of processor time, for each line."""


@dataclass(frozen=True)
class Habit:
    """How a verb is used here.

    Attributes
    ----------
    weight : float
        How often, relative to the others: rarely where an answer takes seconds, so that a case costs little on average.
    always : tuple of str
        Options that a line always has, most of them to bound a search that would take longer.
    refused : bool
        Whether only lines that must be refused are made: the answer takes a minute whatever the line says.
    """

    weight: float
    always: tuple[str, ...] = ()
    refused: bool = False


HABITS = {
    "benchmark": Habit(0.2, refused=True),
    "campaign": Habit(0.2, ("--workers",)),
    "certify": Habit(5, ("--gains", "--effort")),
    "compare": Habit(0.1),
    "design": Habit(0.1),
    "evaluate": Habit(34, ("--gains",)),
    "explore": Habit(4, ("--port",)),
    "export": Habit(14, ("--out",)),
    "front": Habit(0.2, ("--points",)),
    "identify": Habit(0.6),
    "limit": Habit(0.6, ("--cells",)),
    "reduce": Habit(1),
    "region": Habit(1, ("--points",)),
    "repair": Habit(2),
    "replay": Habit(1, ("--gains",)),
    "report": Habit(0.15),
    "reproduce": Habit(0.2, refused=True),
    "schedule": Habit(2),
    "simulate": Habit(0.5),
    "step": Habit(20, ("--gains",)),
    "tune frequency": Habit(0.4),
    "tune rule": Habit(5),
    "tune time": Habit(0.3, ("--timeout",)),
}
GAIN_FIELDS = (
    "kp", "ki", "kd", "lam", "mu", "filter_order", "filter_time", "setpoint_weight", "derivative_setpoint_weight",
)  # fmt: skip
ODD_VALUES = ("nan", "inf", "-inf", "-1", "", "x", "1,2", "0", "1e308", "1e-308", "1000000000", "-0")
PATHS = ("", ".", os.devnull, "/no/such/folder/x", "missing.csv", 300 * "x", "no\nfile")
BAG, RECORD, GIVEN = "bag", "record.csv", "given.yaml"
WHOLE_RECORDS = (RECORD, "day.csv", BAG)
RECORDS = (*WHOLE_RECORDS, *PATHS)
USUAL_NUMBERS = ("1", "2", "0.5", "3", "0.2", "1.3", "0.05", "10")
SURE = {
    "--out": ("out", "out.csv", *PATHS), "--csv": (RECORD, "front.csv", *PATHS),
    "--page": ("page.html", "page", *PATHS),
    "--figures": ("figures", "more/figures", *PATHS),
    "--plot": ("drawn.png", "drawn.svg", "drawn", "drawn.exe", *PATHS),
    "--check": (GIVEN, RECORD, *PATHS), "--params": (GIVEN, GIVEN, *PATHS), "--replay": (BAG, BAG, RECORD, *PATHS),
    "--record": RECORDS,
    "--effort": ("0.5", "1", "1e-9", "-1", "nan"), "--timeout": ("1", "2", "0.1", "0", "-1", "nan"),
    "--workers": ("1", "1", "0", "-1", "x"), "--scheduler": ("", "x", "tcp://127.0.0.1"),
    "--port": ("-1", "65536", "x"),
    "--cells": ("8", "20", "0", "x"), "--points": ("5", "20", "2", "0", "-1", "1000000000", "x"),
}  # fmt: skip
"""Values of options that get no other: what they name is written, waited for or searched for long; good ones first."""
GIVEN_TEXTS = {
    "process": "process: 1/(s+1)^3\n",
    "schedule": "variable: level\nprocess: K/(s+1)\nsample_time: 0.1\nbounds: {ms_max: 1.7}\npoints:\n"
    "  - {at: 0.5, kp: 2.0, ki: 0.3, K: 1.0}\n  - {at: 1.0, kp: 3.5, ki: 0.35, K: 0.5}\n",
    "campaign": "name: small\nprocesses: [P1]\nvariations: {gain: {low: 0.5, high: 2}, samples: 2}\ndesigns:\n"
    "  - {name: ours, method: rule, rule: simc-pi}\nfigure: [ms, itae]\n",
    "experiment": "name: small\nprocess: P1\ngains: {kp: 1, ki: 0.25}\nphases:\n"
    "  - {name: step, duration: 2, setpoint: 1}\n  - {name: load, duration: 1, disturbance: 0.5}\n",
    "parameters": "/**:\n  ros__parameters:\n    kp: 1.0\n    ki: 0.5\n    lam: 0.9\n    sample_time: 0.01\n",
}
"""What ``given.yaml`` holds."""


@cache
def verbs() -> dict[str, click.Command]:
    """All verbs of the command line by name; those of a group have two words."""
    found = {}
    for name, command in main.commands.items():
        if isinstance(command, click.Group):
            found |= {f"{name} {verb}": inner for verb, inner in command.commands.items()}
        else:
            found[name] = command
    return found


@dataclass(frozen=True)
class Line:
    """The arguments of ``fopid``, and what ``given.yaml`` beside it holds."""

    arguments: tuple[str, ...]
    given: str = ""

    def to_bytes(self) -> bytes:
        """As a case that is kept."""
        return json.dumps([*self.arguments, self.given]).encode()

    @staticmethod
    def of_bytes(case: bytes) -> Line:
        """A case that was kept."""
        *arguments, given = json.loads(case)
        return Line(tuple(arguments), given)


class Fuzzer(TextFuzzer):
    """A source of texts, command lines and requests; the same seed gives the same ones."""

    careful = False
    """Whether the line in the making is of one who knows how, so that most such lines are answered."""

    def number(self) -> str:
        """A number as people type it."""
        return self.one_of(*USUAL_NUMBERS) if self.careful else super().number()

    def process(self) -> str:
        """A process, often with slips."""
        return self.usual() if self.careful else super().process()

    def value(self) -> str:
        """The value of an option."""
        return self.one_of(*ODD_VALUES) if self.happens(0.01 if self.careful else 0.15) else self.number()

    def gains(self) -> str:
        """Five numbers, or what is taken for them."""
        orders = (self.one_of("1", "0.9", "1.2", "0.5", self.value()) for _ in range(2))
        parts = [self.number(), self.number(), self.number(), *orders]
        return ",".join(parts[: self.rng.integers(6)] if self.happens(0.05) else parts)

    def line(self, among: Sequence[str] = tuple(HABITS)) -> Line:
        """A command line of one of these verbs."""
        weights = np.array([HABITS[verb].weight for verb in among])
        verb = among[int(self.rng.choice(len(among), p=weights / weights.sum()))]
        self.careful = self.happens(0.6)
        habit, command = HABITS[verb], verbs()[verb]
        line, bounding = verb.split(), []
        for parameter in command.params:
            if isinstance(parameter, click.Argument):
                line += [self._argument(verb)] if parameter.required or self.happens(0.9) else []
            elif parameter.opts[0] in habit.always:
                bounding += self._option(parameter, always=True)
            else:
                line += self._option(parameter)
        if habit.refused:
            line += [self.one_of("--points", "x", "--jsn", "")]
        elif not self.careful and self.happens(0.05):
            line = line[: max(len(verb.split()), len(line) - int(self.rng.integers(1, 4)))]
        line += bounding
        return Line(tuple(part.replace("\0", "") for part in line), self._given(verb) if GIVEN in line else "")

    def _argument(self, verb: str) -> str:
        if verb in ("campaign", "schedule", "simulate"):
            return GIVEN if self.careful or self.happens(0.9) else self.one_of(*RECORDS)
        if verb in ("identify", "replay", "repair", "report"):
            return self.one_of(*(WHOLE_RECORDS if self.careful else RECORDS))
        if self.happens(0.03):
            return self.one_of(GIVEN, *RECORDS)
        return self.process()

    def _given(self, verb: str) -> str:
        usual = {"campaign": "campaign", "schedule": "schedule", "simulate": "experiment", "export": "parameters"}
        kind = usual.get(verb, "process") if self.careful or self.happens(0.9) else self.one_of(*GIVEN_TEXTS)
        text = GIVEN_TEXTS[kind]
        if self.happens(0.5):
            text = text.replace(self.one_of("0.5", "1.0", "P1", "0.1", "0.25", "2"), self.value())
        return text if self.careful or self.happens(0.4) else self.slips(text)

    def _option(self, option: click.Parameter, always: bool = False) -> list[str]:
        name = option.opts[0]
        if name == "--json":
            return [name] * self.happens(0.7)
        share = 0.02 if name in ("--plot", "--certify", "--compare", "--figures", "--page") else 0.15
        if not (always or option.required or self.happens(share)):
            return []
        if isinstance(option, click.Option) and option.is_flag:
            return [self.one_of(*option.opts, *option.secondary_opts)]
        return [name, self._option_value(name)]

    def _option_value(self, option: str) -> str:
        if option in ("--gains", "--start", "--before"):
            return self.gains()
        sure, words = SURE.get(option, ()), self._words().get(option, ())
        if sure:
            return self.one_of(*(sure[:2] if self.careful else sure))
        return self.one_of(*words) if words and (self.careful or self.happens(0.9)) else self.value()

    def _words(self) -> dict[str, tuple[str, ...]]:
        """Values of options that mostly look like these."""
        value, number, place = self.value(), self.number(), f"-{self.number()}@{self.number()}"
        return {
            "--filter": ("1,0.1", "2,0.1", "0,0", f"2,{value}"), "--setpoint-weights": ("0,0", "0.7,0", f"{value},1"),
            "--structure": ("p", "pi", "pd", "pid", "fopi", "fopid", "fopd"), "--solver": ("square", "nelder-mead"),
            "--box": ("K=0.5,2", "L=0,0.1", f"K=1,{value}"), "--confidence": ("0.9",), "--region": ("box", "ellipsoid"),
            "--prefer": ("load", "balanced"), "--filter-order": ("0", "1", "2"), "--take": ("0", "1"),
            "--columns": ("measurement,control", "2,1,3", f"1,{value}"), "--namespace": ("", "/", "loop"),
            "--topic": (f"{value}=/x", "measurement=/y:data"), "--process": (self.process(),),
            "--via": ("foptd", "none"),
            "--template": ("foptd", "soptd", "all", f"rational:1/{value}"), "--precision": ("53", "128", value),
            "--ms-max": ("1.4", "1.7", "2", "inf", value), "--mt-max": ("1.3", "2", value),
            "--ms-min": ("1.1", "1.3", value),
            "--horizon": ("5", "20", "100", value), "--sample-time": ("0.01", "0.1", value),
            "--u-max": ("10", "30", value),
            "--noise-max": ("10", "100", value), "--step": ("0.01", "0.1", value), "--method": ("exact", "gl1"),
            "--input": ("setpoint", "load", "both"), "--index": ("itae", "iae", "ise"),
            "--rule": ("simc-pi", "amigo-pid", "fmigo", "dominant-poles"), "--criterion": ("peaks", "ms", "flatness"),
            "--fix": ("ki=0", "lam=1", f"mu={value}"), "--bound": ("kp=0,1", f"kd={number},{value}"),
            "--seed": ("0", "1"),
            "--weight": ("itae=1", f"energy={value}"), "--t-max": (place,), "--s-max": (place,),
            "--orders": ("1,1", "0.8,1.2", f"{value},1"), "--phase-margin": ("60", "45", "80"),
            "--limits": ("0,1", "-1,1", f"{value},{number}"), "--set": (f"kp={value}", "tracking_time=1", f"x={value}"),
            "--name": ("loop", "class", value), "--from": ("0", "1", number), "--to": ("30", number),
        }  # fmt: skip

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


@cache
def _records() -> Path:
    """A folder with what the lines read, until this process ends."""
    from rosbags.rosbag2 import StoragePlugin

    from ..core.study.days import write_day
    from ..core.study.recording import Recording, record_loop

    made = Path(tempfile.mkdtemp(prefix="fopid_fuzzing-"))
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    recording = Recording(made / BAG, StoragePlugin.MCAP)
    record_loop(recording, stretch=0.5)
    recording.writer.close()
    time = np.arange(0.0, 20.0, 0.2)
    table = np.column_stack([time, time > 0.0, 2.0 * -np.expm1(-np.maximum(time - 1.0, 0.0) / 3.0)])
    np.savetxt(made / RECORD, table, delimiter=",", header="time,control,measurement", comments="")
    write_day(made / "day.csv")
    return made


@contextmanager
def _among_files(given: str) -> Iterator[None]:
    """A folder of its own to work in: what a line writes is not there for the next one."""
    with tempfile.TemporaryDirectory(prefix="fopid_line-") as place:
        folder = shutil.copytree(_records(), Path(place) / "files")
        (folder / GIVEN).write_text(given, encoding="utf-8")
        with chdir(folder):
            yield


def line_fault(line: Line) -> str:
    """What is wrong with how a command line is answered; empty when nothing is."""
    try:
        with _among_files(line.given), limited(SECONDS):
            result = invoke(line.arguments)
    except TooLongError as error:
        return str(error)
    if isinstance(result.exception, TooLongError):
        return str(result.exception)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        return f"{type(result.exception).__name__}: {result.exception}"
    if result.exit_code not in (0, 2, 3):
        return f"exit status {result.exit_code}"
    if result.exit_code == 2:
        return "" if result.stderr.count("\n") == 1 else f"not one line: {result.stderr!r}"
    if "--json" in line.arguments:
        try:
            json.loads(result.stdout)
        except json.JSONDecodeError as error:
            return f"no JSON: {error}"
    return ""
