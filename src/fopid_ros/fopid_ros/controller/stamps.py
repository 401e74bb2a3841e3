"""Which samples a controller node believes by their stamps: none from the future, none older than one before."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from enum import Enum, auto
from typing import Any

from fopid_ros.common.diagnostics import TickCounts
from fopid_ros.common.managed_node import ManagedNode


def time_of_stamps(node: ManagedNode) -> Callable[[], int]:
    """The node's time [ns]; without /clock that is the system's, which is read faster."""
    simulated = node.get_parameter("use_sim_time").value
    return (lambda: int(node.get_clock().now().nanoseconds)) if simulated else time.time_ns


class Order(Enum):
    """What a measurement's stamp says of it."""

    NEWER = auto()
    SAME = auto()
    OLDER = auto()


class Stamps:
    """Judges stamps by the node's clock and by those before, and counts what it refuses.

    Parameters
    ----------
    node : ManagedNode
    counts : TickCounts
        Where refusals are counted.
    """

    def __init__(self, node: ManagedNode, counts: TickCounts) -> None:
        self._node, self._counts, self._now = node, counts, time_of_stamps(node)
        self._most_ahead_ns = 0
        self._looked_ns = time.monotonic_ns()
        self._last: int | None = None
        self._last_refused = False

    def take_settings(self, values: Mapping[str, Any]) -> None:
        """Put the tolerance in force: a tick and ``clock_skew_max``."""
        self._most_ahead_ns = round((values["sample_time"] + values["clock_skew_max"]) * 1e9)

    def begin(self) -> None:
        """Forget the order of the samples before."""
        self._last = None

    def waited(self, info: Mapping[str, int] | None) -> int:
        """How long a message has waited to be read [ns], by what the transport knows of it; 0 where that is not known.

        No longer than since the last look, whatever the system's clock has been set to meanwhile.
        """
        if info is None:
            return 0
        since = time.monotonic_ns() - self._looked_ns
        return min(max(time.time_ns() - info["received_timestamp"], 0), since)

    def looked(self) -> None:
        """All messages that had come have been read."""
        self._looked_ns = time.monotonic_ns()

    def too_far_ahead(self, name: str, stamp_ns: int | None, waited_ns: int = 0) -> str:
        """Why a sample of this signal is refused: its stamp is beyond the tolerance; empty for one that is not."""
        if not stamp_ns:
            return ""
        ahead_ns = stamp_ns - self._now() + waited_ns
        if ahead_ns <= self._most_ahead_ns:
            return ""
        self._counts.stamps_ahead += 1
        allowed = f"allowed: {self._most_ahead_ns * 1e-9:g} s, a tick and clock_skew_max"
        return f"{name} is stamped {ahead_ns * 1e-9:.6g} s ahead of this node's clock; {allowed}"

    def order(self, stamp_ns: int | None) -> Order:
        """A measurement against the one before; after one that is older, the next newer one counts again.

        One that was refused is refused again when it comes again.
        """
        if not stamp_ns:
            return Order.NEWER
        before, self._last = self._last, stamp_ns
        if before is None or stamp_ns > before:
            self._last_refused = False
            return Order.NEWER
        if stamp_ns == before and not self._last_refused:
            return Order.SAME
        self._last_refused = True
        self.warn_backwards("the measurement's stamp", "the sample is refused")
        return Order.OLDER

    def warn_backwards(self, what: str, consequence: str) -> None:
        """Count and tell that a time has run backwards."""
        self._counts.backward_time_jumps += 1
        self._node.get_logger().warning(f"{what} ran backwards: {consequence}", throttle_duration_sec=1.0)
