"""Giving a bag that was cut off (a kill, a full disk, a crash) its index and its ``metadata.yaml`` back."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.rosbag2 import Reader

from fopid_core.errors import InputError
from fopid_core.study.bags.expansion import check_chunks, check_index, is_compressed, most_bytes
from fopid_core.study.bags.files import (
    COMPRESSED,
    REPAIRED,
    STORAGES,
    UNREADABLE,
    bag_of,
    decompress,
    files_of,
    is_whole,
    one_line,
    plain_name,
)
from fopid_core.study.bags.mcap_repair import repair_file
from fopid_core.study.bags.rosbag2 import (
    Content,
    information,
    joined,
    read_custom_data,
    topic_entry,
    type_hash,
    write_metadata,
)
from fopid_core.study.bags.sqlite_repair import settle


def repair(folder: Path) -> Content:
    """Mend each file of a bag and write ``metadata.yaml`` anew; its custom data is kept, and says so from then on.

    Of an mcap file that was cut off all whole chunks are kept; log and journal of an sqlite3 file are brought in;
    a file that was compressed as a whole is one no more, since the last one, which was being written, is none either.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    Content
        What the bag holds now.

    Raises
    ------
    InputError
        If it is no folder with files of a bag, one of them is damaged from the start, or the disk refuses.

    Examples
    --------
    >>> repair(Path("no/such/bag"))
    Traceback (most recent call last):
    fopid_core.errors.InputError: bag 'no/such/bag' is no folder; allowed: a folder with .mcap or .db3 files
    """
    if not (os.access(folder, os.F_OK) and folder.is_dir()):
        raise InputError(f"bag {str(folder)!r} is no folder; allowed: a folder with .mcap or .db3 files")
    folder = bag_of(folder)
    try:
        found = files_of(folder)
        most = [most_bytes(file.stat().st_size) for file in found]
        files = [_plain(file) for file in found]
        custom = read_custom_data(folder)
        cut_off, mended = not all(map(is_whole, files)), [*map(_mend, files, most)]
        if cut_off or any(mended):
            custom[REPAIRED] = "the recording was cut off or damaged"
        kept = mended[-1]
        while True:
            try:
                return _describe(folder, files, custom)
            except OSError:
                if not kept:
                    raise
                kept = repair_file(files[-1], at_most=kept - 1)
    except UNREADABLE as error:
        raise InputError(f"bag {str(folder)!r} cannot be repaired: {one_line(error)}") from None


def _plain(file: Path) -> Path:
    """The file, decompressed."""
    if file.suffix == COMPRESSED:
        decompress(file, plain_name(file))
        file.unlink()
    return plain_name(file)


def _mend(file: Path, most: int) -> int:
    """Chunks that could be given up for room: those of a file that had to be mended."""
    if file.suffix == ".mcap":
        check_chunks(file, most)
        kept = repair_file(file)
        check_index(file)
        return kept
    settle(file)
    return 0


def _describe(folder: Path, files: Sequence[Path], custom: Mapping[str, str]) -> Content:
    """Write ``metadata.yaml``."""
    contents, compressed = {}, False
    for file in files:
        with Reader(file) as reader:
            contents[file.name] = _content(reader)
            compressed |= any(is_compressed(data) for _, (*_, data) in zip(range(1), reader.messages(), strict=False))
    storage = STORAGES[files[0].suffix]
    write_metadata(folder, information(contents, custom, storage, compressed=compressed))
    return joined(list(contents.values()))


def _content(reader: Reader) -> Content:
    counts = {connection.topic: 0 for connection in reader.connections}
    for connection in reader.connections:
        counts[connection.topic] += connection.msgcount
    topics = {connection.topic: _entry(connection) for connection in reader.connections}
    if not reader.message_count:
        return Content(topics, counts)
    return Content(topics, counts, reader.start_time, reader.end_time - 1)  # the end is one beyond the last message


def _entry(connection: Connection) -> dict[str, Any]:
    profiles = getattr(connection.ext, "offered_qos_profiles", ())
    defined = connection.msgdef.format == MessageDefinitionFormat.MSG
    digest = connection.digest or (type_hash(connection.msgtype, connection.msgdef.data) if defined else "")
    return topic_entry(connection.topic, connection.msgtype, profiles, digest)
