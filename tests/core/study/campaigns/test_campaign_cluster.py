"""A campaign on a Dask cluster: scheduler and workers in processes of their own, one of which is killed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from fopid_core.errors import InputError
from fopid_core.study.campaigns.campaign import Campaign, Design, Range, Variations
from fopid_core.study.campaigns.run import read_results, run_campaign

FOPID = str(Path(sys.executable).with_name("fopid"))
PATIENCE = 60.0
CAMPAIGN = Campaign(
    "cluster",
    ("P1",),
    (Design("known", gains={"kp": 3.0, "ki": 0.8, "kd": 1.3, "mu": 0.6}),),
    Variations(delay=Range(0.0, 0.5), samples=4_999),
    horizon=40.0,
)


def until(ready: Callable[[], object], what: str) -> None:
    deadline = time.monotonic() + PATIENCE
    while not ready():
        assert time.monotonic() < deadline, f"{what} within {PATIENCE:g} s"
        time.sleep(0.02)


class Cluster:
    """A scheduler and workers, each a process."""

    def __init__(self, folder: Path, workers: int = 2) -> None:
        self._folder = folder
        self.file = folder / "scheduler.json"
        self._processes = [
            self._start(
                "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(self.file)
            )
        ]
        until(lambda: self.file.exists() and self.file.read_text(), "the scheduler")
        self.address = json.loads(self.file.read_text())["address"]
        self.workers = [
            self._start("worker", self.address, "--nthreads", "1", "--no-nanny", "--no-dashboard")
            for _ in range(workers)
        ]
        self._processes += self.workers

    def _start(self, what: str, *arguments: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.dask_{what}", *arguments]
        return subprocess.Popen(command, cwd=self._folder, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                                stderr=subprocess.DEVNULL, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"})  # fmt: skip

    def busy(self) -> int:
        """How many workers the scheduler knows."""
        from distributed import Client

        with Client(self.address) as client:
            return len(client.scheduler_info(n_workers=-1)["workers"])

    def close(self) -> None:
        for process in self._processes:
            process.kill()
            process.wait()


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    started = Cluster(tmp_path)
    try:
        until(lambda: started.busy() == 2, "both workers")
        yield started
    finally:
        started.close()


@pytest.mark.long
def test_a_worker_killed_in_the_middle_loses_no_run_and_none_counts_twice(tmp_path: Path, cluster: Cluster) -> None:
    file, out = tmp_path / "c.yaml", tmp_path / "cluster.parquet"
    file.write_text(CAMPAIGN.to_yaml())
    command = [FOPID, "campaign", str(file), "--scheduler", cluster.address, "--out", str(out), "--json"]
    with (tmp_path / "log").open("w") as log:
        campaign = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True)
        parts = out.with_name("cluster.parquet.parts")
        until(lambda: len(list(parts.glob("*.parquet"))) >= 2, "two parts")
        done = len(list(parts.glob("*.parquet")))
        cluster.workers[0].kill()
        assert done < 10, "the kill came too late to be in the middle"
        text, _ = campaign.communicate(timeout=PATIENCE)
    assert campaign.returncode == 0, (tmp_path / "log").read_text()
    assert json.loads(text)["status"] == {"ok": 5_000}
    results = read_results(out)
    assert results["run"].to_pylist() == list(range(5_000))
    run_campaign(CAMPAIGN, tmp_path / "here.parquet")
    assert results.equals(read_results(tmp_path / "here.parquet"))


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fopid_core.study.campaigns.run.CONNECT_TIME", 1)
    with pytest.raises(InputError, match=r"scheduler = 'tcp://127\.0\.0\.1:9' does not answer"):
        run_campaign(CAMPAIGN, tmp_path / "r.parquet", scheduler="tcp://127.0.0.1:9")


@pytest.mark.slow
def test_a_scheduler_without_workers_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    alone = Cluster(tmp_path, workers=0)
    try:
        monkeypatch.setattr("fopid_core.study.campaigns.run.CONNECT_TIME", 2)
        with pytest.raises(InputError, match="has no workers; start some: dask worker tcp://"):
            run_campaign(CAMPAIGN, tmp_path / "r.parquet", scheduler=alone.address)
    finally:
        alone.close()
