"""``fopid design``: one report from a process."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from .runner import invoke


@pytest.mark.slow
def test_a_process_becomes_a_report_with_three_structures_in_three_forms(tmp_path: Path) -> None:
    out = tmp_path / "report.html"
    done = invoke(["design", "1/(s+1)*exp(-0.5s)", "--ms-max", "1.6", "--out", str(out), "--json"])
    assert done.exit_code == 0, done.stderr
    found = json.loads(done.stdout)
    assert [one["structure"] for one in found["structures"]] == ["pi", "pid", "fopid"]
    assert all(one["ms"] <= 1.6 * (1 + 1e-6) for one in found["structures"])
    costs = [one["cost"] for one in found["structures"]]
    assert costs == sorted(costs, reverse=True)
    pi = found["structures"][0]["forms"]
    assert pi["standard"]["Ti_s"] == pytest.approx(pi["parallel"]["kp"] / pi["parallel"]["ki"])
    assert pi["series"] == pi["standard"]
    assert "orders of 1" in found["structures"][2]["forms"]["series"]["reason"]
    assert out.read_text().count("<img") == 2


def test_bad_input_is_one_line(tmp_path: Path) -> None:
    for arguments in (["1/(s+1"], [str(tmp_path / "none.csv")]):
        done = invoke(["design", *arguments])
        assert done.exit_code == 2
        assert len(done.stderr.splitlines()) == 1
