"""Giving a bag that was cut off (a kill, a full disk, a crash) its index back.

An mcap file is a row of records; the messages are in chunks, and the index of the chunks comes last
(https://mcap.dev/spec). What was cut off in the middle is dropped, all whole chunks are kept.
"""

from __future__ import annotations

import shutil
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import lz4.frame
import yaml
import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, DataEnd, Footer, Message, MessageIndex, Schema, Statistics
from mcap.stream_reader import CRCValidationError, StreamReader, get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC

from fopid_core.errors import InputError
from fopid_core.study.rosbag2 import Content, read_custom_data, write_metadata

_BROKEN = (McapError, CRCValidationError, EOFError, UnicodeDecodeError, struct.error, RuntimeError, zstandard.ZstdError)
"""What the library raises where a file is cut off; lz4 raises RuntimeError."""


def is_whole(path: Path) -> bool:
    """Whether an mcap file was closed in good order."""
    with path.open("rb") as stream:
        size = stream.seek(0, 2)
        stream.seek(max(0, size - len(MCAP0_MAGIC)))
        return size > len(MCAP0_MAGIC) and stream.read() == MCAP0_MAGIC


@dataclass
class _Chunk:
    """One whole chunk of the file."""

    start: int
    end: int
    record: Chunk
    indices: dict[int, MessageIndex] = field(default_factory=dict)
    schemas: list[Schema] = field(default_factory=list)
    channels: list[Channel] = field(default_factory=list)

    def message_index(self) -> bytes:
        """The records that follow the chunk."""
        return _bytes_of(list(self.indices.values()))

    def summary(self) -> ChunkIndex:
        offsets, position = {}, self.end
        for channel, index in self.indices.items():
            offsets[channel] = position
            position += len(_bytes_of([index]))
        return ChunkIndex(
            chunk_length=self.end - self.start,
            chunk_start_offset=self.start,
            compression=self.record.compression,
            compressed_size=len(self.record.data),
            message_end_time=self.record.message_end_time,
            message_index_length=position - self.end,
            message_index_offsets=offsets,
            message_start_time=self.record.message_start_time,
            uncompressed_size=self.record.uncompressed_size,
        )
