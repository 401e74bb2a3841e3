"""Who records an experiment: this package, `ros2 bag record` where rosbags is not installed, or nobody."""

from __future__ import annotations

import math
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Protocol

import yaml
from rclpy.node import Node
from rclpy.qos import QoSProfile

from fopid_core.errors import InputError
from fopid_ros.experiment.child_processes import die_with_parent

BAG_PACKAGES = frozenset({"apsw", "backports", "lz4", "mcap", "rosbags", "zstandard"})
"""What the extra ``bags`` brings."""

RECORDER_NODE = "rosbag2_recorder"
"""The node of ``ros2 bag record``."""

QUEUE = 10_000  # messages that may wait for who records, on each topic
LISTEN_TIME = 10.0  # how long `ros2 bag record` may take to hear all topics [s]
STOP_TIME = 5.0  # how long it may take to end [s]; less than this process itself is given


class Recording(Protocol):
    """What an experiment asks of who records it."""

    failure: str | None
    """Why the recording ended early, or never began."""

    def reached(self, topics: Iterable[str]) -> float:
        """Log time up to which all of these topics are recorded [ns]; infinite where that is not known."""

    def listening(self) -> bool:
        """Whether all topics that somebody publishes are heard, or need not be waited for."""

    def close(self) -> None:
        """Finish the bag."""


def start_recording(
    node: Node,
    folder: Path,
    topics: Mapping[str, type],
    *,
    qos: Mapping[str, QoSProfile],
    metadata: Mapping[str, str],
    tell: Callable[[str], None],
) -> Recording:
    """Record topics into a bag, with what is installed.

    Parameters
    ----------
    node : Node
    folder : Path
        The bag; it must not exist yet.
    topics : mapping
        Topic name -> message class.
    qos : mapping
        Topic name -> profile to subscribe with, where it is not the recorder's own.
    metadata : mapping
        Texts kept in the bag, where this package writes it.
    tell : callable
        Takes one line: what is not as usual.

    Raises
    ------
    InputError
        If the folder exists or cannot be made.
    """
    try:
        from fopid_ros.experiment.recorder import Recorder
    except ModuleNotFoundError as error:
        absent = (error.name or "").partition(".")[0]
        if absent not in BAG_PACKAGES:
            raise
    else:
        return Recorder(
            node, folder, topics, qos=qos, metadata=metadata, on_failure=lambda text: tell(f"warning: {text}")
        )
    program = shutil.which("ros2")
    if program is None:
        nothing = Nothing(
            f"nothing is recorded, because neither the Python package {absent} nor `ros2 bag record` is installed; "
            "pip install rosbags mcap zstandard gives a recording and the report"
        )
        tell(f"warning: {nothing.failure}")
        return nothing
    tell(
        f"recording with `ros2 bag record`, because the Python package {absent} is not installed; "
        "pip install rosbags mcap zstandard gives the report as well"
    )
    return BagProcess(program, node, folder, {topic: qos.get(topic, QoSProfile(depth=QUEUE)) for topic in topics}, tell)


class Nothing:
    """No recording."""

    def __init__(self, failure: str) -> None:
        self.failure: str | None = failure

    def reached(self, topics: Iterable[str]) -> float:
        """Infinite: nobody waits for it."""
        return math.inf

    def listening(self) -> bool:
        """Nobody waits for it."""
        return True

    def close(self) -> None:
        """Nothing to finish."""


class BagProcess:
    """``ros2 bag record`` as a child process, until ``close``; its output goes to ``recording.log`` beside the bag.

    Messages are logged at the clock of the machine, in lockstep too: with ``--use-sim-time`` rosbag2 subscribes to
    nothing before ``/clock`` is above zero, and the beginning of the loop would be lost. A reader of the bag goes by
    the messages' own stamps.
    """

    def __init__(
        self, program: str, node: Node, folder: Path, topics: Mapping[str, QoSProfile], tell: Callable[[str], None]
    ) -> None:
        if folder.exists():
            raise InputError(f"bag {str(folder)!r} exists already; allowed: a name that is free")
        self.failure: str | None = None
        self._node = node
        self._tell = tell
        self._closed = False
        self._patience: float | None = None
        self._log = folder.with_name("recording.log")
        self._topics = {node.resolve_topic_name(topic): profile for topic, profile in topics.items()}
        # rosbag2's own queue of ten is too short for lockstep.
        overrides = folder.with_name("recording_qos.yaml")
        overrides.write_text(yaml.safe_dump({name: _override(p) for name, p in self._topics.items()}), encoding="utf-8")
        command = [program, "bag", "record", "-s", "mcap", "-o", str(folder),
                   "--qos-profile-overrides-path", str(overrides), "--topics", *self._topics]  # fmt: skip
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT,
                start_new_session=True, preexec_fn=die_with_parent,
            )  # fmt: skip

    def reached(self, topics: Iterable[str]) -> float:
        """Infinite: it does not say."""
        return math.inf

    def listening(self) -> bool:
        """Whether it hears all topics that somebody publishes, has ended, or took longer than ``LISTEN_TIME``."""
        if self._closed or self._process.poll() is not None:
            return True
        unheard = [name for name in self._topics if self._node.count_publishers(name) and not self._hears(name)]
        self._patience = self._patience or time.monotonic() + LISTEN_TIME
        if unheard and time.monotonic() > self._patience:
            self._tell(f"warning: `ros2 bag record` does not hear {', '.join(unheard)} after {LISTEN_TIME:g} s")
            return True
        return not unheard

    def _hears(self, topic: str) -> bool:
        return any(each.node_name == RECORDER_NODE for each in self._node.get_subscriptions_info_by_topic(topic))

    def close(self) -> None:
        """Have it finish the bag, and wait until it has; a second call does nothing."""
        if self._closed:
            return
        self._closed = True
        early = self._process.poll()
        if early is None:
            self._process.send_signal(signal.SIGINT)
            try:
                code = self._process.wait(STOP_TIME)
                if code not in (0, -signal.SIGINT, 128 + signal.SIGINT):
                    self._fail(f"`ros2 bag record` ended with code {code}")
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
                self._fail(f"`ros2 bag record` did not end within {STOP_TIME:g} s and was killed")
        else:
            self._fail(f"`ros2 bag record` ended with code {early} before the experiment did")

    def _fail(self, reason: str) -> None:
        self.failure = f"{reason}; see {str(self._log)!r}"
        self._tell(f"warning: {self.failure}")


def _override(profile: QoSProfile) -> dict[str, object]:
    """A profile as ``--qos-profile-overrides-path`` reads it."""
    return {
        "history": "keep_last",
        "depth": profile.depth,
        "reliability": profile.reliability.name.lower(),
        "durability": profile.durability.name.lower(),
    }
