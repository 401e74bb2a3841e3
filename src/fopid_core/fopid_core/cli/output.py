"""How the command line shows results: one JSON object for programs, tables for people."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import click
import numpy as np

from fopid_core.errors import InputError
from fopid_core.study.json_values import jsonable

__all__ = ["emit", "jsonable", "text", "write_file"]

UNITS = {
    "rad/s": ("crossover", "phase_crossover", "ms_frequency", "mt_frequency", "crossovers", "phase_crossovers"),
    "s": ("horizon", "rise_time", "rise_time_to_100", "settling_time", "delay_margin", "jitter_margin", "elapsed_s"),
}
"""Units of rows whose names do not say it (as phase_margin_deg does); indices and gains have those of the signals."""

_UNIT = {name: unit for unit, names in UNITS.items() for name in names}


def emit(data: Mapping[str, Any], tables: Iterable[tuple[str, Mapping[str, Any]]], as_json: bool) -> None:
    """Write a result to stdout.

    Parameters
    ----------
    data : mapping
        The whole result, for ``--json``; numbers that are not finite become null.
    tables : iterable of (title, rows)
        What people see instead, rows by name.
    as_json : bool
    """
    if as_json:
        print(json.dumps(jsonable(data), ensure_ascii=False))
        return
    formatter = click.HelpFormatter()
    for title, rows in tables:
        with formatter.section(title):
            formatter.write_dl([(name, with_unit(name, value)) for name, value in rows.items()])
    click.echo(formatter.getvalue(), nl=False)


def text(value: Any) -> str:
    """A value as people read it.

    Examples
    --------
    >>> text(0.123456789), text(float("nan")), text(True), text((1.0, 2.5))
    ('0.12346', '-', 'yes', '1, 2.5')
    """
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, tuple | list):
        return ", ".join(text(item) for item in value) or "-"
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def with_unit(name: str, value: Any) -> str:
    """A value as people read it, with the unit that rows of its name have.

    Examples
    --------
    >>> with_unit("rise_time", 2.5), with_unit("ms", 1.6), with_unit("rise_time", float("nan"))
    ('2.5 s', '1.6', '-')
    """
    shown = text(value)
    return f"{shown} {_UNIT[name]}" if name in _UNIT and shown != "-" else shown


def write_file(option: str, path: Path, content: str) -> None:
    """Write a file that an option named; what the disk refuses is an InputError."""
    try:
        path.write_text(content, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{option} {str(path)!r}: {error.strerror}") from None
