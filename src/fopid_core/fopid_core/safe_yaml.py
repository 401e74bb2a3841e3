"""YAML of unknown origin: its size, depth and aliases are looked at before anything is made of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fopid_core.errors import InputError

MOST_BYTES = 50_000_000
MOST_DEPTH = 64
MOST_NODES = 3_000_000
"""Values of a text, each alias counted as what it stands for: a recorded signal has some 100,000 points."""


def load(text: str) -> Any:
    """The plain data of a YAML text.

    Raises
    ------
    InputError
        Naming what is too much, or what cannot be read and where.

    Examples
    --------
    >>> load("a: [1, 2]")
    {'a': [1, 2]}
    >>> load("[" * 100)
    Traceback (most recent call last):
    fopid_core.errors.InputError: line 1: lists and mappings in each other, 65 deep; allowed: 64
    """
    import yaml  # only files need it, and the controller's path must stay light

    check(text)
    try:
        return yaml.load(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise InputError(" ".join(str(error).split())) from None


def read(path: Path, what: str) -> Any:
    """The plain data of a YAML file; ``what`` is what messages call it."""
    try:
        return load(read_text(path))
    except (OSError, ValueError) as error:
        raise InputError(f"{what} {str(path)!r} cannot be read: {' '.join(str(error).split())}") from None


def read_text(path: Path) -> str:
    """The text of a file that is not too large; of a pipe or a device nothing is read."""
    if path.exists() and not path.is_file():
        raise InputError("it is no file; allowed: a file")
    with path.open("rb") as file:
        content = file.read(MOST_BYTES + 1)
    if len(content) > MOST_BYTES:
        raise InputError(f"more than {MOST_BYTES:,} bytes; allowed: up to that")
    return content.decode("utf-8")


def check(text: str) -> None:
    """Raise InputError for a text that is too large, too deep, or becomes too large through its aliases.

    Events come one by one, so nothing grows before it is counted.
    """
    import yaml

    if len(text) > MOST_BYTES:
        raise InputError(f"a text of {len(text):,} characters; allowed: {MOST_BYTES:,}")
    count = _Count()
    try:
        event: Any
        for event in yaml.parse(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
            line = event.start_mark.line + 1
            if isinstance(event, yaml.AliasEvent):
                count.alias(event.anchor, line)
            elif isinstance(event, yaml.CollectionStartEvent):
                count.begin(event.anchor, line)
            elif isinstance(event, yaml.ScalarEvent):
                count.scalar(event.anchor)
            elif isinstance(event, yaml.CollectionEndEvent):
                count.end()
            if count.nodes > MOST_NODES:
                raise InputError(f"line {line}: more than {MOST_NODES:,} values; allowed: up to that")
    except yaml.YAMLError as error:
        raise InputError(" ".join(str(error).split())) from None


class _Count:
    """Of the values so far, and of those behind each anchor."""

    def __init__(self) -> None:
        self.nodes = 0
        self._sizes: dict[str | None, int] = {}
        self._open: list[tuple[str | None, int]] = []

    def scalar(self, anchor: str | None) -> None:
        self.nodes += 1
        self._sizes[anchor] = 1

    def alias(self, anchor: str | None, line: int) -> None:
        if any(anchor == name for name, _ in self._open):
            raise InputError(f"line {line}: *{anchor} stands within what it names; allowed: behind it")
        self.nodes += self._sizes.get(anchor, 1)

    def begin(self, anchor: str | None, line: int) -> None:
        self._open.append((anchor, self.nodes))
        self.nodes += 1
        if len(self._open) > MOST_DEPTH:
            raise InputError(
                f"line {line}: lists and mappings in each other, {len(self._open)} deep; allowed: {MOST_DEPTH}"
            )

    def end(self) -> None:
        anchor, start = self._open.pop()
        self._sizes[anchor] = self.nodes - start
