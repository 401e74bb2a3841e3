"""What a rosbag2 folder says of itself: topics, definitions and ``metadata.yaml`` (format version 9).

The layout is rosbag2's own: https://github.com/ros2/rosbag2/blob/jazzy/docs/design/.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2.metadata import dump_qos_v9
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fopid_core import safe_yaml

METADATA_FILE = "metadata.yaml"
FORMAT_VERSION = 9
UNLIMITED = QosTime(2147483647, 4294967295)
"""A duration without a limit, as rosbag2 writes it."""


def qos(depth: int = 1, *, reliable: bool = True, latched: bool = False) -> Qos:
    """A profile as most topics are offered with: keep the last ``depth``; ``latched`` is transient local."""
    return Qos(
        QosHistory.KEEP_LAST,
        depth,
        QosReliability.RELIABLE if reliable else QosReliability.BEST_EFFORT,
        QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        UNLIMITED,
        UNLIMITED,
        QosLiveliness.AUTOMATIC,
        UNLIMITED,
        avoid_ros_namespace_conventions=False,
    )


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
    """

    name: str
    type_name: str
    definition: str


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


def topic_entry(name: str, type_name: str, profiles: Sequence[Qos], digest: str) -> dict[str, Any]:
    """The entry ``topic_metadata`` of a topic; ``digest`` is the hash of its type."""
    return {
        "name": name,
        "type": type_name,
        "serialization_format": "cdr",
        "offered_qos_profiles": dump_qos_v9(list(profiles)),
        "type_description_hash": digest,
    }


def information(
    files: Mapping[str, Content], custom: Mapping[str, str], storage: str = "mcap", *, compressed: bool = False
) -> dict[str, Any]:
    """The value of ``rosbag2_bagfile_information``.

    Parameters
    ----------
    files : mapping
        File name -> what it holds, in order.
    custom : mapping
        The bag's custom data.
    storage : str
        ``mcap`` or ``sqlite3``.
    compressed : bool
        Whether each message is compressed by itself.
    """
    whole = joined(list(files.values()))
    return {
        "version": FORMAT_VERSION,
        "storage_identifier": storage,
        **_span(whole),
        "topics_with_message_count": [
            {"topic_metadata": dict(entry), "message_count": whole.counts.get(name, 0)}
            for name, entry in whole.topics.items()
        ],
        "compression_format": "zstd" if compressed else "",
        "compression_mode": "MESSAGE" if compressed else "",
        "relative_file_paths": list(files),
        "files": [{"path": name, **_span(content)} for name, content in files.items()],
        "custom_data": dict(custom) or None,
        "ros_distro": "jazzy",
    }


def _span(content: Content) -> dict[str, Any]:
    return {
        "starting_time": {"nanoseconds_since_epoch": content.start},
        "duration": {"nanoseconds": content.end - content.start},
        "message_count": sum(content.counts.values()),
    }


def joined(contents: Sequence[Content]) -> Content:
    """What several files hold together."""
    topics = {name: entry for content in contents for name, entry in content.topics.items()}
    counts = {name: sum(content.counts.get(name, 0) for content in contents) for name in topics}
    filled = [content for content in contents if any(content.counts.values())]
    start, end = min((c.start for c in filled), default=0), max((c.end for c in filled), default=0)
    return Content(topics, counts, start, end)


def dump(value: Mapping[str, Any] | Sequence[Mapping[str, Any]]) -> str:
    """YAML as rosbag2 reads it, without anchors."""
    return yaml.dump(value, Dumper=_PlainDumper, sort_keys=False, allow_unicode=True)


class _PlainDumper(yaml.SafeDumper):
    def ignore_aliases(self, _data: Any) -> bool:
        return True


def write_metadata(folder: Path, described: Mapping[str, Any]) -> None:
    """Write ``metadata.yaml``, in one stroke: a reader sees the old one or the new one."""
    temporary = folder / f"{METADATA_FILE}.tmp"
    temporary.write_text(dump({"rosbag2_bagfile_information": described}), encoding="utf-8")
    temporary.replace(folder / METADATA_FILE)


def read_custom_data(folder: Path) -> dict[str, str]:
    """The custom data in a folder's ``metadata.yaml``; empty without such a file or when it cannot be read."""
    found = _read(folder, "custom_data")
    return {str(name): str(text) for name, text in found.items()} if isinstance(found, dict) else {}


def read_file_names(folder: Path) -> list[str]:
    """The files that a folder's ``metadata.yaml`` names; none without such a file or when it cannot be read."""
    found = _read(folder, "relative_file_paths")
    return [Path(str(name)).name for name in found] if isinstance(found, list) else []


def _read(folder: Path, entry: str) -> Any:
    try:
        loaded = safe_yaml.load(safe_yaml.read_text(folder / METADATA_FILE))
        return loaded["rosbag2_bagfile_information"][entry]
    except (OSError, ValueError, KeyError, TypeError):
        return None
