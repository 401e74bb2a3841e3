"""Giving a bag that was cut off (a kill, a full disk, a crash) its index back.

An mcap file is a row of records: chunks of messages, each followed by its message index, and at the end the
index of all chunks (https://mcap.dev/spec). What was cut off in the middle is dropped, all whole chunks are kept.
"""

from __future__ import annotations

import shutil
import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import yaml
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

from fopid_core.errors import InputError
from fopid_core.study.rosbag2 import Content, read_custom_data, write_metadata

_CUT_OFF = (McapError, CRCValidationError, UnicodeDecodeError, struct.error, RuntimeError, zstandard.ZstdError)
"""What the mcap library raises where a file ends too soon or is damaged; lz4 raises RuntimeError."""


@dataclass
class _Chunk:
    """A whole chunk: where it is in the file and what is in it."""

    start: int
    end: int
    record: Chunk
    indices: dict[int, MessageIndex] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    index_offsets: dict[int, int] = field(default_factory=dict)
    index_end: int = 0


def is_whole(mcap_file: Path) -> bool:
    """Whether an mcap file was closed in good order."""
    magic = len(MCAP0_MAGIC)
    with mcap_file.open("rb") as stream:
        size = stream.seek(0, 2)
        stream.seek(max(0, size - magic))
        return size > 2 * magic and stream.read() == MCAP0_MAGIC


def repair(folder: Path) -> Content:
    """Give a bag of one mcap file a new index and ``metadata.yaml``; its custom data is kept.

    When there is no room left for the index, chunks at the end make room for it.

    Parameters
    ----------
    folder : Path
        Holds one ``.mcap`` file.

    Returns
    -------
    Content
        What the bag holds now.

    Raises
    ------
    InputError
        If there is no such file, or it is not a cut-off rosbag2 file.
    OSError
        If the disk refuses.
    """
    files = sorted(folder.glob("*.mcap"))
    if len(files) != 1:
        raise InputError(f"bag {str(folder)!r} holds {len(files)} mcap files; allowed: one")
    with files[0].open("rb") as stream:
        header_end, chunks = _whole_chunks(files[0], stream)
    custom = read_custom_data(folder)
    while True:
        try:
            _replace_tail(files[0], header_end, chunks)
            content = _content(chunks)
            write_metadata(folder, files[0].name, content, custom)
            return content
        except OSError:
            if not chunks:
                raise
            chunks.pop()


def repaired_copy(source: Path, folder: Path) -> Path:
    """A repaired copy, below ``folder``, of a cut-off bag or mcap file that stays as it is."""
    copy = folder / source.stem
    copy.mkdir()
    for path in [source] if source.is_file() else [*source.glob("*.mcap"), *source.glob("metadata.yaml")]:
        shutil.copy(path, copy)
    repair(copy)
    return copy


def _whole_chunks(path: Path, stream: BinaryIO) -> tuple[int, list[_Chunk]]:
    """The end of the file's header, and the chunks up to the first damage."""
    chunks: list[_Chunk] = []
    header_end = 0
    try:
        for start, record in _records(stream):
            if isinstance(record, Chunk):
                chunks.append(_read_chunk(start, stream.tell(), record))
            elif isinstance(record, MessageIndex) and chunks:
                chunks[-1].index_offsets[record.channel_id] = start
                chunks[-1].index_end = stream.tell()
            elif header_end == 0:
                header_end = stream.tell()
    except _CUT_OFF as error:
        if header_end == 0:
            raise InputError(f"{str(path)!r} is no mcap file, or was cut off in its first bytes: {error}") from None
    return header_end, chunks


def _records(stream: BinaryIO) -> Iterator[tuple[int, McapRecord]]:
    """Every record of the file with the place where it starts."""
    start = len(MCAP0_MAGIC)
    for record in StreamReader(stream, emit_chunks=True).records:
        yield start, record
        start = stream.tell()


def _read_chunk(start: int, end: int, record: Chunk) -> _Chunk:
    chunk = _Chunk(start, end, record)
    stream, size = get_chunk_data_stream(record, validate_crc=True)
    if size != record.uncompressed_size:
        raise McapError(f"chunk at {start} is cut off")
    while (offset := stream.count) < size:
        opcode, length = stream.read1(), stream.read8()
        body = ReadDataStream(BytesIO(stream.read(length)))
        if opcode == Opcode.MESSAGE:
            message = Message.read(body, length)
            index = chunk.indices.setdefault(message.channel_id, MessageIndex(message.channel_id, []))
            index.records.append((message.log_time, offset))
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(body)
            chunk.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(body)
            chunk.channels[channel.id] = channel
    return chunk


def _replace_tail(path: Path, header_end: int, chunks: list[_Chunk]) -> None:
    """Cut the file after its last whole chunk and write what belongs there."""
    keep = chunks[-1].end if chunks else header_end
    tail = _message_index(chunks[-1]) if chunks else b""
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
    statistics = Statistics(
        attachment_count=0,
        channel_count=len(channels),
        channel_message_counts=dict(counts),
        chunk_count=len(chunks),
        message_count=counts.total(),
        message_end_time=end,
        message_start_time=start,
        metadata_count=0,
        schema_count=len(schemas),
    )
    body = _bytes_of([*schemas.values(), *channels.values(), *map(_chunk_index, chunks), statistics])
    return body + _bytes_of([Footer(summary_start, 0, 0)]) + MCAP0_MAGIC


def _chunk_index(chunk: _Chunk) -> ChunkIndex:
    return ChunkIndex(
        chunk_length=chunk.end - chunk.start,
        chunk_start_offset=chunk.start,
        compression=chunk.record.compression,
        compressed_size=len(chunk.record.data),
        message_end_time=chunk.record.message_end_time,
        message_index_length=max(0, chunk.index_end - chunk.end),
        message_index_offsets=chunk.index_offsets,
        message_start_time=chunk.record.message_start_time,
        uncompressed_size=chunk.record.uncompressed_size,
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
    records = [chunk.record for chunk in chunks]
    if not records:
        return 0, 0
    return min(r.message_start_time for r in records), max(r.message_end_time for r in records)


def _content(chunks: list[_Chunk]) -> Content:
    schemas, counts = _schemas(chunks), _counts(chunks)
    topics = {
        channel.topic: {
            "name": channel.topic,
            "type": schemas[channel.schema_id].name,
            "serialization_format": channel.message_encoding,
            "offered_qos_profiles": yaml.safe_load(channel.metadata.get("offered_qos_profiles", "")) or [],
            "type_description_hash": channel.metadata.get("topic_type_hash", ""),
        }
        for channel in _channels(chunks).values()
    }
    by_topic = {channel.topic: counts[channel.id] for channel in _channels(chunks).values()}
    return Content(topics, by_topic, *_span(chunks))
