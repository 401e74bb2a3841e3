"""A campaign: many designs on many variations of many processes; read from YAML by ``read_campaign``."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise, product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np

from fopid_core.errors import InputError
from fopid_core.model.arrays import Floats
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import read_process
from fopid_core.study.campaigns.columns import MEASURES, SCHEMA, SPECIFICATION, VARIED
from fopid_core.study.experiments.loop_parameters import GAIN_KEYS
from fopid_core.study.experiments.tune_call import TuneCall
from fopid_core.study.experiments.yaml_schema import Keys, SchemaError, check_name, read_yaml, yaml_text

if TYPE_CHECKING:
    import pyarrow as pa

MOST_RUNS = 10_000_000
RUNS_AT_ONCE = 500
"""Runs of a task at most: about half a second's work."""
TUNINGS_AT_ONCE = 5
"""Tunings of a task at most; one takes up to half a second."""
DISTRIBUTIONS = ("uniform", "loguniform")


@dataclass(frozen=True)
class Range:
    """What is drawn at random between ``low`` and ``high``: ``uniform``, or ``loguniform`` (alike for x2 and /2)."""

    low: float
    high: float
    distribution: str = "uniform"

    def __post_init__(self) -> None:
        if not -math.inf < self.low <= self.high < math.inf:
            raise InputError(f"low = {self.low}, high = {self.high}; allowed: finite numbers, the lower one first")
        if self.distribution not in DISTRIBUTIONS:
            raise InputError(f"distribution = {self.distribution!r}; allowed: {', '.join(DISTRIBUTIONS)}")
        if self.distribution == "loguniform" and self.low <= 0.0:
            raise InputError(f"low = {self.low}; allowed: above 0 with distribution loguniform")

    def draw(self, random: np.random.Generator, count: int) -> Floats:
        """So many values."""
        if self.distribution == "loguniform":
            return np.exp(random.uniform(math.log(self.low), math.log(self.high), count))
        return random.uniform(self.low, self.high, count)


@dataclass(frozen=True)
class Variations:
    """How the processes differ from what the designs were made for; the same variations for all designs.

    Attributes
    ----------
    gain, time_scale : tuple of float, or Range
        Factors on the gain, and on all times of the process.
    delay : tuple of float, or Range
        Further delay [s].
    samples : int
        How often the ranges are drawn; lists are gone through in every combination, for each draw.
    seed : int
    """

    gain: tuple[float, ...] | Range = (1.0,)
    time_scale: tuple[float, ...] | Range = (1.0,)
    delay: tuple[float, ...] | Range = (0.0,)
    samples: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        for name in VARIED:
            values = getattr(self, name)
            ends = (values.low, values.high) if isinstance(values, Range) else values
            if not ends or not all(map(math.isfinite, ends)):
                raise InputError(f"{name} = {list(ends)}; allowed: finite numbers, at least one")
            if name == "gain" and min(ends) <= 0.0 <= max(ends):
                raise InputError(f"gain = {list(ends)}; allowed: factors of one sign, not 0")
        for name, least in (("time_scale", 1e-9), ("delay", 0.0)):
            values = getattr(self, name)
            lowest = values.low if isinstance(values, Range) else min(values)
            if lowest < least:
                raise InputError(f"{name} = {lowest}; allowed: {'0 s or more' if name == 'delay' else 'above 0'}")
        for name, low in (("samples", 1), ("seed", 0)):
            if not low <= getattr(self, name) <= MOST_RUNS:
                raise InputError(f"{name} = {getattr(self, name)}; allowed: {low} to {MOST_RUNS:,}")

    @property
    def count(self) -> int:
        """How many, the process as it is among them."""
        kinds = (getattr(self, name) for name in VARIED)
        return 1 + self.samples * math.prod(1 if isinstance(kind, Range) else len(kind) for kind in kinds)

    def table(self) -> Floats:
        """The variations, one a row of (gain, time_scale, delay): first the process as it is.

        Examples
        --------
        >>> Variations(gain=(0.5, 2.0), delay=Range(0.1, 0.1)).table().tolist()
        [[1.0, 1.0, 0.0], [0.5, 1.0, 0.1], [2.0, 1.0, 0.1]]
        """
        kinds = [getattr(self, name) for name in VARIED]
        grids = [(math.nan,) if isinstance(kind, Range) else kind for kind in kinds]
        rows = np.repeat(np.array(list(product(*grids))), self.samples, axis=0)
        random = np.random.default_rng(self.seed)
        for column, kind in enumerate(kinds):
            if isinstance(kind, Range):
                rows[:, column] = kind.draw(random, len(rows))
        return np.vstack([[1.0, 1.0, 0.0], rows])


