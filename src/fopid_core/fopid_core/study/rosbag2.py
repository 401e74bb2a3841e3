"""What a rosbag2 folder says of itself: topics, definitions and ``metadata.yaml`` (format version 9).

The layout is rosbag2's own: https://github.com/ros2/rosbag2/blob/jazzy/docs/design/.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

METADATA_FILE = "metadata.yaml"
FORMAT_VERSION = 9
UNLIMITED = {"sec": 2147483647, "nsec": 4294967295}
"""A duration without a limit, as rosbag2 writes it."""


@dataclass(frozen=True)
class Qos:
    """How a topic is offered.

    Attributes
    ----------
    depth : int
        Messages kept.
    reliable, latched : bool
        Reliable rather than best effort; transient local rather than volatile.
    """

    depth: int = 1
    reliable: bool = True
    latched: bool = False

    def profile(self) -> dict[str, Any]:
        """The profile in the words of ``metadata.yaml``."""
        return {
            "history": "keep_last",
            "depth": self.depth,
            "reliability": "reliable" if self.reliable else "best_effort",
            "durability": "transient_local" if self.latched else "volatile",
            "deadline": UNLIMITED,
            "lifespan": UNLIMITED,
            "liveliness": "automatic",
            "liveliness_lease_duration": UNLIMITED,
            "avoid_ros_namespace_conventions": False,
        }


@dataclass(frozen=True)
class Topic:
    """A topic to be recorded.

    Attributes
    ----------
    name : str
        Full name, with the namespace.
    type_name : str
        ``package/msg/Name``.
    definition : str
        The type's ``.msg`` text, followed by those of all types it contains (see ``join_definitions``).
    qos : Qos
    """

    name: str
    type_name: str
    definition: str
    qos: Qos = field(default_factory=Qos)


@dataclass(frozen=True)
class Content:
    """What a bag holds.

    Attributes
    ----------
    topics : mapping
        Topic name -> its entry ``topic_metadata``.
    counts : mapping
        Topic name -> number of messages.
    start, end : int
        Log time of the first and the last message [ns].
    """

    topics: Mapping[str, Mapping[str, Any]]
    counts: Mapping[str, int]
    start: int = 0
    end: int = 0


def join_definitions(definitions: Mapping[str, str]) -> str:
    """One text from a type's ``.msg`` text and those of the types it contains, the type itself first.

    Examples
    --------
    >>> print(join_definitions({"a/msg/Outer": "Inner inner", "a/msg/Inner": "float64 value"}))
    Inner inner
    ================================================================================
    MSG: a/Inner
    float64 value
    """
    first, *others = definitions.items()
    parts = [first[1], *(f"MSG: {name.replace('/msg/', '/')}\n{text}" for name, text in others)]
    return f"\n{'=' * 80}\n".join(part.rstrip("\n") for part in parts)


def type_hash(type_name: str, definition: str) -> str:
    """The RIHS01 hash of a message type (REP-2016), from the text of ``join_definitions``."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition, type_name))
    return store.hash_rihs01(type_name)


def topic_entry(topic: Topic) -> dict[str, Any]:
    """The entry ``topic_metadata`` of a topic."""
    return {
        "name": topic.name,
        "type": topic.type_name,
        "serialization_format": "cdr",
        "offered_qos_profiles": [topic.qos.profile()],
        "type_description_hash": type_hash(topic.type_name, topic.definition),
    }


def information(file_name: str, content: Content, custom: Mapping[str, str]) -> dict[str, Any]:
    """The value of ``rosbag2_bagfile_information`` for a bag of one mcap file."""
    total = sum(content.counts.values())
    span = {
        "starting_time": {"nanoseconds_since_epoch": content.start},
        "duration": {"nanoseconds": content.end - content.start},
        "message_count": total,
    }
    return {
        "version": FORMAT_VERSION,
        "storage_identifier": "mcap",
        **span,
        "topics_with_message_count": [
            {"topic_metadata": dict(entry), "message_count": content.counts.get(name, 0)}
            for name, entry in content.topics.items()
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file_name],
        "files": [{"path": file_name, **span}],
        "custom_data": dict(custom) or None,
        "ros_distro": "jazzy",
    }


def dump(value: Mapping[str, Any] | Sequence[Mapping[str, Any]]) -> str:
    """YAML as rosbag2 reads it, without anchors."""
    return yaml.dump(value, Dumper=_PlainDumper, sort_keys=False, allow_unicode=True)


class _PlainDumper(yaml.SafeDumper):
    def ignore_aliases(self, _data: Any) -> bool:
        return True


def write_metadata(folder: Path, file_name: str, content: Content, custom: Mapping[str, str]) -> None:
    """Write ``metadata.yaml``, in one stroke: a reader sees the old one or the new one."""
    text = dump({"rosbag2_bagfile_information": information(file_name, content, custom)})
    temporary = folder / f"{METADATA_FILE}.tmp"
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(folder / METADATA_FILE)


def read_custom_data(folder: Path) -> dict[str, str]:
    """The custom data in a folder's ``metadata.yaml``; empty without such a file or when it cannot be read."""
    try:
        loaded = yaml.safe_load((folder / METADATA_FILE).read_text(encoding="utf-8"))
        return dict(loaded["rosbag2_bagfile_information"]["custom_data"] or {})
    except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError):
        return {}
