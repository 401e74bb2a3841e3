"""A bag that would fill the disk is refused, and what was written of it removed; a full disk is one line."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest
import zstandard
from rosbags.rosbag2 import StoragePlugin

from fopid_core.errors import InputError
from fopid_core.study.bags import repair as repairing
from fopid_core.study.bags.files import decompress, opened

from ..recording import Recording, record_loop


def bomb(path: Path, size: int) -> Path:
    """A small file that becomes so many zeros."""
    part = bytes(10_000_000)
    with path.open("wb") as file, zstandard.ZstdCompressor().stream_writer(file) as out:
        for _ in range(size // len(part)):
            out.write(part)
    assert path.stat().st_size < size // 1_000
    return path


def test_a_small_file_that_becomes_a_huge_one_is_refused(tmp_path: Path) -> None:
    bag = bomb(tmp_path / "a.mcap.zstd", 200_000_000)
    with pytest.raises(InputError, match=r"holds more than 100,000,000 bytes"), opened(tmp_path):
        pass
    with pytest.raises(InputError):
        decompress(bag, tmp_path / "a.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap.zstd"]


def test_repair_on_a_full_disk_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recording = Recording(tmp_path / "bag", StoragePlugin.MCAP)
    record_loop(recording)
    recording.writer.close()

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(repairing, "write_metadata", full)
    with pytest.raises(InputError, match=r"cannot be repaired: .*No space left on device") as error:
        repairing.repair(tmp_path / "bag")
    assert "\n" not in str(error.value)
