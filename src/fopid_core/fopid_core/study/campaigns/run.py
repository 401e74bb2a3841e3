"""Running a campaign: its tasks on this machine's cores or on a Dask cluster, resumed where it was left.

Each task's rows are a part: a file beside the result that is written whole or not at all. What has a part is done.
"""

from __future__ import annotations

import fcntl
import multiprocessing
import os
import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from fopid_core.errors import InputError
from fopid_core.study.campaigns.campaign import Task
from fopid_core.study.campaigns.columns import SCHEMA

SUFFIXES = (".parquet", ".csv")
CONNECT_TIME = 20
"""How long a scheduler may take to answer, and to have a worker [s]."""


class Runnable(Protocol):
    """What can be run: a campaign of designs and variations, a survey of structures."""

    @property
    def runs(self) -> int:
        """Rows of the result."""

    @property
    def work(self) -> str:
        """What is run, as text: parts of a different work are not put together."""

    @property
    def schema(self) -> pa.Schema:
        """Columns of the result."""

    def tasks(self) -> Iterable[Task]:
        """The whole work in pieces, in the order of the rows."""

    def run(self, task: Task) -> pa.Table:
        """The rows of one piece."""


Work = Callable[[Task], pa.Table]
Done = Iterator[tuple[Task, pa.Table]]


@dataclass(frozen=True)
class CampaignProgress:
    """How far a campaign is.

    Attributes
    ----------
    done, total : int
        Runs.
    left : float
        Estimated time to the end [s]; NaN before the first task is done.
    """

    done: int
    total: int
    left: float


def run_campaign(
    campaign: Runnable,
    out: Path,
    workers: int = 1,
    scheduler: str | None = None,
    report: Callable[[CampaignProgress], object] | None = None,
) -> int:
    """Run what is still to be run, and put the result together.

    Parameters
    ----------
    campaign : Runnable
    out : Path
        The result, ``.parquet`` or ``.csv``; while it is being worked on, ``out.parts`` is a folder beside it, and
        ``out.campaign.yaml`` says afterwards what was run.
    workers : int
        Processes on this machine.
    scheduler : str, optional
        Address of a Dask scheduler; its workers then do the work.
    report : callable, optional
        Told the standing after every task.

    Returns
    -------
    int
        How many runs had been done before.

    Raises
    ------
    InputError
        If ``out`` is the result of another campaign or cannot be written, is being worked on by another process, or
        the scheduler does not answer.
    """
    if out.suffix not in SUFFIXES:
        raise InputError(f"out = {str(out)!r}; allowed: a name that ends in {' or '.join(SUFFIXES)}")
    try:
        if _is_finished(campaign, out):
            shutil.rmtree(_sidecar(out, "parts"), ignore_errors=True)
            return campaign.runs
        with _claimed(campaign, out) as parts:
            kept = _run_tasks(campaign, parts, partial(_on_cluster, address=scheduler) if scheduler
                              else partial(_on_this_machine, workers=workers), report or (lambda _: None))  # fmt: skip
            _assemble(campaign, parts, out)
    except OSError as error:
        raise InputError(f"out {str(out)!r}: {error.strerror or error}; allowed: a place to write") from None
    return kept


def _sidecar(out: Path, kind: str) -> Path:
    return out.with_name(f"{out.name}.{kind}")


def _is_finished(campaign: Runnable, out: Path) -> bool:
    if not out.exists():
        return False
    told = _sidecar(out, "campaign.yaml")
    if told.exists() and told.read_text(encoding="utf-8") == campaign.work:
        return True
    raise InputError(f"out {str(out)!r} exists and is not the result of this campaign; allowed: another name")


@contextmanager
def _claimed(campaign: Runnable, out: Path) -> Iterator[Path]:
    """The folder of parts, for this process alone and for this campaign alone."""
    folder = _sidecar(out, "parts")
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"out {str(out)!r} is being worked on by another process; allowed: another name") from None
        told, text = folder / "campaign.yaml", campaign.work
        if told.exists() and told.read_text(encoding="utf-8") != text:
            raise InputError(
                f"{str(folder)!r} holds parts of another campaign, or of this one before its file was changed; "
                "allowed: another --out, or delete that folder"
            )
        _write_whole(told, lambda path: path.write_text(text, encoding="utf-8"))
        yield folder


def _write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """The whole file or none, whatever happens in between."""
    unfinished = path.with_name(f"{path.name}.unfinished")
    write(unfinished)
    with unfinished.open("rb") as file:
        os.fsync(file.fileno())
    unfinished.replace(path)


def _part(folder: Path, task: Task) -> Path:
    return folder / f"{task.name}.parquet"


