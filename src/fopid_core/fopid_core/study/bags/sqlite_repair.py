"""Giving the sqlite3 file of a recording that was killed its last transactions back."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

_BESIDE = ("-wal", "-journal")


def is_settled(file: Path) -> bool:
    """Whether all that was recorded is in the file itself, and nothing in a log or journal beside it."""
    return not any(_size(beside) for beside in besides(file))


def besides(file: Path) -> list[Path]:
    """The log and the journal that a writer which was killed leaves beside its file."""
    return [path for ending in _BESIDE if (path := file.with_name(file.name + ending)).exists()]


def settle(file: Path) -> None:
    """Bring log and journal into the file.

    Raises
    ------
    sqlite3.Error
        If it is no database, or damaged.
    """
    with closing(sqlite3.connect(file)) as database:  # opening it for writing rolls a hot journal back
        database.execute("SELECT count(*) FROM sqlite_master").fetchone()
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        database.execute("PRAGMA journal_mode = DELETE")


def _size(path: Path) -> int:
    return path.stat().st_size
