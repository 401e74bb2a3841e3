"""A small mcap file that becomes a huge one is refused in one line, and costs no memory."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, ChunkIndex, DataEnd, Footer, Header, Schema, Statistics
from mcap.writer import MCAP0_MAGIC
from rosbags.rosbag2 import StoragePlugin

from fopid_core.errors import InputError
from fopid_core.study.bags.bag import read_bag
from fopid_core.study.bags.expansion import check_chunks, most_bytes
from fopid_core.study.bags.rosbag2 import Topic
from fopid_core.study.bags.writer import BagWriter

from ..recording import Recording, record_loop

MB = 1_000_000
RECORD = bytes([0x80]) + (80 * MB - 9).to_bytes(8, "little") + bytes(80 * MB - 9)  # of a kind that nobody knows
FRAME = zstandard.ZstdCompressor(level=1).compress(RECORD)
UNSIZED = zstandard.ZstdCompressor(level=1, write_content_size=False).compress(RECORD)
SAYS_2GB = bytes.fromhex("28b52ffd e0") + (2000 * MB).to_bytes(8, "little") + bytes.fromhex("010000")
"""A frame of zstd that is empty, and says that it holds 2 GB."""

CHUNKS = {
    "says": [("zstd", FRAME, 2000 * MB)],
    "says without being": [("zstd", SAYS_2GB, 2000 * MB)],
    "lies": [("zstd", 25 * FRAME, 80 * MB)],
    "lies in its frame": [("zstd", SAYS_2GB, 1000)],
    "does not say": [("zstd", 25 * UNSIZED, 80 * MB)],
    "many": 25 * [("zstd", FRAME, 80 * MB)],
    "lz4": [("lz4", lz4.frame.compress(bytes(600 * MB), store_size=False), MB)],
    "lz4 says": [("lz4", lz4.frame.compress(bytes(600 * MB)), MB)],
}
READ = """
import json, resource, sys
from pathlib import Path
from fopid_core.errors import InputError
from fopid_core.study.bags.bag import read_bag
from fopid_core.study.bags.repair import repair
used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + 400_000_000,) * 2)
for folder in sys.argv[1:]:
    for act in (read_bag, repair):
        try:
            act(Path(folder))
        except InputError as error:
            print(json.dumps([Path(folder).name, act.__name__, str(error)]))
"""


def mcap(path: Path, chunks: list[tuple[str, bytes, int]], times: int = 1, end: bool = True) -> None:
    """Write a file with such chunks, each ``times`` in its index, or without its end."""
    out, indexes = RecordBuilder(), []
    Header("ros2", "").write(out)
    for compression, data, size in chunks:
        start = len(MCAP0_MAGIC) + out.count
        Chunk(compression, data, 0, 1, 0, size).write(out)
        length = len(MCAP0_MAGIC) + out.count - start
        indexes += times * [ChunkIndex(length, start, compression, len(data), 1, 0, {1: start + length}, 0, size)]
    summary = len(MCAP0_MAGIC) + out.count + 13
    if end:
        types = [Schema(id=1, name="std_msgs/msg/Float64", encoding="ros2msg", data=b"float64 data")]
        topics = [Channel(id=1, schema_id=1, topic="/control", message_encoding="cdr", metadata={})]
        counts = Statistics(0, 1, {1: 1}, len(indexes), 1, 0, 0, 0, 1)
        for record in (DataEnd(0), *types, *topics, *indexes, counts, Footer(summary, 0, 0)):
            record.write(out)
    path.parent.mkdir()
    path.write_bytes(MCAP0_MAGIC + out.end() + (MCAP0_MAGIC if end else b""))


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, str], str]:
    """Bag and what was done with it -> what it was refused with."""
    folder = tmp_path_factory.mktemp("bombs")
    for name, chunks in CHUNKS.items():
        mcap(folder / name / "a.mcap", chunks)
        mcap(folder / f"{name}, cut off" / "a.mcap", chunks, end=False)
    mcap(folder / "indexed often" / "a.mcap", [("zstd", FRAME, 80 * MB)], times=25)
    for path in folder.glob("*/a.mcap"):
        assert path.stat().st_size < 3 * MB
    done = subprocess.run([sys.executable, "-c", READ, *sorted(folder.iterdir())], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return {(name, act): text for name, act, text in map(json.loads, done.stdout.splitlines())}


@pytest.mark.parametrize("act", ["read_bag", "repair"])
@pytest.mark.parametrize("name", [*CHUNKS, *(f"{name}, cut off" for name in CHUNKS)])
def test_a_chunk_that_is_or_says_2_gb_is_refused(told: dict[tuple[str, str], str], name: str, act: str) -> None:
    assert "holds more than" in told[name, act]
    assert "\n" not in told[name, act]


@pytest.mark.parametrize("act", ["read_bag", "repair"])
def test_an_index_that_names_a_chunk_many_times_is_refused(told: dict[tuple[str, str], str], act: str) -> None:
    assert "its index is not that of its chunks" in told["indexed often", act]


def test_a_message_that_says_2_gb_is_refused(tmp_path: Path) -> None:
    topics = [Topic(name, "std_msgs/msg/Float64", "float64 data") for name in ("/control", "/measurement")]
    bag = BagWriter(tmp_path / "bag", topics, {})
    bag.write("/control", 1, SAYS_2GB)
    bag.close()
    with pytest.raises(InputError, match="a message holds more than 100,000,000 bytes"):
        read_bag(tmp_path / "bag")


def test_messages_that_hold_too_much_together_are_refused(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "bag", [Topic("/control", "std_msgs/msg/String", "string data")], {})
    for time in range(2):
        bag.write("/control", time, FRAME)
    bag.close()
    with pytest.raises(InputError, match="a message holds more than 20,000,000 bytes"):
        read_bag(tmp_path / "bag")


def test_what_a_recorder_writes_passes_and_a_limit_below_it_does_not(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "bag", StoragePlugin.MCAP)
    record_loop(recording)
    recording.writer.close()
    (file,) = (tmp_path / "bag").glob("*.mcap")
    check_chunks(file, most_bytes(file.stat().st_size))
    with pytest.raises(InputError, match="holds more than 1,000 bytes"):
        check_chunks(file, 1_000)
