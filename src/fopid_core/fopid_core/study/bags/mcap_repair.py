"""Giving an mcap file that was cut off (a kill, a full disk, a crash) its index back.

An mcap file is a row of records: chunks of messages, each followed by its message index, and at the end the
index of all chunks (https://mcap.dev/spec). Some recorders write messages without chunks. What was cut off in the
middle or is damaged is dropped, all whole chunks and messages are kept.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    McapRecord,
    Message,
    MessageIndex,
    Schema,
    Statistics,
)
from mcap.stream_reader import CRCValidationError, StreamReader, get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC

_CUT_OFF = (McapError, CRCValidationError, ValueError, struct.error, RuntimeError, zstandard.ZstdError)
"""What the mcap library raises where a file ends too soon or is damaged; lz4 raises RuntimeError."""

_DESCRIBING: dict[int, Any] = {Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel}


@dataclass
class _Chunk:
    """A whole chunk, or a row of messages without one: where it is in the file and what is in it.

    Of a damaged chunk nothing is known but its place.
    """

    start: int
    end: int
    record: Chunk | None = None
    damaged: bool = False
    indices: dict[int, MessageIndex] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    index_offsets: dict[int, int] = field(default_factory=dict)
    index_end: int = 0

    def take(self, record: McapRecord, offset: int) -> None:
        """Note a record within the chunk."""
        if isinstance(record, Message):
            index = self.indices.setdefault(record.channel_id, MessageIndex(record.channel_id, []))
            index.records.append((record.log_time, offset))
        elif isinstance(record, Schema):
            self.schemas[record.id] = record
        elif isinstance(record, Channel):
            self.channels[record.id] = record


def is_whole(mcap_file: Path) -> bool:
    """Whether an mcap file was closed in good order."""
    magic = len(MCAP0_MAGIC)
    with mcap_file.open("rb") as stream:
        size = stream.seek(0, 2)
        stream.seek(max(0, size - magic))
        return size > 2 * magic and stream.read() == MCAP0_MAGIC


def repair_file(path: Path, at_most: int | None = None) -> int:
    """Cut a file after its last whole chunk, or after ``at_most`` chunks, and write a new index.

    Damaged chunks before that stay where they are, and out of the index. When there is no room left for the index,
    chunks at the end make room for it. A file without damage is left alone.

    Returns
    -------
    int
        How many chunks are kept; 0 when nothing was mended.

    Raises
    ------
    McapError
        If it is no mcap file.
    OSError
        If the disk refuses.
    """
    with path.open("rb") as stream:
        header_end, chunks, sound = _whole_chunks(path, stream)
    if sound and at_most is None:
        return 0
    chunks = _readable(chunks)[:at_most]
    while True:
        try:
            _replace_tail(path, header_end, chunks)
            return len(chunks)
        except OSError:
            if not chunks or chunks[-1].record is None:
                raise
            chunks.pop()


def _whole_chunks(path: Path, stream: BinaryIO) -> tuple[int, list[_Chunk], bool]:
    """The end of the file's header, the chunks as far as the file can be followed, and whether all of it is sound."""
    chunks: list[_Chunk] = []
    header_end, ended = 0, False
    try:
        for start, record in _records(stream):
            if header_end == 0:
                header_end = stream.tell()
            elif isinstance(record, DataEnd):
                ended = True
            elif ended:
                _take_from_summary(chunks, record)
            else:
                _take(chunks, record, start, stream.tell())
    except _CUT_OFF as error:
        if header_end == 0:
            raise McapError(f"{path.name!r} is no mcap file, or was cut off in its first bytes: {error}") from None
        return header_end, chunks, False
    return header_end, chunks, not any(chunk.damaged for chunk in chunks)


def _take(chunks: list[_Chunk], record: McapRecord, start: int, end: int) -> None:
    if isinstance(record, Chunk):
        chunks.append(_read_chunk(start, end, record))
    elif isinstance(record, MessageIndex) and chunks:
        chunks[-1].index_offsets[record.channel_id] = start
        chunks[-1].index_end = end
    elif isinstance(record, (Schema, Channel, Message)):
        if not chunks or chunks[-1].record or chunks[-1].damaged:
            chunks.append(_Chunk(start, end))
        chunks[-1].take(record, start)
        chunks[-1].end = end


def _take_from_summary(chunks: list[_Chunk], record: McapRecord) -> None:
    """The summary repeats the descriptions that a damaged chunk may have held."""
    if isinstance(record, (Schema, Channel)):
        for chunk in chunks:
            if chunk.damaged:
                chunk.take(record, 0)


