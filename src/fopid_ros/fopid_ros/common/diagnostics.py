"""What the controller node tells of its health once a second on /diagnostics."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node


@dataclass
class TickCounts:
    """What has happened since the node was configured."""

    ticks: int = 0
    late_ticks: int = 0
    stale_ticks: int = 0
    saturated_ticks: int = 0
    refused_values: int = 0
    stamps_ahead: int = 0
    backward_time_jumps: int = 0
    controls_not_finite: int = 0


class TickStatistics:
    """Counts at every tick, and what they came to since the last report.

    Parameters
    ----------
    sample_time : float
        Time between ticks as wanted [s].
    now_ns : int
        When the first window begins.
    """

    def __init__(self, sample_time: float, now_ns: int) -> None:
        self.counts = TickCounts()
        self._sample_time = sample_time
        self._intervals: list[float] = []
        self._before = TickCounts()
        self._reported_ns = now_ns

    def tick(self, interval: float, *, saturated: bool, stale: bool) -> None:
        """Count a tick, ``interval`` seconds after the one before; 0 for the first."""
        counts = self.counts
        counts.ticks += 1
        counts.saturated_ticks += saturated
        counts.stale_ticks += stale
        if interval:
            self._intervals.append(interval)

    def window(self, now_ns: int) -> tuple[TickCounts, dict[str, float]]:
        """Counts since the last call, and rate [1/s] and jitter [s] in between."""
        before, now = asdict(self._before), asdict(self.counts)
        since = TickCounts(**{name: now[name] - before[name] for name in now})
        rate = since.ticks / max(now_ns - self._reported_ns, 1) * 1e9
        jitter = max((abs(interval - self._sample_time) for interval in self._intervals), default=0.0)
        self._intervals.clear()
        self._before, self._reported_ns = replace(self.counts), now_ns
        return since, {"rate [1/s]": rate, "jitter, largest [s]": jitter}


def health_problems(since: TickCounts, *, ticking: bool) -> list[tuple[bytes, str]]:
    """What the counts of a second give to worry about, with the level of each.

    ``ticking`` says whether ticks were to be expected.
    """
    warn = DiagnosticStatus.WARN
    found: list[tuple[bytes, str]] = []
    if since.controls_not_finite:
        found.append((DiagnosticStatus.ERROR, f"{since.controls_not_finite} controls were not finite"))
    if ticking and not since.ticks:
        found.append((warn, "no ticks: does the clock stand still?"))
    if since.late_ticks:
        found.append((warn, f"{since.late_ticks} ticks late or missing"))
    if since.refused_values:
        found.append((warn, f"{since.refused_values} values refused"))
    if since.stamps_ahead:
        found.append((warn, f"{since.stamps_ahead} of them stamped ahead of this node's clock"))
    if since.backward_time_jumps:
        found.append((warn, "time ran backwards"))
    if since.ticks and since.saturated_ticks == since.ticks:
        found.append((warn, "the control is at a limit all the time"))
    return found


def diagnostic_status(
    name: str, state: str, found: Sequence[tuple[bytes, str]], facts: Mapping[str, object]
) -> DiagnosticStatus:
    """One status: the worst level, all problems in words (``state`` if there are none), the facts as texts."""
    return DiagnosticStatus(
        name=name,
        hardware_id="fopid",
        level=max((level for level, _ in found), default=DiagnosticStatus.OK),
        message="; ".join(text for _, text in found) or state,
        values=[KeyValue(key=key, value=f"{fact:.6g}" if isinstance(fact, float) else str(fact))
                for key, fact in facts.items()],
    )  # fmt: skip


def diagnostic_array(status: DiagnosticStatus, node: Node) -> DiagnosticArray:
    """The message, stamped with the node's time."""
    message = DiagnosticArray(status=[status])
    message.header.stamp = node.get_clock().now().to_msg()
    return message


def conflicting_publishers(node: Node, topics: Sequence[str]) -> dict[str, list[str]]:
    """Topics that more than one node publishes, and the names of these nodes.

    A topic is left out while the name of one of its publishers is not known yet.
    """
    found = {}
    for topic in topics:
        full_name = node.resolve_topic_name(topic)
        if node.count_publishers(full_name) < 2:
            continue
        infos = node.get_publishers_info_by_topic(full_name)
        names = sorted(f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in infos)
        if len(names) > 1 and not any("_UNKNOWN_" in name for name in names):
            found[topic] = names
    return found


LEASE = 25.0
"""So long a node that was killed may still be listed [s]: the transport gives it up after 20 s without a sign."""


@dataclass(frozen=True)
class Rivalry:
    """A topic that several nodes publish.

    Attributes
    ----------
    topic : str
    text : str
        That in words.
    sure : bool
        False while all have one name, and all but one may have been killed: a node that was started again.
    """

    topic: str
    text: str
    sure: bool

    @property
    def level(self) -> bytes:
        """For the diagnostics: whose message counts is chance, so it is an error."""
        level: bytes = DiagnosticStatus.ERROR if self.sure else DiagnosticStatus.WARN
        return level


class PublisherConflicts:
    """Watches for topics that more than one node publishes: new ones are logged, once.

    Parameters
    ----------
    node : Node
    topics : sequence of str
    """

    def __init__(self, node: Node, topics: Sequence[str]) -> None:
        self._node, self._topics = node, topics
        self._known: dict[str, list[str]] = {}
        self._since: dict[str, float] = {}

    def check(self) -> list[Rivalry]:
        """The topics that are published by several just now."""
        now, conflicts = time.monotonic(), conflicting_publishers(self._node, self._topics)
        self._since = {topic: self._since.get(topic, now) for topic in conflicts}
        told = []
        for topic, names in conflicts.items():
            sure = len(set(names)) > 1 or now - self._since[topic] > LEASE
            text = f"{topic} is published by {' and '.join(names)}"
            told.append(Rivalry(topic, text if sure else f"{text}: started anew, or twice", sure))
            if self._known.get(topic) != names:
                self._node.get_logger().warning(f"{text}: the newest message counts, whoever sent it")
        self._known = conflicts
        return told
