"""What the page without ROS can ask for."""

from __future__ import annotations

import base64
import json
from itertools import pairwise

import numpy as np
import pytest

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import Process
from fopid_core.study.explore.desk import about_process, designs_for, fronts
from fopid_core.study.explore.learning import learn_upload
from fopid_core.study.explore.taking import take

P1 = "1/(s+1)^3"


def ms_of(process: str, gains: dict) -> float:
    """By a dense grid, not by the peak search."""
    w = np.logspace(-4, 3, 100_001)
    return float(np.abs(Loop(Process.parse(process), Fopid(**gains)).sensitivity(1j * w)).max())


def test_designs_keep_the_wishes_they_were_made_for() -> None:
    found = designs_for({"process": P1, "ms_max": 1.5, "effort": 3.0})["designs"]
    assert len(found) == 3
    for design in found:
        assert design["met"]
        assert ms_of(P1, design["gains"]) <= 1.5 * (1.0 + 1e-4)
        assert design["control_peak"] <= 3.0 * (1.0 + 1e-4)


@pytest.mark.slow
def test_more_freedom_never_costs_more() -> None:
    found = fronts({"process": P1, "effort": 5.0})["fronts"]
    for points in found.values():
        costs = [point["cost"] for point in points]
        assert all(after <= before * (1.0 + 1e-6) for before, after in pairwise(costs))
    at_16 = [next(p["cost"] for p in found[name] if p["ms_max"] == 1.6) for name in ("pi", "pid", "fopid")]
    assert all(after <= before * (1.0 + 1e-6) for before, after in pairwise(at_16))


@pytest.mark.slow
@pytest.mark.parametrize(
    "process", ["1/s", "1/(s-1)", "-2/(s+1)", "1/(s^2+1)", "s/(s+1)", "1/s^2", "3*exp(-2s)", "4/(s^2-1)"]
)
def test_every_process_can_be_begun_with(process: str) -> None:
    known = about_process({"process": process})
    json.dumps(known, allow_nan=False)
    first = known["first"]
    assert bool(first["gains"]) != bool(first["reason"])
    if first["gains"]:
        assert margins(Loop(Process.parse(process), Fopid(**first["gains"]))).ms < 2.01
    assert all(end > 0.0 for end in known["ranges"].values())


def test_a_negative_process_has_negative_gains() -> None:
    known = about_process({"process": "-2/(s+1)^3"})
    assert known["sign"] == -1.0
    assert known["first"]["gains"]["ki"] < 0.0


@pytest.mark.parametrize(
    ("fields", "named"),
    [
        ({}, "process"), ({"process": 3}, "process"), ({"process": P1}, "ms_max"),
        ({"process": P1, "ms_max": 1.0, "effort": 2.0}, "ms_max"), ({"process": P1, "ms_max": 1.5}, "effort"),
        ({"process": P1, "ms_max": 1.5, "effort": -1.0}, "effort"),
    ],
)  # fmt: skip
def test_wishes_that_cannot_be_are_named(fields: dict, named: str) -> None:
    with pytest.raises(InputError, match=named):
        designs_for(fields)


def upload(name: str, data: bytes, **more: object) -> dict:
    return learn_upload({"name": name, "content": base64.b64encode(data).decode(), **more})


@pytest.mark.parametrize(
    ("name", "data", "named"),
    [
        ("x.txt", b"", "csv"), ("x.csv", b"", "x.csv"), ("x.csv", b"\x00\xff" * 50, "x.csv"),
        ("x.mcap", b"no", "x.mcap"),
        ("../../etc/passwd", b"", "passwd"), ("x.db3", b"SQLite format 3\0", "x.db3"),
        ("x.csv", b"time,control\n1,2\n", "x.csv"),
    ],
)  # fmt: skip
def test_what_is_no_record_is_refused_by_its_name(name: str, data: bytes, named: str) -> None:
    with pytest.raises(InputError, match=named) as told:
        upload(name, data)
    assert "/tmp" not in str(told.value)


def test_content_that_is_no_base64_is_refused() -> None:
    with pytest.raises(InputError, match="base64"):
        learn_upload({"name": "x.csv", "content": "%%%"})


def test_yaml_is_what_the_export_reads(tmp_path: object) -> None:
    from fopid_core.cli.export import _from_file

    gains = {"kp": 1.5, "ki": 0.5, "kd": 0.2, "lam": 1.1, "mu": 0.9, "filter_order": 2, "filter_time": 0.1,
             "setpoint_weight": 0.7}  # fmt: skip
    path = tmp_path / "gains.yaml"
    path.write_text(take({"process": P1, "gains": gains, "kind": "yaml"})["text"])
    read = _from_file(path)
    assert [read[name] for name in ("kp", "ki", "kd", "lam", "mu")] == [1.5, 0.5, 0.2, 1.1, 0.9]
    assert (read["measurement_filter_order"], read["measurement_filter_time"], read["setpoint_weight"]) == (2, 0.1, 0.7)
