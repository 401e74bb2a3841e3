"""A bar on stderr for work that takes its time."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import click

_PARTS = 1000


@contextmanager
def progress(label: str) -> Iterator[Callable[[float, str], None]]:
    """What is told the share done and what is done now; silent where stderr is no terminal."""
    if not sys.stderr.isatty():
        yield _silent
        return
    with click.progressbar(length=_PARTS, label=label, file=sys.stderr, item_show_func=lambda what: what) as bar:
        yield lambda share, what: bar.update(round(_PARTS * share) - bar.pos, what)


def _silent(_share: float, _what: str) -> None:
    pass
