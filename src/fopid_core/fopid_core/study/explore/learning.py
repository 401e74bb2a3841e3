"""The process from a record, as the page shows it: models, fit, what was measured beside what the best model says."""

from __future__ import annotations

import base64
import binascii
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fopid_core.design.identification.identified_model import IdentifiedModel
from fopid_core.design.identification.identify import identify
from fopid_core.design.identification.record import Record
from fopid_core.design.response_verification import doubt_of
from fopid_core.errors import InputError
from fopid_core.study.page.prediction import digits
from fopid_core.study.records import read_record

SUFFIXES = (".csv", ".mcap", ".db3")
POINTS = 800
"""Instants of the picture, at most."""


def learnt(record: Record, name: str) -> dict[str, Any]:
    """What a record says of its process, as JSON knows it.

    Parameters
    ----------
    record : Record
    name : str
        For people.

    Returns
    -------
    dict
        ``name, success, message, best`` {template, process, fit_pct} or null, ``models`` and ``picture`` {time,
        measurement, model}.
    """
    found = identify(record)
    best = found.best
    picture, message = None, found.message
    if best is not None:
        message = "; ".join(told for told in (message, doubt_of(found.behind_actuator(record), best)) if told)
        time, measured, simulated = best.simulated
        thin = slice(None, None, max(1, -(-time.size // POINTS)))
        even = np.linspace(time[0], time[-1], time[thin].size)
        picture = {"time": digits(even), "measurement": digits(np.interp(even, time, measured)),
                   "model": digits(np.interp(even, time, simulated))}  # fmt: skip
    return {
        "name": name, "success": found.success, "message": message,
        "best": None if best is None else _told(best), "models": [_told(model) for model in found.models],
        "picture": picture,
    }  # fmt: skip


def _told(model: IdentifiedModel) -> dict[str, Any]:
    rounded = {name: float(f"{value:.4g}") for name, value in model.parameters.items()}
    return {"template": model.template, "process": str(model.process), "fit_pct": model.fit_pct,
            "shown": str(model.structure.process_of(rounded))}  # fmt: skip


def learn_upload(fields: Mapping[str, Any]) -> dict[str, Any]:
    """The same from a file that a page sends: ``name``, ``content`` in base64, and ``columns`` of a csv file.

    Raises
    ------
    InputError
        For what is no record; the file is gone when this returns.
    """
    name, content, columns = (fields.get(key) for key in ("name", "content", "columns"))
    if not isinstance(name, str) or not isinstance(content, str):
        raise InputError("a record; allowed: name and content, both text")
    suffix = Path(name).suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"record {name[-60:]!r}; allowed: a file that ends in {', '.join(SUFFIXES)}")
    if columns is not None and not isinstance(columns, str):
        raise InputError("columns; allowed: a text such as PV,OP,SP,TIME")
    try:
        data = base64.b64decode(content, validate=True)
    except (binascii.Error, ValueError):
        raise InputError(f"record {name[-60:]!r}; allowed: its content in base64") from None
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"record{suffix}")
        path.write_bytes(data)
        try:
            record = read_record(path, columns=columns)
        except InputError as error:
            raise InputError(str(error).replace(str(path), Path(name).name[-60:])) from None
    return learnt(record, Path(name).name[-60:])
