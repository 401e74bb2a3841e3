"""The files of a bag, ready to be read: one or several, compressed, cut off, with or without ``metadata.yaml``."""

from __future__ import annotations

import os
import re
import shutil
import sqlite3
import struct
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import apsw
import zstandard
from mcap.exceptions import McapError
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader, ReaderError
from rosbags.typesys import TypesysError

from fopid_core.errors import InputError
from fopid_core.study.bags import mcap_repair, sqlite_repair
from fopid_core.study.bags.expansion import check_chunks, check_index, most_bytes, refused
from fopid_core.study.bags.rosbag2 import METADATA_FILE, read_custom_data, read_file_names

if sys.version_info >= (3, 14):  # rosbags reads with it, and with apsw
    from compression.zstd import ZstdError
else:
    from backports.zstd import ZstdError

STORAGES = {".mcap": "mcap", ".db3": "sqlite3"}
"""File suffix -> storage plugin."""

REPAIRED = "repaired"
"""Entry of the custom data of a bag that was cut off and has been mended."""

RECORDED = "bag"
"""The bag in the folder of an experiment."""
COMPRESSED = ".zstd"
_WINDOW = 2**27  # [bytes], what zstd itself takes without being asked

UNREADABLE = (
    ReaderError, TypesysError, McapError, apsw.Error, sqlite3.Error, ZstdError, zstandard.ZstdError, OSError,
    UnicodeDecodeError, struct.error, LookupError, ArithmeticError, MemoryError, StopIteration,
)  # fmt: skip
"""What opening or reading a damaged file may raise."""


@dataclass(frozen=True)
class BagFiles:
    """An opened bag.

    Attributes
    ----------
    readers : tuple of Reader
        One for each file, in order.
    custom : dict
        The bag's custom data: texts by name.
    whole : bool
        Whether the recording came to an orderly end.
    most : int
        How many bytes its messages may hold when they are unpacked.
    """

    readers: tuple[Reader, ...]
    custom: dict[str, str]
    whole: bool
    most: int

    @property
    def connections(self) -> list[Connection]:
        """Those of all files."""
        return [connection for reader in self.readers for connection in reader.connections]


def _entered(stack: ExitStack, file: Path) -> Reader:
    """The library's reader; of a damaged index it trips over types that it takes for granted."""
    try:
        return stack.enter_context(Reader(file))
    except (StopIteration, TypeError, AttributeError, ValueError, AssertionError) as error:
        raise ReaderError(f"{file.name} is damaged: {one_line(error) or type(error).__name__}") from None


@contextmanager
def opened(path: Path) -> Iterator[BagFiles]:
    """Open a bag's folder or one of its files; nothing in it is changed.

    Each file is read for itself: its own index and definitions are what counts, not ``metadata.yaml``, which a
    recorder that was killed has not written.

    Raises
    ------
    InputError
        If it is no bag, or damaged beyond a missing end.
    """
    if not os.access(path, os.F_OK):  # Path.exists raises for what is too long for a name
        raise InputError(f"bag {str(path)!r} does not exist")
    with TemporaryDirectory() as folder, ExitStack() as stack:
        try:
            files = files_of(path)
            prepared = [_prepared(file, Path(folder, str(i))) for i, file in enumerate(files)]
            readers = tuple([_entered(stack, file) for file in prepared])
            custom = read_custom_data(path if path.is_dir() else path.parent)
            most = most_bytes(sum(file.stat().st_size for file in files))
            yield BagFiles(readers, custom, all(map(is_whole, files)) and REPAIRED not in custom, most)
        except UNREADABLE as error:
            raise InputError(f"bag {str(path)!r} cannot be read: {one_line(error)}") from None


def bag_of(path: Path) -> Path:
    """The bag that a path means: of the folder of an experiment that in it."""
    inner = path / RECORDED
    within = os.access(inner, os.F_OK) and inner.is_dir() and not os.access(path / METADATA_FILE, os.F_OK)
    return inner if within else path


def files_of(path: Path) -> list[Path]:
    """The files that hold the messages, in order.

    Raises
    ------
    InputError
        If there are none, or one that ``metadata.yaml`` names is missing.
    """
    if path.is_file():
        return [path]
    found = [file for file in path.iterdir() if plain_name(file).suffix in STORAGES]
    # While a file is being compressed, both are there.
    found = [file for file in found if file.suffix != COMPRESSED or plain_name(file) not in found]
    if missing := [
        name for name in read_file_names(path) if path / plain_name(Path(name)) not in map(plain_name, found)
    ]:
        raise InputError(f"bag {str(path)!r} lacks its file {missing[0]!r}")
    if not found:
        names = sorted(item.name for item in path.iterdir())
        holds = ", ".join(names[:5]) + (" and more" if len(names) > 5 else "") if names else "nothing"
        raise InputError(f"{str(path)!r} is no bag, it holds {holds}; allowed: a folder with .mcap or .db3 files")
    return sorted(
        found, key=lambda file: [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", file.name)]
    )


def plain_name(file: Path) -> Path:
    """The name without the ending of a compressed file."""
    return file.with_suffix("") if file.suffix == COMPRESSED else file


def one_line(error: Exception) -> str:
    """What an error says, or what it is called when it says nothing."""
    return " ".join(str(error).split()) or type(error).__name__


def decompress(file: Path, plain: Path) -> None:
    """Write what a compressed file holds.

    Raises
    ------
    InputError
        If it holds more than a recording can be pressed into so few bytes; what was written of it is removed.
    """
    most = most_bytes(file.stat().st_size)
    written = 0
    try:
        with file.open("rb") as source, plain.open("wb") as out:
            for part in zstandard.ZstdDecompressor(max_window_size=_WINDOW).read_to_iter(source):
                written += len(part)
                if written > most:
                    raise refused(file.name, most)
                out.write(part)
    except (InputError, OSError, zstandard.ZstdError):
        plain.unlink(missing_ok=True)
        raise


def is_whole(file: Path) -> bool:
    """Whether a file of a bag was closed in good order."""
    if file.suffix == ".mcap":
        return mcap_repair.is_whole(file)
    return sqlite_repair.is_settled(file)


def _prepared(file: Path, folder: Path) -> Path:
    """The file itself, or a copy in ``folder`` that can be read."""
    most = most_bytes(file.stat().st_size)
    if file.suffix == ".mcap":
        check_chunks(file, most)
        if is_whole(file):
            check_index(file)
    if file.suffix != COMPRESSED and is_whole(file):
        return file
    folder.mkdir()
    copy = folder / plain_name(file).name
    if file.suffix == COMPRESSED:
        decompress(file, copy)
        if copy.suffix == ".mcap":
            check_chunks(copy, most)
            check_index(copy)
        return copy
    for part in (file, *sqlite_repair.besides(file)):
        shutil.copy(part, folder)
    if file.suffix == ".mcap":
        mcap_repair.repair_file(copy)
    else:
        sqlite_repair.settle(copy)
    return copy
