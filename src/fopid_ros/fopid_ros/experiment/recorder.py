"""Recording topics into a rosbag2 bag from within a node."""

from __future__ import annotations

import math
import shutil
import struct
import threading
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from rclpy.clock import Clock, ClockType, ROSClock
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rosbags.interfaces import (
    Nodetype,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.typesys import get_types_from_msg

from fopid_core.errors import InputError
from fopid_core.study.bags.bag import SIM_TIME_LIMIT_NS
from fopid_core.study.bags.rosbag2 import Topic, join_definitions
from fopid_core.study.bags.writer import BagWriter
from fopid_ros.common.cdr import fault_finder
from fopid_ros.experiment.recording import QUEUE

DEFAULT_QOS = QoSProfile(depth=QUEUE)
"""Deep enough for a second of lockstep while the disk is slow."""

FLUSH_PERIOD = 1.0
"""What a kill can cost [s, on a steady clock]."""

_STAMPED = ("std_msgs/Header", "builtin_interfaces/Time")
_STAMP = {0: struct.Struct(">iI"), 1: struct.Struct("<iI")}
"""Seconds and nanoseconds, by the byte order that the CDR encapsulation names."""


class Recorder:
    """Writes every message of the given topics into a rosbag2 mcap bag, until ``close``.

    A message is logged at its own stamp (a header or a time as its first field; zero is none, and so is one of a wall
    clock when the node's clock is simulated), else at the node's clock. A topic is described as its publishers offer
    it when its first message comes. A write error ends the recording, not the run: it is told once to ``on_failure``.

    Parameters
    ----------
    node : Node
        Subscribes; messages come in on its executor.
    folder : Path
        The bag; it must not exist yet.
    topics : mapping
        Topic name -> message class. Names are resolved by the node, so namespaces and remapping work.
    qos : mapping, optional
        Topic name -> profile to subscribe with, where it is not ``DEFAULT_QOS``.
    metadata : mapping, optional
        Texts kept in the bag: the experiment, versions.
    on_failure : callable, optional
        Takes one line; the node's log by default.

    Attributes
    ----------
    failure : str or None
        Why the recording ended early.

    Raises
    ------
    InputError
        If the folder exists or cannot be made, or a type's definition is not installed.
    """

    def __init__(
        self,
        node: Node,
        folder: Path,
        topics: Mapping[str, type],
        *,
        qos: Mapping[str, QoSProfile] | None = None,
        metadata: Mapping[str, str] | None = None,
        on_failure: Callable[[str], None] | None = None,
    ) -> None:
        self.folder = folder
        self.failure: str | None = None
        self._node = node
        self._on_failure = on_failure or node.get_logger().error
        self._lock = threading.RLock()  # on_failure may call close
        self._newest: dict[str, int] = {}
        self._refused = 0
        profiles = {name: (qos or {}).get(name, DEFAULT_QOS) for name in topics}
        names = {name: node.resolve_topic_name(name) for name in topics}
        try:
            self._bag = BagWriter(folder, [_topic(names[n], t) for n, t in topics.items()], metadata or {})
        except OSError as error:
            raise InputError(
                f"bag {str(folder)!r} cannot be made: {error.strerror}; allowed: a place to write"
            ) from None
        self._subscriptions = [
            node.create_subscription(message_type, name, self._callback(names[name], message_type), profiles[name],
                                     raw=True)
            for name, message_type in topics.items()
        ]  # fmt: skip
        self._timer = node.create_timer(FLUSH_PERIOD, self._flush, clock=Clock(clock_type=ClockType.STEADY_TIME))

    @property
    def counts(self) -> dict[str, int]:
        """Full topic name -> messages recorded so far."""
        return dict(self._bag.counts)

    def reached(self, topics: Iterable[str]) -> float:
        """Log time up to which all of these topics are recorded [ns]; those without a message so far do not count.

        0 when none of them has come, infinite without topics and once the recording has ended.
        """
        if self._bag.closed:
            return math.inf
        names = [self._node.resolve_topic_name(topic) for topic in topics]
        with self._lock:
            come = [self._newest[name] for name in names if name in self._newest]
        return min(come, default=0 if names else math.inf)

    def listening(self) -> bool:
        """It does from the start."""
        return True

    def _callback(self, topic: str, message_type: Any) -> Callable[[bytes], None]:
        fields = list(message_type.get_fields_and_field_types().values())
        stamped = bool(fields) and fields[0] in _STAMPED
        return partial(self._record, topic, _stamp if stamped else _no_stamp, fault_finder(message_type))

    def _record(self, topic: str, stamp: Callable[[bytes], int], fault_of: Callable[[bytes], str], data: bytes) -> None:
        fault = fault_of(data)
        if fault:  # a bag of which one message cannot be read is read by nobody
            self._refused += 1
            told = f"{topic}: {fault}; not recorded ({self._refused} so far)"
            self._node.get_logger().warning(told, throttle_duration_sec=1.0)
            return
        log_time = stamp(data)
        if log_time <= 0 or (log_time >= SIM_TIME_LIMIT_NS and self._simulated):
            log_time = self._node.get_clock().now().nanoseconds
        with self._lock:
            if self._bag.closed:
                return
            if topic not in self._newest:
                offers = self._node.get_publishers_info_by_topic(topic)
                self._bag.offered(topic, list(dict.fromkeys(_qos(offer.qos_profile) for offer in offers)))
            self._newest[topic] = max(log_time, self._newest.get(topic, 0))
            self._attempt(partial(self._bag.write, topic, log_time, data))

    @property
    def _simulated(self) -> bool:
        clock = self._node.get_clock()
        return isinstance(clock, ROSClock) and clock.ros_time_is_active

    def _flush(self) -> None:
        with self._lock:
            if not self._bag.closed:
                self._attempt(self._bag.flush)

    def _attempt(self, step: Callable[[], None]) -> None:
        try:
            step()
        except OSError as error:
            free = shutil.disk_usage(next(filter(Path.exists, (self.folder, *self.folder.absolute().parents)))).free
            self.failure = (
                f"recording stopped: {error.strerror} at {str(self.folder)!r}, {free / 1e6:.1f} MB free; "
                f"{sum(self._bag.counts.values())} messages are kept"
            )
            self._on_failure(self.failure)

    def close(self) -> None:
        """Finish the bag; a second call does nothing. May be called from any thread."""
        with self._lock:
            if not self._bag.closed:
                self._attempt(self._bag.close)


def _no_stamp(data: bytes) -> int:
    return 0


def _stamp(data: bytes) -> int:
    """The time at the beginning of a serialized message [ns], behind the four bytes of encapsulation."""
    seconds, nanoseconds = _STAMP[data[1] & 1].unpack_from(data, 4)
    return int(seconds * 1_000_000_000 + nanoseconds)


def _topic(name: str, message_type: Any) -> Topic:
    """What the bag keeps of a topic."""
    package, kind = message_type.__module__.split(".")[:2]
    type_name = f"{package}/{kind}/{message_type.__name__}"
    return Topic(name, type_name, join_definitions(_definitions(type_name)))


def _qos(profile: QoSProfile) -> Qos:
    """A publisher's profile as a bag keeps it: both number the policies as rmw does."""
    return Qos(
        QosHistory(int(profile.history)),
        profile.depth,
        QosReliability(int(profile.reliability)),
        QosDurability(int(profile.durability)),
        _time(profile.deadline),
        _time(profile.lifespan),
        QosLiveliness(int(profile.liveliness)),
        _time(profile.liveliness_lease_duration),
        profile.avoid_ros_namespace_conventions,
    )


def _time(duration: Duration) -> QosTime:
    return QosTime(*divmod(duration.nanoseconds, 1_000_000_000))


def _definitions(type_name: str) -> dict[str, str]:
    """The ``.msg`` texts of a type and of all types it contains, by type name, itself first."""
    found: dict[str, str] = {}
    waiting = [type_name]
    while waiting:
        name = waiting.pop(0)
        if name not in found:
            found[name] = _definition(name)
            waiting += _contained(name, found[name])
    return found


def _definition(type_name: str) -> str:
    package, _, name = type_name.split("/")
    spec = find_spec(package)
    for folder in Path(spec.origin).parents if spec and spec.origin else ():
        path = folder / "share" / package / "msg" / f"{name}.msg"
        if path.is_file():
            return path.read_text(encoding="utf-8")
    raise InputError(f"message type {type_name!r}: its definition is not installed (share/{package}/msg/{name}.msg)")


def _contained(type_name: str, definition: str) -> list[str]:
    """Names of the message types among a type's fields."""
    _, fields = get_types_from_msg(definition, type_name)[type_name]
    names = []
    for _, described in fields:
        kind, detail = described
        element: Any = detail[0] if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else described
        if element[0] == Nodetype.NAME:
            names.append(str(element[1]))
    return names
