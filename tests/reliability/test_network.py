"""Controller and plant on two hosts, joined by a cable that is bad, or cut."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from fopid_ros.experiment.child_processes import ros_arguments

from ..share import SHARE
from .cable import Impairment
from .record import Record, outside_limits
from .rig import FLOAT, GAINS, LIMITS, OBSERVED, PROCESS, SIGNAL_TYPES, STATE

HERE, BIN = Path(__file__).parent, Path(sys.executable).parent
CONDITIONS = {
    "nothing": Impairment(),
    "20 ms late": Impairment(delay=0.02),
    "50 ms late, +-30 ms": Impairment(delay=0.05, jitter=0.03),
    "10 % lost": Impairment(loss=0.1),
    "10 % doubled": Impairment(duplicate=0.1),
    "20 ms late, 25 % overtake": Impairment(delay=0.02, reorder=0.25),
    "all of it": Impairment(delay=0.05, jitter=0.03, loss=0.1, duplicate=0.1, reorder=0.1),
}
CUTS = (0.1, 0.3, 1.0, 3.0, 10.0)
LENGTH = max(4.0, 30.0 * SHARE)
"""Of each condition [s]."""
CUT_REPEATS = max(1, round(5 * SHARE))
CALM = 0.3
"""The control is back when it has not been held for so long [s]."""
LONGEST_BACK = 3.0
"""So long after a cut the control must be back [s]."""


class TwoHosts:
    """The controller, with an observer, on one; the plant on the other."""

    def __init__(self, folder: Path) -> None:
        self.hosts = [f"fopid{os.getpid()}{side}" for side in "ab"]
        self._processes: list[subprocess.Popen[bytes]] = []
        self.record = Record(folder / "record")
        self._environment = {
            **os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_DOMAIN_ID": "0",
            "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",  # the hosts are one machine, whose memory they must not share
        }  # fmt: skip
        for host in self.hosts:
            made = subprocess.run(["ip", "netns", "add", host], capture_output=True, text=True, check=False)
            if made.returncode:
                pytest.skip(f"network namespaces are not permitted here: {made.stderr.strip()}")
        self._cable = subprocess.Popen(
            [sys.executable, str(HERE / "cable.py"), *self.hosts], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        self._log = (folder / "log").open("wb")
        self.impair(Impairment())

    def impair(self, impairment: Impairment) -> float:
        """Put an impairment in force; when it was [s]."""
        try:
            self._cable.stdin.write(json.dumps(asdict(impairment)) + "\n")
            self._cable.stdin.flush()
            return float(self._cable.stdout.readline())
        except (OSError, ValueError):
            pytest.skip(f"no cable between namespaces here: {self._cable.stderr.read().strip().splitlines()[-1]}")

    def start(self, host: int, *arguments: str) -> None:
        enter = ["ip", "netns", "exec", self.hosts[host]]
        self._processes.append(
            subprocess.Popen([*enter, *arguments], env=self._environment, stdout=self._log, stderr=self._log)
        )

    def node(self, host: int, name: str, parameters: Mapping[str, Any]) -> None:
        self.start(host, str(BIN / name), *ros_arguments(parameters))

    def close(self) -> None:
        for process in self._processes:
            process.send_signal(signal.SIGTERM)
        for process in self._processes:
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
        self._cable.kill()
        self._cable.wait()
        for host in self.hosts:
            subprocess.run(["ip", "netns", "delete", host], check=False)


@pytest.fixture
def two_hosts(tmp_path: Path) -> Iterator[TwoHosts]:
    made = TwoHosts(tmp_path)
    try:
        yield made
    finally:
        made.close()


def back_at(states: list[tuple[Any, ...]], after: float) -> float | None:
    """From when on the control has not been held for ``CALM``, by states (time, addend, stale, age)."""
    since = None
    for now, _, stale, _ in states:
        if now < after:
            continue
        since = (now if since is None else since) if not stale else None
        if since is not None and now - since >= CALM:
            return since
    return None


def row(record: Record, began: float, ended: float, back: float) -> dict[str, Any]:
    """What the loop did from ``began`` to ``back``."""
    states = [state for state in record.of(STATE, began) if state[0] <= back]
    held = [stale for _, _, stale, _ in states]
    controls = [(line[0], line[1]) for line in record.of("control", began)]
    assert controls
    assert not outside_limits(controls, *LIMITS)
    values = [value for _, value in controls]
    return {
        "holds": sum(now and not before for before, now in pairwise([False, *held])),
        "held": sum(held) / len(held),
        "oldest": max(age for *_, age in states),
        "back": back - ended,
        "lowest": min(values),
        "highest": max(values),
    }


def test_a_bad_cable_holds_the_control_and_it_comes_back(two_hosts: TwoHosts, figures: Callable[..., None]) -> None:
    hosts, record = two_hosts, two_hosts.record
    hosts.start(0, sys.executable, str(HERE / "observer.py"), str(record.file), *OBSERVED)
    hosts.node(1, "plant_simulator", {"process": PROCESS, "noise_std": 0.01, **SIGNAL_TYPES})
    limits = {"control_min": LIMITS[0], "control_max": LIMITS[1]}
    setpoint = {"setpoint.type": FLOAT, "setpoint.field": "data"}
    hosts.node(0, "fopid_controller", {**GAINS, **SIGNAL_TYPES, **limits, **setpoint})
    hosts.start(0, sys.executable, str(HERE / "setpoint_steps.py"), "0.8", "1.2", "2.0")

    def wait_until_back(after: float, patience: float) -> float:
        deadline = time.monotonic() + patience
        while (back := back_at(record.update().of(STATE, after), after)) is None:
            assert time.monotonic() < deadline, f"back within {patience} s"
            time.sleep(0.05)
        return back

    wait_until_back(time.monotonic(), 60.0)
    rows = {}
    for name, impairment in CONDITIONS.items():
        began = hosts.impair(impairment)
        time.sleep(LENGTH)
        ended = hosts.impair(Impairment())
        rows[name] = row(record, began, ended, wait_until_back(ended, LONGEST_BACK))
    for seconds in CUTS:
        seen = []
        for _ in range(CUT_REPEATS):
            began = hosts.impair(Impairment(cut=True))
            time.sleep(seconds)
            ended = hosts.impair(Impairment())
            back = wait_until_back(ended, LONGEST_BACK)
            seen.append(row(record, began, ended, back))
            time.sleep(1.0)
        worst = {key: max(one[key] for one in seen) for key in seen[0]}
        rows[f"cut for {seconds:g} s, {CUT_REPEATS} times"] = {**worst, "lowest": min(one["lowest"] for one in seen)}
        assert worst["holds"] or seconds < 0.2
    figures("network", seconds=LENGTH, rows=rows)