def _is_done(part: Path, task: Task) -> bool:
    """Whether there is a whole part; one that a failing disk left behind is made anew."""
    try:
        return part.exists() and pa.parquet.read_metadata(part).num_rows == task.runs
    except (OSError, pa.ArrowInvalid):
        return False


def _run_tasks(
    campaign: Runnable,
    folder: Path,
    executor: Callable[[Work, list[Task]], Done],
    report: Callable[[CampaignProgress], object],
) -> int:
    tasks = list(campaign.tasks())
    left = [task for task in tasks if not _is_done(_part(folder, task), task)]
    total = campaign.runs
    kept = done = total - sum(task.runs for task in left)
    report(CampaignProgress(done, total, float("nan")))
    begun = time.monotonic()
    for task, table in executor(campaign.run, left) if left else ():
        _write_whole(_part(folder, task), partial(pa.parquet.write_table, table))
        done += task.runs
        each = (time.monotonic() - begun) / (done - kept)
        report(CampaignProgress(done, total, each * (total - done)))
    return kept


def _on_this_machine(work: Work, tasks: list[Task], workers: int) -> Done:
    """In the order in which they are done."""
    if workers == 1:
        yield from ((task, work(task)) for task in tasks)
        return
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the workers are the threads
    fresh = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(workers, len(tasks)), fresh, _end_with_parent) as pool:
        waiting = {pool.submit(work, task): task for task in tasks}
        try:
            for future in as_completed(waiting):
                yield waiting.pop(future), future.result()
        except BrokenProcessPool:
            raise InputError("a worker process ended; start the same again to go on from here") from None
        finally:
            pool.shutdown(cancel_futures=True)


def _end_with_parent() -> None:
    """In a worker: end when the parent is gone, even if it was killed outright, and leave Ctrl-C to it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _on_cluster(work: Work, tasks: list[Task], address: str) -> Done:
    """On the workers of a Dask cluster; the scheduler does again what a lost worker was doing."""
    distributed: Any = import_module("distributed")  # only who asks for a cluster needs it
    try:
        client = distributed.Client(address, timeout=CONNECT_TIME)
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"scheduler = {address!r} does not answer: {reason}; allowed: host:port") from None
    with client:
        _require_workers(client, address)
        futures = client.map(work, tasks, pure=False)
        waiting = {future.key: task for future, task in zip(futures, tasks, strict=True)}
        done = distributed.as_completed(futures, with_results=True)
        del futures  # a result is let go once it has been written
        try:
            for future, table in done:
                yield waiting.pop(future.key), table
        except distributed.KilledWorker as error:
            raise InputError(f"scheduler = {address!r}: one task ended several workers: {error}") from None


def _require_workers(client: Any, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=CONNECT_TIME)
    except TimeoutError:
        raise InputError(f"scheduler = {address!r} has no workers; start some: dask worker {address}") from None


def _assemble(campaign: Runnable, folder: Path, out: Path) -> None:
    """All parts in the order of the runs, as one file; the parts are then gone."""
    parts = (pa.parquet.read_table(_part(folder, task)) for task in campaign.tasks())
    _write_whole(_sidecar(out, "campaign.yaml"), lambda path: path.write_text(campaign.work, encoding="utf-8"))
    _write_whole(out, lambda path: _write_tables(parts, campaign.schema, path, out.suffix))
    shutil.rmtree(folder)


def _write_tables(tables: Iterable[pa.Table], schema: pa.Schema, path: Path, suffix: str) -> None:
    writer = pa.parquet.ParquetWriter if suffix == ".parquet" else pa.csv.CSVWriter
    with writer(path, schema) as file:
        for table in tables:
            file.write_table(table)


def read_results(path: Path, schema: pa.Schema = SCHEMA) -> pa.Table:
    """The result of a campaign, or what there is of one that is not finished: of its folder of parts.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    parts = _sidecar(path, "parts")
    try:
        if not path.exists() and parts.is_dir():
            done = sorted(parts.glob("*.parquet"))
            return pa.concat_tables([schema.empty_table(), *(pa.parquet.read_table(part) for part in done)])
        if path.suffix == ".parquet":
            return pa.parquet.read_table(path)
        types = pa.csv.ConvertOptions(column_types=dict(zip(schema.names, schema.types, strict=True)),
                                      strings_can_be_null=True, quoted_strings_can_be_null=False)  # fmt: skip
        return pa.csv.read_csv(path, convert_options=types)
    except (OSError, pa.ArrowInvalid) as error:
        raise InputError(f"results {str(path)!r} cannot be read: {' '.join(str(error).split())}") from None