@dataclass(frozen=True)
class Design:
    """A controller, or a way to find one; lists of specifications are gone through in every combination.

    Attributes
    ----------
    name : str
    gains : mapping
        kp, ki, kd, lam, mu, when they are known; otherwise the tuner finds them for the process as it is.
    only : tuple of str
        The processes it is for; all when none is given.
    method, phase_margin_deg, crossover, t_max_db, t_max_frequency, s_max_db, s_max_frequency, index, ms_max, u_max, \
    horizon, via, rule
        As the tuner takes them.
    """

    name: str
    gains: Annotated[Mapping[str, float], Keys(GAIN_KEYS)] = field(default_factory=dict)
    only: tuple[str, ...] = ()
    method: str | tuple[str, ...] = ""
    phase_margin_deg: float | tuple[float, ...] = ()
    crossover: float | tuple[float, ...] = ()
    t_max_db: float | tuple[float, ...] = ()
    t_max_frequency: float | tuple[float, ...] = ()
    s_max_db: float | tuple[float, ...] = ()
    s_max_frequency: float | tuple[float, ...] = ()
    index: str | tuple[str, ...] = ""
    ms_max: float | tuple[float, ...] = ()
    u_max: float | tuple[float, ...] = ()
    horizon: float | tuple[float, ...] = ()
    via: str | tuple[str, ...] = ""
    rule: str | tuple[str, ...] = ""

    def __post_init__(self) -> None:
        if bool(self.gains) == bool(self.method):
            raise InputError(f"design {self.name!r} has {'both' if self.gains else 'neither'} of gains and method")
        if self.gains:
            Fopid(**{"kp": 0.0, **self.gains})

    @property
    def controllers(self) -> list[Fopid | TuneCall]:
        """The controller, or what the tuner is asked: one for each combination of the specifications."""
        if self.gains:
            return [Fopid(**{"kp": 0.0, **self.gains})]
        given = {name: getattr(self, name) for name in SPECIFICATION}
        lists = {name: value if isinstance(value, tuple) else (value,) for name, value in given.items() if value != ()}
        return [TuneCall(**dict(zip(lists, row, strict=True))) for row in product(*lists.values())]


@dataclass(frozen=True)
class Group:
    """All runs of one controller on one process."""

    process: str
    design: str
    controller: Fopid | TuneCall


@dataclass(frozen=True)
class Task:
    """A piece of work: of each of these groups the variations from ``first`` to ``end`` - 1.

    Attributes
    ----------
    groups : tuple of int
    first, end : int
    """

    groups: tuple[int, ...]
    first: int
    end: int

    @property
    def runs(self) -> int:
        """How many."""
        return len(self.groups) * (self.end - self.first)

    @property
    def name(self) -> str:
        """Says which runs these are."""
        return f"{self.groups[0]:07}-{self.groups[-1]:07}-{self.first:08}-{self.end:08}"


@dataclass(frozen=True)
class Campaign:
    """What is run: every design on every variation of every process.

    Attributes
    ----------
    name : str
    processes : tuple of str
        As on the command line.
    designs : tuple of Design
    variations : Variations
    horizon : float
        Of the setpoint steps [s]; 0 chooses it from each process.
    sample_time : float
        Tick of the controller as it will run [s].
    figure : tuple of str
        Measures that are drawn, of ``MEASURES``.
    """

    name: str
    processes: tuple[str, ...]
    designs: tuple[Design, ...]
    variations: Variations = field(default_factory=Variations)
    horizon: float = 0.0
    sample_time: float = 0.01
    figure: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_name(self.name)
        for number, process in enumerate(self.processes):
            try:
                read_process(process)
            except InputError as error:
                raise SchemaError(("processes", number), str(error)) from None
        if not self.processes or not self.designs:
            raise InputError("processes and designs; allowed: at least one of each")
        if not 0.0 <= self.horizon < math.inf:
            raise InputError(f"horizon = {self.horizon}; allowed: 0 or more, finite")
        if not 1e-6 <= self.sample_time <= 1e6:
            raise InputError(f"sample_time = {self.sample_time}; allowed: 1e-06 to 1e+06 [s]")
        for name in self.figure:
            if name not in MEASURES:
                raise InputError(f"figure = {name!r}; allowed: {', '.join(MEASURES)}")
        self._check_designs()
        if self.runs > MOST_RUNS:
            raise InputError(f"designs, processes and variations make {self.runs:,} runs; allowed: {MOST_RUNS:,}")

    def _check_designs(self) -> None:
        for number, design in enumerate(self.designs):
            try:
                for process in design.only:
                    if process not in self.processes:
                        raise InputError(f"only = {process!r}; allowed: {', '.join(self.processes)}")
                for process in design.only or self.processes[:1]:
                    for controller in design.controllers:
                        if isinstance(controller, TuneCall):
                            controller.request(read_process(process), self.sample_time)
            except InputError as error:
                raise SchemaError(("designs", number), str(error)) from None

    @property
    def groups(self) -> list[Group]:
        """Process by process, design by design."""
        return [
            Group(process, design.name, controller)
            for process in self.processes
            for design in self.designs
            if not design.only or process in design.only
            for controller in design.controllers
        ]

    @property
    def runs(self) -> int:
        """How many."""
        return len(self.groups) * self.variations.count

    def tasks(self) -> Iterator[Task]:
        """The whole work in pieces, in the order of the runs."""
        count = self.variations.count
        together = max(1, min(TUNINGS_AT_ONCE, RUNS_AT_ONCE // count))
        pieces = math.ceil(count / RUNS_AT_ONCE)
        ends = [count * piece // pieces for piece in range(pieces + 1)]
        groups = range(len(self.groups))
        for start in groups[::together]:
            for first, end in pairwise(ends):
                yield Task(tuple(groups[start : start + together]), first, end)

    schema = SCHEMA

    def run(self, task: Task) -> pa.Table:
        """The rows of one task."""
        from fopid_core.study.campaigns.task import run_task  # slow to import, and done in parallel by the workers

        return run_task(self, task)

    @property
    def work(self) -> str:
        """What is run, as text: all but the figure, which can be drawn anew from the same results."""
        return replace(self, figure=()).to_yaml()

    def to_yaml(self) -> str:
        """The text ``read_campaign`` reads back."""
        return yaml_text(self)


def read_campaign(path: Path) -> Campaign:
    """Read a campaign file.

    Raises
    ------
    InputError
        Naming the file, the line and the key that cannot be used.
    """
    return read_yaml(path, Campaign, "campaign")
