"""A bag that was cut off anywhere opens again, with every whole chunk and nothing else."""

from __future__ import annotations

import shutil
import struct
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.rosbag2 import CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from fopid_core.errors import InputError
from fopid_core.study.bags.files import opened
from fopid_core.study.bags.mcap_repair import is_whole
from fopid_core.study.bags.repair import repair
from fopid_core.study.bags.rosbag2 import Topic
from fopid_core.study.bags.writer import BagWriter

CHUNK = 40
TOPICS = ("/a", "/b")


def float64(value: float) -> bytes:
    return struct.pack("<4Bd", 0, 1, 0, 0, value)


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten chunks of 40 messages, on two topics by turns."""
    folder = tmp_path_factory.mktemp("whole") / "bag"
    bag = BagWriter(folder, [Topic(name, "std_msgs/msg/Float64", "float64 data") for name in TOPICS], {"note": "kept"})
    for k in range(10 * CHUNK):
        bag.write(TOPICS[k % 2], k, float64(k))
        if (k + 1) % CHUNK == 0:
            bag.flush()
    bag.close()
    return folder


def times(bag: Path) -> list[int]:
    with Reader(bag) as reader:
        return [time for _, time, _ in reader.messages()]


def chunk_ends(path: Path) -> list[int]:
    """Where the file's chunks end, from its own index."""
    with path.open("rb") as stream:
        return [c.chunk_start_offset + c.chunk_length for c in make_reader(stream).get_summary().chunk_indexes]


@settings(derandomize=True, deadline=None, max_examples=40)
@given(share=st.floats(0.0, 1.0))
def test_all_chunks_before_the_cut_are_kept(
    original: Path, share: float, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = original / "bag.mcap"
    ends, data = chunk_ends(path), path.read_bytes()
    cut = ends[0] + round(share * (len(data) - 1 - ends[0]))
    copy = tmp_path_factory.mktemp("cut")
    (copy / "bag.mcap").write_bytes(data[:cut])
    shutil.copy(original / "metadata.yaml", copy)
    assert not is_whole(copy / "bag.mcap")
    content = repair(copy)
    assert is_whole(copy / "bag.mcap")
    expected = list(range(CHUNK * sum(end <= cut for end in ends)))
    assert times(copy) == times(copy / "bag.mcap") == expected
    assert sum(content.counts.values()) == len(expected)
    with (copy / "bag.mcap").open("rb") as stream:  # another reader, by the index alone
        assert [m.log_time for _, _, m in make_reader(stream, validate_crcs=True).iter_messages()] == expected


def test_the_repaired_bag_says_of_itself_what_the_whole_one_said_and_that_it_was_cut_off(
    original: Path, tmp_path: Path
) -> None:
    copy = tmp_path / "bag"
    shutil.copytree(original, copy)
    data = (copy / "bag.mcap").read_bytes()
    (copy / "bag.mcap").write_bytes(data[:-30])
    repair(copy)
    before, after = (yaml.safe_load((folder / "metadata.yaml").read_text()) for folder in (original, copy))
    before["rosbag2_bagfile_information"]["custom_data"]["repaired"] = "the recording was cut off or damaged"
    assert after["rosbag2_bagfile_information"] == before["rosbag2_bagfile_information"]
    with opened(copy) as bag:
        assert not bag.whole


def test_a_whole_bag_that_only_lost_its_metadata_file_is_whole_after_repair(original: Path, tmp_path: Path) -> None:
    copy = tmp_path / "bag"
    shutil.copytree(original, copy)
    (copy / "metadata.yaml").unlink()
    repair(copy)
    with opened(copy) as bag:
        assert bag.whole


@pytest.mark.parametrize("compression", [CompressionMode.NONE, CompressionMode.STORAGE])
def test_bags_of_other_writers_are_repaired_too(tmp_path: Path, compression: CompressionMode) -> None:
    writer = Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP)
    if compression != CompressionMode.NONE:
        from rosbags.rosbag2 import CompressionFormat

        writer.set_compression(compression, CompressionFormat.ZSTD)
    writer.open()
    connection = writer.add_connection("/a", "std_msgs/msg/Float64", typestore=get_typestore(Stores.ROS2_JAZZY))
    for k in range(50_000):
        writer.write(connection, k, float64(k))
    writer.close()
    path = tmp_path / "bag" / "bag.mcap"
    path.write_bytes(path.read_bytes()[:-1000])
    (tmp_path / "bag" / "metadata.yaml").unlink()
    repair(tmp_path / "bag")
    assert times(tmp_path / "bag") == list(range(50_000))


