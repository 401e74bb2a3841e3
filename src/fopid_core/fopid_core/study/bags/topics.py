"""The messages of topics, in the order of their stamps: as columns of numbers or as objects."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.rosbag2 import Reader
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from fopid_core.errors import InputError
from fopid_core.study.bags.cdr import Column, columns
from fopid_core.study.bags.expansion import plain_message
from fopid_core.study.bags.files import UNREADABLE, one_line

_PARSERS: dict[MessageDefinitionFormat, Callable[[str, str], Any]] = {
    MessageDefinitionFormat.MSG: get_types_from_msg,
    MessageDefinitionFormat.IDL: lambda text, _: get_types_from_idl(text),
}


@dataclass(frozen=True)
class Recorded:
    """The messages of a topic, in the order of their stamps.

    Attributes
    ----------
    type_name : str
    stamps, log_times : ndarray, shape (n,)
        [ns]; where a message has no stamp of its own, its log time stands for it.
    raw : list of bytes
        The messages, serialized.
    columns : mapping
        Every number of the messages, by its path.
    types : Typestore
        Knows the type.
    """

    type_name: str
    stamps: NDArray[np.int64]
    log_times: NDArray[np.int64]
    raw: list[bytes]
    columns: Mapping[str, Column]
    types: Typestore

    def objects(self) -> list[Any]:
        """The messages as objects."""
        try:
            return [self.types.deserialize_cdr(data, self.type_name) for data in self.raw]
        except (SerdeError, *UNREADABLE) as error:
            raise InputError(f"a message of type {self.type_name} cannot be read: {one_line(error)}") from None

    def on(self, clock: Recorded, foreign: int) -> Recorded:
        """The same on the clock that ``clock`` is stamped with; stamps from ``foreign`` [ns] on are of another one."""
        told = np.interp(self.log_times, np.maximum.accumulate(clock.log_times), clock.stamps)
        stamps = np.where(self.stamps < foreign, self.stamps, told.astype(np.int64))
        return self.in_order(stamps)

    def in_order(self, stamps: NDArray[np.int64]) -> Recorded:
        """The same with other stamps, and in their order."""
        order = np.argsort(stamps, kind="stable")
        raw, columns = [self.raw[i] for i in order], {path: column[order] for path, column in self.columns.items()}
        return replace(self, stamps=stamps[order], log_times=self.log_times[order], raw=raw, columns=columns)


def read_topics(readers: Sequence[Reader], topics: Mapping[str, str], most: int) -> dict[str, Recorded]:
    """The messages of some topics.

    Parameters
    ----------
    readers : sequence of Reader
        Of the bag's files, opened.
    topics : mapping
        Topic -> the name to give what is found. Topics without messages are left out.
    most : int
        How many bytes the messages that are compressed by themselves may hold, together.

    Raises
    ------
    InputError
        If a type is not defined in the bag, or the messages hold more than ``most`` bytes.
    """
    messages: dict[str, list[tuple[int, bytes]]] = defaultdict(list)
    wanted = [c for reader in readers for c in reader.connections if c.topic in topics]
    for reader in readers:
        if here := [c for c in reader.connections if c.topic in topics]:
            for connection, time, data in reader.messages(here):
                plain = plain_message(data, most)
                most -= len(plain) if plain is not data else 0
                messages[connection.topic].append((time, plain))
    types = _typestore([c for c in wanted if c.topic in messages])
    names = {c.topic: c.msgtype for c in wanted}
    return {topics[topic]: _recorded(names[topic], found, types) for topic, found in messages.items()}


def _typestore(connections: Sequence[Connection]) -> Typestore:
    """The types as the bag defines them; those without a definition as ROS 2 Jazzy has them."""
    types: dict[str, Any] = {}
    if any(c.msgdef.format not in _PARSERS for c in connections):
        types.update(get_typestore(Stores.ROS2_JAZZY).fielddefs)
    for c in connections:
        if parse := _PARSERS.get(c.msgdef.format):
            try:
                types.update(parse(c.msgdef.data, c.msgtype))
            except TypesysError as error:
                raise InputError(f"the bag's definition of {c.msgtype} cannot be read: {one_line(error)}") from None
    unknown = sorted({c.msgtype for c in connections} - set(types))
    if unknown:
        raise InputError(
            f"the bag has no definition of {', '.join(unknown)}; allowed: bags that hold their definitions"
        )
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    return store


def _recorded(type_name: str, found: Sequence[tuple[int, bytes]], types: Typestore) -> Recorded:
    log_times = np.array([time for time, _ in found], dtype=np.int64)
    raw = [data for _, data in found]
    recorded = Recorded(type_name, log_times, log_times, raw, columns(raw, type_name, types.fielddefs), types)
    stamps = _stamps(recorded)
    if not np.any(stamps):  # the publisher leaves them at zero, or there are none
        return recorded
    return recorded.in_order(stamps)


def _stamps(recorded: Recorded) -> NDArray[np.int64]:
    """The instants that the messages themselves name [ns]; zeros without any."""
    fields = dict(recorded.types.fielddefs[recorded.type_name][1])
    prefix = "header.stamp" if "header" in fields else "stamp"
    seconds, nanoseconds = (recorded.columns.get(f"{prefix}.{unit}") for unit in ("sec", "nanosec"))
    if seconds is None or nanoseconds is None:
        return np.zeros(len(recorded.raw), dtype=np.int64)
    return seconds.astype(np.int64) * 1_000_000_000 + nanoseconds.astype(np.int64)
