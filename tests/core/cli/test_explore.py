"""``fopid explore``: what it begins with, and how it refuses."""

from __future__ import annotations

import http.client
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fopid_core.cli.explore import TOKEN_VARIABLE
from fopid_core.model.process import read_process

FOPID = Path(sys.executable).with_name("fopid")
TOKEN = "sixteen-letters!"


@pytest.mark.slow
def test_a_record_is_learnt_before_the_page_is_served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    time = np.arange(0.0, 40.0, 0.05)
    table = np.column_stack([time, time > 0.0, 2.0 * -np.expm1(-np.maximum(time - 1.0, 0.0) / 3.0)])
    np.savetxt(tmp_path / "record.csv", table, delimiter=",", header="time,control,measurement", comments="")
    monkeypatch.setenv(TOKEN_VARIABLE, TOKEN)
    command = [FOPID, "explore", "record.csv", "--port", "0", "--no-browser"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        line = server.stdout.readline()
        assert TOKEN not in line
        connection = http.client.HTTPConnection("127.0.0.1", int(re.search(r":(\d+)/", line)[1]), timeout=30)
        connection.request("POST", "/api/start", "{}", {"Authorization": f"Bearer {TOKEN}"})
        start = json.loads(connection.getresponse().read())
        connection.close()
        server.terminate()
        assert server.wait(20) == 0
    assert start["learnt"]["success"]
    assert start["learnt"]["best"]["fit_pct"] > 99.0
    assert read_process(start["process"]).steady_state_gain == pytest.approx(2.0, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["1/(s+"], "character 6"), (["missing.csv"], "record 'missing.csv'"), (["--port", "99999"], "port = 99999"),
        (["."], "bag"),
    ],
)  # fmt: skip
def test_what_cannot_be_begun_with_is_one_line(tmp_path: Path, words: list[str], named: str) -> None:
    done = subprocess.run([FOPID, "explore", *words, "--no-browser"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 2
    assert named in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_token_that_can_be_guessed_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    from click.testing import CliRunner

    from fopid_core.cli.explore import explore_verb

    monkeypatch.setenv(TOKEN_VARIABLE, "short")
    told = CliRunner().invoke(explore_verb, ["--no-browser"])
    assert f"{TOKEN_VARIABLE} has 5 characters" in str(told.exception)
