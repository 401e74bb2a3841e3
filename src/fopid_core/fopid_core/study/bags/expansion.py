"""What a bag may become when it is unpacked: whole files, the chunks of an mcap file, single messages.

All is checked before the libraries that read bags unpack it: they trust the sizes that a file names, or have no limit.
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.writer import MCAP0_MAGIC

from fopid_core.errors import InputError

if sys.version_info >= (3, 14):  # rosbags reads with it
    from compression.zstd import ZstdError, ZstdFile
else:
    from backports.zstd import ZstdError, ZstdFile

_DENSEST = 200  # a recording shrinks 3 to 30 times: its stamps differ
_ALWAYS = 100_000_000  # [bytes]
_PART = 1_000_000  # [bytes] unpacked at once
_ZSTD = bytes.fromhex("28b52ffd")  # how all that is compressed begins

_MAGIC, _FOOTER = 8, 37  # [bytes] of an mcap file's beginning, and of its last record with what follows
_CHUNK, _CHUNK_INDEX, _END_OF_INDEX = 0x06, 0x08, (0x02, 0x0E)
_SHORTEST = 40  # [bytes] of a chunk's record or of its index, without the variable parts
_DAMAGED = (ZstdError, zstandard.ZstdError, EOFError, RuntimeError)  # the last is lz4's; readers and repair tell it


class _Chunk(NamedTuple):
    """A chunk as its own record or the file's index describes it: where it starts and what it says of itself."""

    start: int
    compression: bytes
    compressed: int
    plain: int


def most_bytes(size: int) -> int:
    """How many bytes a file of ``size`` bytes may hold when all in it is unpacked.

    Examples
    --------
    >>> most_bytes(10_000), most_bytes(1_000_000)
    (100000000, 200000000)
    """
    return max(_ALWAYS, _DENSEST * size)


def refused(name: str, most: int) -> InputError:
    """The error for a file that holds more than ``most`` bytes."""
    return InputError(f"{name!r} holds more than {most:,} bytes; allowed: up to that for its size")


def is_compressed(message: bytes) -> bool:
    """Whether a message is compressed by itself; a plain one begins with the byte 0 of its encapsulation."""
    return message[:4] == _ZSTD


def plain_message(data: bytes, most: int) -> bytes:
    """A message, decompressed if it is compressed by itself.

    Raises
    ------
    InputError
        If it says that it holds more than ``most`` bytes. One that does not say so is damaged: rosbag2 always does.
    """
    if not is_compressed(data):
        return data
    if zstandard.frame_content_size(data) > most:
        raise InputError(f"a message holds more than {most:,} bytes; allowed: up to that for the size of its bag")
    return zstandard.ZstdDecompressor().decompress(data)


def check_chunks(file: Path, most: int) -> None:
    """Refuse an mcap file, whole or cut off, whose chunks hold too much.

    Raises
    ------
    InputError
        If together they hold more than ``most`` bytes, or one holds more than it says.
    """
    with file.open("rb") as stream:
        chunks = _chunks(stream)
        if sum(chunk.plain for chunk in chunks) > most:
            raise refused(file.name, most)
        for chunk in chunks:
            stream.seek(chunk.start + 9 + _SHORTEST + len(chunk.compression))
            if _exceeds(stream.read(chunk.compressed), chunk):
                raise InputError(
                    f"{file.name!r}: the chunk at {chunk.start} holds more than the {chunk.plain:,} bytes that it "
                    "says; allowed: as many"
                )


def check_index(file: Path) -> None:
    """Refuse an mcap file whose index would have other bytes unpacked than ``check_chunks`` has seen, or one twice.

    Raises
    ------
    InputError
        If it does.
    """
    with file.open("rb") as stream:
        index = _index(stream)
        if len(set(index)) < len(index) or not set(index) <= set(_chunks(stream)):
            raise InputError(f"{file.name!r}: its index is not that of its chunks; allowed: each of them once")


def _chunks(stream: BinaryIO) -> list[_Chunk]:
    """All chunks, in order."""
    return [_chunk(stream, start) for start in _records(stream, _MAGIC, _CHUNK)]


def _records(stream: BinaryIO, start: int, kind: int, ends: tuple[int, ...] = ()) -> Iterator[int]:
    """Where the records of a kind begin, from ``start`` on, as far as the file can be followed."""
    size = stream.seek(0, 2)
    while start < size:
        stream.seek(start)
        head = stream.read(9)
        if head[0] in ends:
            return
        if head[0] == kind:
            yield start
        start += 9 + int.from_bytes(head[1:], "little")


def _chunk(stream: BinaryIO, start: int) -> _Chunk:
    """What a chunk's record says; one that is cut off has no bytes."""
    stream.seek(start + 9 + 16)
    try:
        plain, _, length = struct.unpack("<QII", stream.read(16))
        compression = stream.read(min(length, 16))
        (compressed,) = struct.unpack("<Q", stream.read(8))
    except struct.error:
        return _Chunk(start, b"", 0, 0)
    rest = stream.seek(0, 2) - (start + 9 + _SHORTEST + length)
    return _Chunk(start, compression, max(0, min(compressed, rest)), plain)


def _index(stream: BinaryIO) -> list[_Chunk]:
    """The chunks that the index names, read from where a reader starts; none without an index, or when cut off."""
    size = stream.seek(0, 2)
    stream.seek(max(0, size - _FOOTER))
    footer = stream.read()
    if size < _MAGIC + _FOOTER or not footer.endswith(MCAP0_MAGIC):
        return []
    (summary,) = struct.unpack("<Q", footer[9:17])
    if not summary:
        return []
    return [_indexed(stream, start) for start in _records(stream, summary, _CHUNK_INDEX, _END_OF_INDEX)]


def _indexed(stream: BinaryIO, start: int) -> _Chunk:
    stream.seek(start + 9 + 16)
    at, _, offsets = struct.unpack("<QQI", stream.read(20))
    stream.seek(offsets + 8, 1)
    (length,) = struct.unpack("<I", stream.read(4))
    compression = stream.read(min(length, 16))
    return _Chunk(at, compression, *struct.unpack("<QQ", stream.read(16)))


def _exceeds(data: bytes, chunk: _Chunk) -> bool:
    """Whether a chunk's bytes become more than it says; they are unpacked in parts, and none is kept."""
    try:
        if chunk.compression == b"zstd":
            return zstandard.frame_content_size(data) > chunk.plain or _longer(ZstdFile(BytesIO(data)), chunk.plain)
        if chunk.compression == b"lz4":
            said = int(lz4.frame.get_frame_info(data)["content_size"])
            return said > chunk.plain or _longer(lz4.frame.LZ4FrameFile(BytesIO(data)), chunk.plain)
    except _DAMAGED:
        return False
    return False


def _longer(stream: Any, size: int) -> bool:
    while size >= 0 and (part := stream.read(_PART)):
        size -= len(part)
    return size < 0
