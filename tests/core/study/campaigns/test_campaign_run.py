"""A campaign's results: the same however they came about, whole after a kill, and with a row for what went wrong."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

import fopid_core.study.campaigns.task as campaign_task
from fopid_core.design.tuner import TuningRequest, tune
from fopid_core.errors import InputError
from fopid_core.model.evaluation import evaluate
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import read_process
from fopid_core.study.campaigns.campaign import Campaign, Design, Range, Variations
from fopid_core.study.campaigns.columns import SCHEMA
from fopid_core.study.campaigns.run import CampaignProgress, read_results, run_campaign
from fopid_core.study.campaigns.varied_loops import varied

from ...cli.runner import invoke

FOPID = str(Path(sys.executable).with_name("fopid"))
SMALL = Campaign(
    "small",
    ("P1", "P4"),
    (
        Design("known", gains={"kp": 3.0, "ki": 0.8, "kd": 1.3, "mu": 0.6}),
        Design("tuned", method="frequency", phase_margin_deg=(50.0, 70.0), crossover=0.3),
    ),
    Variations(gain=(0.5, 1.5), delay=Range(0.0, 1.0), samples=4, seed=5),
    horizon=40.0,
    figure=("ms", "itae"),
)


def rows(table: pa.Table) -> list[dict]:
    return table.to_pylist()


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> pa.Table:
    out = tmp_path_factory.mktemp("small") / "small.parquet"
    assert run_campaign(SMALL, out) == 0
    return read_results(out)


@pytest.mark.slow
def test_every_run_is_a_row_with_what_went_in_and_what_came_out(results: pa.Table) -> None:
    assert results.schema.names == SCHEMA.names
    assert results["run"].to_pylist() == list(range(SMALL.runs)) == list(range(2 * 3 * 9))
    table = SMALL.variations.table()
    for row in rows(results):
        assert [row["gain"], row["time_scale"], row["delay"]] == table[row["variation"]].tolist()
        assert (row["asked_crossover"], row["method"]) == (
            (0.3, "frequency") if row["design"] == "tuned" else (None, None)
        )
    for row in rows(results)[::7]:
        loop = Loop(
            varied(read_process(row["process"]), row["gain"], row["time_scale"], row["delay"]),
            Fopid(*(row[name] for name in ("kp", "ki", "kd", "lam", "mu"))),
        )
        exact = evaluate(loop, 40.0)
        assert row["stable"] == exact.stability.stable == (row["status"] == "ok")
        if exact.step:
            assert row["ms"] == pytest.approx(exact.margins.ms, rel=5e-3)
            assert row["itae"] == pytest.approx(exact.step.indices.itae, rel=5e-3)
            assert row["reason"] is None
        else:
            assert row["ms"] is None
            assert row["reason"] == "the closed loop is not stable"
    assert {row["status"] for row in rows(results)} == {"ok", "unstable"}


def test_a_design_is_the_tuners_for_the_process_as_it_is(results: pa.Table) -> None:
    request = TuningRequest(read_process("P1"), phase_margin=math.radians(70.0), crossover=0.3)
    expected = tune(request).controller
    assert expected is not None
    found = [r for r in rows(results) if r["process"] == "P1" and r["asked_phase_margin_deg"] == 70.0]
    assert len(found) == 9
    assert {tuple(r[name] for name in ("kp", "ki", "kd", "lam", "mu")) for r in found} == {expected.gains}
    assert all(r["met"] for r in found)


@pytest.mark.slow
@pytest.mark.parametrize(("suffix", "workers"), [(".csv", 1), (".parquet", 2)])
def test_workers_and_kind_of_file_do_not_change_the_numbers(
    results: pa.Table, tmp_path: Path, suffix: str, workers: int
) -> None:
    out = tmp_path / f"again{suffix}"
    run_campaign(SMALL, out, workers)
    assert read_results(out).equals(results)
    assert not out.with_name(f"{out.name}.parts").exists()


def test_what_cannot_be_done_is_a_row_that_says_why(tmp_path: Path) -> None:
    designs = (
        Design("no rule", method="rule", rule="simc-pi"),  # an integrating process has no such model
        Design("fine", gains={"kp": 1.0, "ki": 0.1, "kd": 0.5}),
        Design("cannot be met", method="time", ms_max=1.0001, u_max=1e-6, index="iae"),
    )
    out = tmp_path / "r.parquet"
    run_campaign(Campaign("c", ("1/(s(s+1))",), designs, Variations(gain=(0.5, 2.0)), horizon=30.0), out)
    found = rows(read_results(out))
    assert [(row["design"], row["status"]) for row in found[:6]] == [("no rule", "failed")] * 3 + [("fine", "ok")] * 3
    assert all(row["reason"].startswith("tuning: ") for row in found[:3])
    assert all(row["met"] is False for row in found[6:])


def test_a_run_that_fails_does_not_take_its_neighbours_along(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = campaign_task.measure

    def brittle(process, controller, variations, horizon, sample_time):
        if (variations[:, 0] == 1.5).any():
            raise FloatingPointError("too much")
        return real(process, controller, variations, horizon, sample_time)

    monkeypatch.setattr(campaign_task, "measure", brittle)
    out = tmp_path / "r.parquet"
    run_campaign(SMALL, out)
    for row in rows(read_results(out)):
        assert (row["status"] == "failed") == (row["gain"] == 1.5) == (row["reason"] == "too much")


def test_a_second_start_goes_on_where_the_first_was_left(
    results: pa.Table, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fopid_core.study.campaigns.campaign.TUNINGS_AT_ONCE", 1)
    out = tmp_path / "r.parquet"

    class StopError(Exception):
        pass

    def stop(standing: CampaignProgress) -> None:
        if standing.done >= 18:
            raise StopError

    with pytest.raises(StopError):
        run_campaign(SMALL, out, report=stop)
    parts = out.with_name("r.parquet.parts")
    (parts / "0000002-0000002-00000000-00000009.parquet.unfinished").write_bytes(b"half of a part")
    last = max(parts.glob("*.parquet"))
    last.write_bytes(last.read_bytes()[:-100])
    assert not out.exists()
    standings: list[CampaignProgress] = []
    assert run_campaign(SMALL, out, report=standings.append) == 9
    assert [standing.done for standing in standings] == [9, 18, 27, 36, 45, 54]
    assert standings[-1].left == 0.0
    assert read_results(out).equals(results)


def test_what_is_finished_is_not_done_again_and_never_overwritten(results: pa.Table, tmp_path: Path) -> None:
    out = tmp_path / "r.parquet"
    run_campaign(SMALL, out)
    before = out.stat().st_mtime_ns
    assert run_campaign(replace(SMALL, figure=("mt",)), out) == SMALL.runs  # another figure is no other campaign
    assert out.stat().st_mtime_ns == before
    other = Campaign("other", ("P1",), SMALL.designs)
    with pytest.raises(InputError, match="not the result of this campaign"):
        run_campaign(other, out)


def test_parts_of_another_campaign_are_refused(tmp_path: Path) -> None:
    out = tmp_path / "r.parquet"
    parts = out.with_name("r.parquet.parts")
    parts.mkdir()
    (parts / "campaign.yaml").write_text("name: other\n")
    with pytest.raises(InputError, match="parts of another campaign"):
        run_campaign(SMALL, out)
    assert (parts / "campaign.yaml").read_text() == "name: other\n"


def test_two_at_once_on_one_result_are_refused(tmp_path: Path) -> None:
    out = tmp_path / "r.parquet"

    def second(standing: CampaignProgress) -> None:
        with pytest.raises(InputError, match="being worked on by another process"):
            run_campaign(SMALL, out)

    run_campaign(SMALL, out, report=second)


@pytest.mark.parametrize(
    ("out", "named"), [("r.xlsx", ".parquet or .csv"), ("/proc/nowhere/r.csv", "a place to write")]
)
def test_results_that_cannot_be_written_are_named(tmp_path: Path, out: str, named: str) -> None:
    with pytest.raises(InputError, match=named):
        run_campaign(SMALL, tmp_path / out)


def test_the_verb_prints_one_json_object_and_draws_what_is_asked(results: pa.Table, tmp_path: Path) -> None:
    file, out = tmp_path / "c.yaml", tmp_path / "c.csv"
    file.write_text(SMALL.to_yaml())
    ended = invoke(["campaign", str(file), "--out", str(out), "--workers", "1", "--json"])
    assert ended.exit_code == 0, ended.output
    data = json.loads(ended.stdout)
    assert data["runs"] == SMALL.runs == sum(data["status"].values())
    assert "54 of 54 runs" in ended.stderr
    assert Path(data["figure"]).read_bytes().startswith(b"\x89PNG")
    summary = pa.csv.read_csv(data["summary"]).to_pylist()
    assert [(row["process"], row["design"]) for row in summary] == [
        ("P1", "known"), ("P1", "tuned"), ("P4", "known"), ("P4", "tuned")]  # fmt: skip
    known = [r for r in rows(results) if r["process"] == "P1" and r["design"] == "known"]
    assert summary[0]["stable"] == sum(r["stable"] for r in known) / 9
    assert summary[0]["ms_50"] == pytest.approx(np.median([r["ms"] for r in known if r["stable"]]))


@pytest.mark.parametrize(
    ("more", "named"),
    [(["--workers", "0"], "workers = 0"), (["--workers", "2", "--scheduler", "tcp://127.0.0.1:1"], "one of the two")],
)
def test_the_verb_names_what_it_cannot_use(tmp_path: Path, more: list[str], named: str) -> None:
    file = tmp_path / "c.yaml"
    file.write_text(SMALL.to_yaml())
    ended = invoke(["campaign", str(file), *more])
    assert ended.exit_code == 2
    assert named in ended.stderr


def test_distributed_is_imported_for_a_cluster_only() -> None:
    code = "import sys, fopid_core.study.campaigns.run as c; sys.exit('distributed' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.long
def test_a_killed_campaign_goes_on_and_its_result_is_that_of_an_undisturbed_one(tmp_path: Path) -> None:
    campaign = Campaign(
        "big", ("P1",), (SMALL.designs[0],), Variations(delay=Range(0.0, 0.5), samples=2_499), horizon=40.0
    )
    file = tmp_path / "c.yaml"
    file.write_text(campaign.to_yaml())
    command = [FOPID, "campaign", str(file), "--workers", "2", "--out", str(tmp_path / "killed.parquet")]
    first = subprocess.Popen(command, stderr=subprocess.DEVNULL, start_new_session=True)
    parts = tmp_path / "killed.parquet.parts"
    while len(list(parts.glob("*.parquet"))) < 2:
        assert first.poll() is None
        time.sleep(0.02)
    first.send_signal(signal.SIGKILL)
    first.wait()
    kept = len(list(parts.glob("*.parquet")))
    assert 2 <= kept < 5
    wait_for_the_end_of_group(first.pid)
    ended = subprocess.run([*command, "--json"], capture_output=True, text=True, check=True)
    assert json.loads(ended.stdout)["done_before"] == 500 * kept
    run_campaign(campaign, tmp_path / "undisturbed.parquet", workers=2)
    assert read_results(tmp_path / "killed.parquet").equals(read_results(tmp_path / "undisturbed.parquet"))


def wait_for_the_end_of_group(group: int) -> None:
    """Workers end by themselves when their parent was killed."""
    deadline = time.monotonic() + 30.0
    while True:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return
        assert time.monotonic() < deadline, "workers outlive their parent"
        time.sleep(0.05)