def _readable(chunks: list[_Chunk]) -> list[_Chunk]:
    """Those up to the last whole one; up to the first damaged one when that held descriptions that others need."""
    known = _channels(chunks)
    if any(channel not in known for chunk in chunks for channel in chunk.indices):
        chunks = chunks[: next(i for i, chunk in enumerate(chunks) if chunk.damaged)]
    last = max((i for i, chunk in enumerate(chunks) if not chunk.damaged), default=-1)
    return chunks[: last + 1]


def _records(stream: BinaryIO) -> Iterator[tuple[int, McapRecord]]:
    """Every record of the file with the place where it starts."""
    start = len(MCAP0_MAGIC)
    for record in StreamReader(stream, emit_chunks=True).records:
        yield start, record
        start = stream.tell()


def _read_chunk(start: int, end: int, record: Chunk) -> _Chunk:
    try:
        return _read_content(_Chunk(start, end, record), record)
    except _CUT_OFF:
        return _Chunk(start, end, damaged=True)


def _read_content(chunk: _Chunk, record: Chunk) -> _Chunk:
    stream, size = get_chunk_data_stream(record, validate_crc=True)
    if size != record.uncompressed_size:
        raise McapError(f"chunk at {chunk.start} is cut off")
    while (offset := stream.count) < size:
        opcode, length = stream.read1(), stream.read8()
        body = ReadDataStream(BytesIO(stream.read(length)))
        if opcode == Opcode.MESSAGE:
            chunk.take(Message.read(body, length), offset)
        elif opcode in _DESCRIBING:
            chunk.take(_DESCRIBING[opcode].read(body), offset)
    return chunk


def _replace_tail(path: Path, header_end: int, chunks: list[_Chunk]) -> None:
    """Cut the file after its last whole chunk and write what belongs there."""
    keep = chunks[-1].end if chunks else header_end
    tail = _message_index(chunks[-1]) if chunks and chunks[-1].record else b""
    tail += _bytes_of([DataEnd(0)])
    tail += _summary(chunks, summary_start=keep + len(tail))
    with path.open("r+b", buffering=0) as stream:
        stream.truncate(keep)
        stream.seek(keep)
        written = 0
        while written < len(tail):
            written += stream.write(tail[written:]) or 0


def _message_index(chunk: _Chunk) -> bytes:
    """The message index of a chunk, to be written right behind it."""
    tail = b""
    for channel, index in chunk.indices.items():
        chunk.index_offsets[channel] = chunk.end + len(tail)
        tail += _bytes_of([index])
    chunk.index_end = chunk.end + len(tail)
    return tail


def _summary(chunks: list[_Chunk], summary_start: int) -> bytes:
    schemas, channels = _schemas(chunks), _channels(chunks)
    counts = _counts(chunks)
    start, end = _span(chunks)
    indexes = [_chunk_index(chunk, chunk.record) for chunk in chunks if chunk.record]
    statistics = Statistics(
        attachment_count=0,
        channel_count=len(channels),
        channel_message_counts=dict(counts),
        chunk_count=len(indexes),
        message_count=counts.total(),
        message_end_time=end,
        message_start_time=start,
        metadata_count=0,
        schema_count=len(schemas),
    )
    body = _bytes_of([*schemas.values(), *channels.values(), *indexes, statistics])
    return body + _bytes_of([Footer(summary_start, 0, 0)]) + MCAP0_MAGIC


def _chunk_index(chunk: _Chunk, record: Chunk) -> ChunkIndex:
    return ChunkIndex(
        chunk_length=chunk.end - chunk.start,
        chunk_start_offset=chunk.start,
        compression=record.compression,
        compressed_size=len(record.data),
        message_end_time=record.message_end_time,
        message_index_length=max(0, chunk.index_end - chunk.end),
        message_index_offsets=chunk.index_offsets,
        message_start_time=record.message_start_time,
        uncompressed_size=record.uncompressed_size,
    )


def _bytes_of(records: list[Any]) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def _schemas(chunks: list[_Chunk]) -> dict[int, Schema]:
    return {key: schema for chunk in chunks for key, schema in chunk.schemas.items()}


def _channels(chunks: list[_Chunk]) -> dict[int, Channel]:
    return {key: channel for chunk in chunks for key, channel in chunk.channels.items()}


def _counts(chunks: list[_Chunk]) -> Counter[int]:
    """Messages by channel."""
    counts: Counter[int] = Counter()
    for chunk in chunks:
        counts.update({channel: len(index.records) for channel, index in chunk.indices.items()})
    return counts


def _span(chunks: list[_Chunk]) -> tuple[int, int]:
    """Log time of the first and the last message."""
    times = [time for chunk in chunks for index in chunk.indices.values() for time, _ in index.records]
    return min(times, default=0), max(times, default=0)