@pytest.mark.parametrize("damaged", [0, 4, 9])
def test_only_a_damaged_chunk_is_dropped(original: Path, tmp_path: Path, damaged: int) -> None:
    path = tmp_path / "bag.mcap"
    ends, data = chunk_ends(original / "bag.mcap"), bytearray((original / "bag.mcap").read_bytes())
    data[ends[damaged] - 20] ^= 0xFF
    path.write_bytes(data)
    repair(tmp_path)
    kept = [time for time in range(10 * CHUNK) if time // CHUNK != damaged]
    assert times(path) == kept
    with path.open("rb") as stream:  # another reader, by the index alone
        assert [m.log_time for _, _, m in make_reader(stream, validate_crcs=True).iter_messages()] == kept
    with opened(tmp_path) as bag:
        assert not bag.whole


def test_without_index_and_descriptions_nothing_behind_a_damaged_chunk_can_be_read(
    original: Path, tmp_path: Path
) -> None:
    ends, data = chunk_ends(original / "bag.mcap"), bytearray((original / "bag.mcap").read_bytes())
    for damaged, kept in ((0, []), (4, [time for time in range(7 * CHUNK) if time // CHUNK != 4])):
        broken = data.copy()
        broken[ends[damaged] - 20] ^= 0xFF
        (tmp_path / "bag.mcap").write_bytes(broken[: ends[6]])
        repair(tmp_path)
        assert times(tmp_path / "bag.mcap") == kept


@pytest.mark.parametrize("back", [15, 40, 200])
def test_a_damaged_index_is_made_anew(original: Path, tmp_path: Path, back: int) -> None:
    data = bytearray((original / "bag.mcap").read_bytes())
    data[-back - 30 : -back] = bytes(30)
    (tmp_path / "bag.mcap").write_bytes(data)
    repair(tmp_path)
    assert times(tmp_path / "bag.mcap") == list(range(10 * CHUNK))


@pytest.mark.parametrize("back", [1, 95, 200])  # from its end
def test_damage_within_a_bag_is_told_in_one_line(original: Path, tmp_path: Path, back: int) -> None:
    path = tmp_path / "bag.mcap"
    ends, data = chunk_ends(original / "bag.mcap"), bytearray((original / "bag.mcap").read_bytes())
    data[ends[4] - back] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"cannot be read: [^\n]+$"), opened(tmp_path) as bag:
        list(bag.readers[0].messages())


def test_reading_a_cut_off_bag_leaves_it_alone(original: Path, tmp_path: Path) -> None:
    broken = (original / "bag.mcap").read_bytes()[:-100]
    (tmp_path / "bag.mcap").write_bytes(broken)
    with opened(tmp_path) as bag:
        assert [time for reader in bag.readers for _, time, _ in reader.messages()] == list(range(10 * CHUNK))
        assert not bag.whole
    assert [path.name for path in tmp_path.iterdir()] == ["bag.mcap"]
    assert (tmp_path / "bag.mcap").read_bytes() == broken


@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\n", b"not a bag at all, but long enough to be looked at"])
def test_what_is_no_mcap_file_is_refused_and_left_alone(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "bag.mcap").write_bytes(content)
    with pytest.raises(InputError, match=r"bag\.mcap"):
        repair(tmp_path)
    assert (tmp_path / "bag.mcap").read_bytes() == content


def test_a_folder_without_an_mcap_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is no bag, it holds nothing"):
        repair(tmp_path)
