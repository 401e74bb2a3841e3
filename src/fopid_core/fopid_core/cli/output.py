"""How the command line shows results: one JSON object for programs, tables for people."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from typing import Any

import click
import numpy as np


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
            formatter.write_dl([(name, text(value)) for name, value in rows.items()])
    click.echo(formatter.getvalue(), nl=False)


def jsonable(value: Any) -> Any:
    """A value as JSON knows it.

    Examples
    --------
    >>> jsonable({"peak": float("inf"), "time": np.array([0.0, 1.0])})
    {'peak': None, 'time': [0.0, 1.0]}
    """
    if isinstance(value, Mapping):
        return {str(name): jsonable(item) for name, item in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [jsonable(item) for item in (value.tolist() if isinstance(value, np.ndarray) else value)]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


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
