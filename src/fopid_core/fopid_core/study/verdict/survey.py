"""A survey of structures: processes of many kinds, and the bounds that every design on them keeps; read from YAML."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fopid_core import safe_yaml
from fopid_core.data import test_batch
from fopid_core.errors import InputError
from fopid_core.model.process import read_process
from fopid_core.study.campaigns.campaign import Range, Task
from fopid_core.study.experiments.yaml_schema import check_name, read_yaml, yaml_text
from fopid_core.study.verdict.columns import CONTROLLERS, SCHEMA

if TYPE_CHECKING:
    import pyarrow as pa

MOST = 100_000
"""Processes of a survey."""


@dataclass(frozen=True)
class Bounds:
    """What all designs on a process keep.

    Attributes
    ----------
    ms_max, mt_max : float
    noise : float
        On the gain from noise to control up to the Nyquist frequency, in units of one over the process's gain.
    """

    ms_max: float = 1.6
    mt_max: float = 1.6
    noise: float = 20.0

    def __post_init__(self) -> None:
        for name, least in (("ms_max", 1.0), ("mt_max", 1.0), ("noise", 0.0)):
            if not least < getattr(self, name) < math.inf:
                raise InputError(f"{name} = {getattr(self, name)}; allowed: above {least:g}, finite")


@dataclass(frozen=True)
class Kind:
    """Processes that are alike.

    Attributes
    ----------
    name : str
    batch : str
        A family of the test batch of Astrom and Hagglund, ``P1`` to ``P9``, whole; or
    process : str
        a transfer function with ``{names}`` in place of numbers, ``draw`` says between what each is drawn, ``count``
        how often, ``seed`` from which random numbers.
    bounds : Bounds, optional
        In place of the survey's.
    """

    name: str
    batch: str = ""
    process: str = ""
    draw: Mapping[str, Range] = field(default_factory=dict)
    count: int = 0
    seed: int = 0
    bounds: Bounds | None = None

    def __post_init__(self) -> None:
        check_name(self.name)
        if bool(self.batch) == bool(self.process):
            raise InputError(f"kind {self.name!r} has {'both' if self.batch else 'neither'} of batch and process")
        if self.process and not 0 < self.count <= MOST:
            raise InputError(f"count = {self.count}; allowed: 1 to {MOST:,}")
        for text in self.texts[:1]:
            read_process(text)
        if not self.texts:
            families = sorted({name.split()[0] for name in test_batch()})
            raise InputError(f"batch = {self.batch!r}; allowed: {', '.join(families)}")

    @cached_property
    def texts(self) -> tuple[str, ...]:
        """The processes, as on the command line.

        Examples
        --------
        >>> Kind("lag", process="1/({t}s+1)", draw={"t": Range(1.0, 3.0)}, count=2, seed=1).texts
        ('1/(2.023643s+1)', '1/(2.900927s+1)')
        """
        if self.batch:
            return tuple(text for name, text in test_batch().items() if name.split()[0] == self.batch)
        random = np.random.default_rng(self.seed)
        drawn = {name: span.draw(random, self.count) for name, span in self.draw.items()}
        rows = ({name: f"{values[i]:.7g}" for name, values in drawn.items()} for i in range(self.count))
        try:
            return tuple(self.process.format(**row) for row in rows)
        except (KeyError, IndexError, ValueError) as error:
            raise InputError(f"process = {self.process!r} needs a draw for {error}") from None


@dataclass(frozen=True)
class Case:
    """One process, what kind it is, and what its designs keep."""

    process: str
    kind: str
    bounds: Bounds


@dataclass(frozen=True)
class Survey:
    """PI, PID, FOPI, FOPID and a controller of high order on every process, each at the least IAE of a load step.

    Attributes
    ----------
    name : str
    kinds : tuple of Kind
    bounds : Bounds
        Of all kinds that have none of their own.
    filter_order : int
        Of the measurement's filter, whose time is chosen with the gains.
    again_every : int
        Every so many-th process is searched a second time from other random starts: how good the optima are.
    high_order_every : int
        Every so many-th process gets a controller of high order as well.
    seed : int
        Of the order in which the processes are gone through: any part of the work is a fair sample of the whole.
    survey : str
        What tells such a file from a campaign of given designs: ``structures``.
    """

    name: str
    kinds: tuple[Kind, ...]
    bounds: Bounds = field(default_factory=Bounds)
    filter_order: int = 2
    again_every: int = 4
    high_order_every: int = 1
    seed: int = 0
    survey: str = "structures"

    schema = SCHEMA
    figure = ()

    def __post_init__(self) -> None:
        check_name(self.name)
        if self.survey != "structures":
            raise InputError(f"survey = {self.survey!r}; allowed: structures")
        if self.filter_order not in (1, 2):
            raise InputError(f"filter_order = {self.filter_order}; allowed: 1 or 2")
        for name in ("again_every", "high_order_every"):
            if not 0 < getattr(self, name) <= MOST:
                raise InputError(f"{name} = {getattr(self, name)}; allowed: 1 to {MOST:,}")
        if not self.kinds:
            raise InputError("kinds; allowed: at least one")

    @cached_property
    def cases(self) -> tuple[Case, ...]:
        """All processes, in the order in which they are worked on."""
        ordered = [Case(text, kind.name, kind.bounds or self.bounds) for kind in self.kinds for text in kind.texts]
        return tuple(ordered[i] for i in np.random.default_rng(self.seed).permutation(len(ordered)))

    @property
    def runs(self) -> int:
        """Rows of the result: one for each controller on each process."""
        return len(self.cases) * len(CONTROLLERS)

    def tasks(self) -> Iterator[Task]:
        """One process each."""
        return (Task((i,), 0, len(CONTROLLERS)) for i in range(len(self.cases)))

    def run(self, task: Task) -> pa.Table:
        """The rows of one task."""
        from fopid_core.study.verdict.designs import case_rows  # slow to import, and done in parallel by the workers

        (number,) = task.groups
        again, high = number % self.again_every == 0, number % self.high_order_every == 0
        return case_rows(number, self.cases[number], self.filter_order, again, high)

    @property
    def work(self) -> str:
        """What is run, as text."""
        return yaml_text(self)


def is_survey(path: Path) -> bool:
    """Whether a file of ``fopid campaign`` is a survey: it says so by the key ``survey``."""
    try:
        return any(line.startswith("survey:") for line in safe_yaml.read_text(path).splitlines())
    except (OSError, ValueError):
        return False  # whoever reads it as a campaign says why it cannot be read


def read_survey(path: Path) -> Survey:
    """Read a survey file.

    Raises
    ------
    InputError
        Naming the file, the line and the key that cannot be used.
    """
    return read_yaml(path, Survey, "survey")
