"""The verb ``fopid replay`` on the command line."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from ..study.days import write_day
from .runner import invoke


@pytest.mark.slow
def test_it_tells_before_and_after_and_writes_every_signal(tmp_path: Path) -> None:
    write_day(tmp_path / "day.csv")
    out, plot = tmp_path / "out.csv", tmp_path / "day.png"
    line = ["replay", str(tmp_path / "day.csv"), "--gains", "0.8,0.7,0,1,1", "--out", str(out), "--plot", str(plot)]
    done = invoke([*line, "--json"])
    assert done.exit_code == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["after"]["iae"] < told["before"]["iae"]
    assert told["after_low"]["iae"] <= told["after"]["iae"] <= told["after_high"]["iae"]
    with out.open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 400
    assert all(float(r["measurement_low"]) <= float(r["replayed_measurement"]) for r in rows)
    assert plot.stat().st_size > 1000
    refused = invoke(["replay", str(tmp_path / "day.csv"), "--gains", "9,9,0,1,1", "--json"])
    assert refused.exit_code == 3
    assert json.loads(refused.stdout)["after"] is None


@pytest.mark.long
def test_limits_bound_the_gains_that_it_tunes_itself(tmp_path: Path) -> None:
    write_day(tmp_path / "day.csv")
    line = ["replay", str(tmp_path / "day.csv"), "--out", str(tmp_path / "out.csv"), "--json"]
    done = invoke([*line, "--control-min", "-1.5", "--control-max", "2.5"])
    assert done.exit_code == 0, done.stdout
    assert "limits leave a control peak" in json.loads(done.stdout)["message"]
    with (tmp_path / "out.csv").open() as file:
        controls = [float(row["replayed_control"]) for row in csv.DictReader(file)]
    assert -1.5 <= min(controls) <= max(controls) <= 2.5


@pytest.mark.parametrize(
    ("more", "told"),
    [
        (["--gains", "1,2"], "gains '1,2'; allowed: five numbers"),
        (["--filter", "2,0.1"], "filter without gains; allowed: with --gains"),
        (["--gains", "1,1,0,1,1", "--control-min", "2", "--control-max", "1"], "allowed: min < max"),
    ],
)
def test_bad_input_is_one_line(tmp_path: Path, more: list[str], told: str) -> None:
    write_day(tmp_path / "day.csv")
    done = invoke(["replay", str(tmp_path / "day.csv"), *more])
    assert done.exit_code == 2
    assert told in done.stderr
    assert done.stderr.count("\n") == 1
