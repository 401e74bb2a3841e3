"""Shared memory that processes which were killed have left behind.

Each participant of Fast DDS keeps its messages in a segment of /dev/shm with a random name, and holds a lock (flock) on
a file of the same name with ``_el``, which the kernel gives up with the process. A process that is killed cannot remove
its segment, and nobody else does: half a megabyte for each, until the memory is full.

The ports, ``fastrtps_port...``, are left alone: their names are few, and who listens there next takes them over.
"""

from __future__ import annotations

import fcntl
import os
import re
import stat
import time
from pathlib import Path

FOLDER = Path("/dev/shm")
YOUNGEST = 10.0
"""A segment is made first and locked then: so long [s] after it was written last it is not judged."""

_SEGMENT = re.compile(r"fast(rtps|dds)_[0-9a-f]{16}")


def remove_abandoned_segments(folder: Path = FOLDER) -> int:
    """Remove segments of this user whose owner is gone; how many there were.

    A segment goes only if its lock can be had, which is held while the files go: an owner that lives has it.
    """
    try:
        segments = [path for path in folder.iterdir() if _SEGMENT.fullmatch(path.name)]
    except FileNotFoundError:  # a system that keeps shared memory elsewhere
        return 0
    return sum(map(_removed, segments))


def _removed(segment: Path) -> bool:
    """Remove one segment if it is abandoned."""
    lock_file = segment.with_name(f"{segment.name}_el")
    try:
        if not (_may_be_judged(segment) and _may_be_judged(lock_file)):
            return False
        descriptor = os.open(lock_file, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError:  # its owner, or another one that cleans up, was quicker
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        segment.unlink(missing_ok=True)
        lock_file.unlink(missing_ok=True)
    except BlockingIOError:  # its owner lives
        return False
    finally:
        os.close(descriptor)
    return True


def _may_be_judged(path: Path) -> bool:
    """Whether it is an ordinary file of this user, and no younger than the time from making to locking."""
    status = path.lstat()
    ours = stat.S_ISREG(status.st_mode) and status.st_uid == os.geteuid()
    return ours and time.time() - status.st_mtime > YOUNGEST
