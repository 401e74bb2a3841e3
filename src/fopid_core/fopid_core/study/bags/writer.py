"""Writing a rosbag2 bag (mcap) that opens whatever ends the recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer
from rosbags.interfaces import Qos
from rosbags.rosbag2.metadata import dump_qos_v9

from fopid_core.errors import InputError
from fopid_core.study.bags.repair import repair
from fopid_core.study.bags.rosbag2 import Content, Topic, dump, information, topic_entry, type_hash, write_metadata

CHUNK_SIZE = 64 * 1024
"""Bytes of messages in a chunk before compression: what a full disk or a kill can cost at most."""

LIBRARY = "fopid_core"
METADATA_RECORD = "rosbag2"
METADATA_KEY = "serialized_metadata"


class BagWriter:
    """A new bag, every message definition inside.

    ``metadata.yaml`` is there from the start. Messages are written in chunks: what ``flush`` has written
    survives the death of the process. After an ``OSError`` (a full disk, say) the bag holds what was written
    before it, with its index, and takes no more.

    Parameters
    ----------
    folder : Path
        The bag; it must not exist yet.
    topics : sequence of Topic
    metadata : mapping
        Texts kept in the bag as its ``custom_data``.

    Attributes
    ----------
    counts : dict
        Topic name -> messages taken so far.
    custom : dict
        The texts, which may change until the bag is closed.

    Raises
    ------
    InputError
        If the folder exists.
    OSError
        If it cannot be made.

    Examples
    --------
    >>> import tempfile
    >>> from fopid_core.study.bags.rosbag2 import Topic
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     bag = BagWriter(Path(folder, "bag"), [Topic("/a", "std_msgs/msg/Float64", "float64 data")], {})
    ...     bag.write("/a", 0, bytes.fromhex("00010000" "000000000000f03f"))
    ...     bag.close()
    ...     sorted(path.name for path in Path(folder, "bag").iterdir())
    ['bag.mcap', 'metadata.yaml']
    """

    def __init__(self, folder: Path, topics: Sequence[Topic], metadata: Mapping[str, str]) -> None:
        self.folder = folder
        self.counts = dict.fromkeys((topic.name for topic in topics), 0)
        self.custom = dict(metadata)
        self._topics = {topic.name: topic for topic in topics}
        self._entries = {
            t.name: topic_entry(t.name, t.type_name, (), type_hash(t.type_name, t.definition)) for t in topics
        }
        self._span: tuple[int, int] | None = None
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            raise InputError(f"bag {str(folder)!r} exists already; allowed: a name that is free") from None
        self._path = folder / f"{folder.name}.mcap"
        self._file = self._path.open("xb")
        # Any, since its methods carry no types.
        self._writer: Any = Writer(self._file, chunk_size=CHUNK_SIZE, compression=CompressionType.ZSTD)
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._describe(Content(self._entries, {}))
        self._writer.start(profile="ros2", library=LIBRARY)
        self._file.flush()

    def offered(self, topic: str, profiles: Sequence[Qos]) -> None:
        """Say how a topic is offered, by each of its publishers; before its first message.

        Raises
        ------
        InputError
            After the first message.
        """
        if topic in self._channels:
            raise InputError(f"topic {topic!r} has messages already; allowed: profiles before the first one")
        self._entries[topic]["offered_qos_profiles"] = dump_qos_v9(list(profiles))

    def _channel(self, name: str) -> int:
        """The topic's channel, written with its first message: by then its publishers are known."""
        if name not in self._channels:
            topic, entry = self._topics[name], self._entries[name]
            if topic.type_name not in self._schemas:
                schema = self._writer.register_schema(topic.type_name, "ros2msg", topic.definition.encode())
                self._schemas[topic.type_name] = schema
            self._channels[name] = self._writer.register_channel(
                name,
                message_encoding="cdr",
                schema_id=self._schemas[topic.type_name],
                metadata={
                    "offered_qos_profiles": dump(entry["offered_qos_profiles"]),
                    "topic_type_hash": entry["type_description_hash"],
                },
            )
        return self._channels[name]

    def _describe(self, content: Content) -> None:
        write_metadata(self.folder, information({self._path.name: content}, self.custom))

    @property
    def closed(self) -> bool:
        """Whether the bag takes no more messages."""
        return self._file.closed

    def write(self, topic: str, log_time: int, data: bytes) -> None:
        """Take a message: serialized (CDR), with its log time [ns]."""
        try:
            self._writer.add_message(self._channel(topic), log_time, data, publish_time=log_time)
        except OSError:
            self._abandon()
            raise
        self.counts[topic] += 1
        start, end = self._span or (log_time, log_time)
        self._span = min(start, log_time), max(end, log_time)

    def flush(self) -> None:
        """Hand everything taken so far to the operating system."""
        try:
            self._writer.flush()
        except OSError:
            self._abandon()
            raise

    def close(self) -> None:
        """Write index and ``metadata.yaml``; a closed bag is left as it is."""
        if self.closed:
            return
        try:
            for topic in self._topics:
                self._channel(topic)
            content = Content(self._entries, self.counts, *(self._span or (0, 0)))
            self._writer.flush()
            embedded = dump(information({self._path.name: content}, self.custom))
            self._writer.add_metadata(METADATA_RECORD, {METADATA_KEY: embedded})
            self._writer.finish()
            self._file.close()
            self._describe(content)
        except BaseException:
            self._abandon()
            raise

    def _abandon(self) -> None:
        """End the bag at its last whole chunk."""
        # The buffer still holds what could not be written; without the file beneath it is thrown away.
        self._file.raw.close()
        kept: Mapping[str, int] = {}
        # Where nothing at all can be written the bag stays without index, for a later repair.
        with suppress(InputError, OSError):
            kept = repair(self.folder).counts
        self.counts.update({topic: kept.get(topic, 0) for topic in self.counts})
