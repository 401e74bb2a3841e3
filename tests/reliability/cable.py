"""A cable between two network namespaces that delays, loses, doubles and reorders what passes, or is cut.

As ``tc netem`` does, in a process instead of the kernel, since many kernels are built without it: each namespace has
one end, a TAP device; what goes into one end comes out of the other. ``cable.py NAMESPACE NAMESPACE`` takes one
``Impairment`` in JSON on each line of its input, and answers with a line when it is in force.
"""

from __future__ import annotations

import ctypes
import fcntl
import heapq
import json
import os
import random
import select
import struct
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

CLONE_NEWNET = 0x40000000
TUNSETIFF, IFF_TAP, IFF_NO_PI = 0x400454CA, 0x0002, 0x1000
DEVICE, LARGEST_FRAME = "cable", 65_536


@dataclass(frozen=True)
class Impairment:
    """What happens to each frame, either way.

    Attributes
    ----------
    delay, jitter : float
        Mean, and half of the width about it [s]; jitter reorders frames.
    loss, duplicate : float
        Probabilities.
    reorder : float
        Probability that a frame overtakes those that are delayed.
    cut : bool
        Nothing passes.
    """

    delay: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    cut: bool = False

    def delays(self, draw: random.Random) -> list[float]:
        """After how long each copy of a frame comes out [s]; none when it is lost.

        >>> Impairment(cut=True).delays(random.Random(1)), Impairment(delay=0.5).delays(random.Random(1))
        ([], [0.5])
        """
        if self.cut or draw.random() < self.loss:
            return []
        copies = 2 if draw.random() < self.duplicate else 1
        if draw.random() < self.reorder:
            return [0.0] * copies
        return [max(0.0, self.delay + draw.uniform(-self.jitter, self.jitter)) for _ in range(copies)]


def open_end(namespace: str, address: str) -> int:
    """Make a TAP device in a namespace and give it an address; its file descriptor."""
    libc = ctypes.CDLL(None, use_errno=True)
    with Path(f"/run/netns/{namespace}").open("rb") as there, Path("/proc/self/ns/net").open("rb") as home:
        if libc.setns(there.fileno(), CLONE_NEWNET):
            raise OSError(ctypes.get_errno(), f"cannot enter the network namespace {namespace}")
        try:
            end = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
            fcntl.ioctl(end, TUNSETIFF, struct.pack("16sH22x", DEVICE.encode(), IFF_TAP | IFF_NO_PI))
            for command in (
                "link set lo up", f"addr add {address}/24 dev {DEVICE}", f"link set {DEVICE} up",
                f"route add 224.0.0.0/4 dev {DEVICE}",
            ):  # fmt: skip
                subprocess.run(["ip", *command.split()], check=True)
        finally:
            libc.setns(home.fileno(), CLONE_NEWNET)
    return end


def carry(ends: tuple[int, int], seed: int = 1) -> None:
    """Carry frames until the input ends."""
    draw, impairment, under_way, count = random.Random(seed), Impairment(), [], 0
    while True:
        wait = max(0.0, under_way[0][0] - time.monotonic()) if under_way else None
        ready, _, _ = select.select([*ends, sys.stdin], [], [], wait)
        if sys.stdin in ready:
            line = sys.stdin.readline()
            if not line:
                return
            impairment = Impairment(**json.loads(line))
            print(time.monotonic(), flush=True)
        for end, other in (ends, ends[::-1]):
            if end in ready:
                frame = os.read(end, LARGEST_FRAME)
                for delay in impairment.delays(draw):
                    count += 1  # of two that are due at once the first goes first
                    heapq.heappush(under_way, (time.monotonic() + delay, count, other, frame))
        while under_way and under_way[0][0] <= time.monotonic():
            _, _, end, frame = heapq.heappop(under_way)
            os.write(end, frame)


if __name__ == "__main__":
    carry((open_end(sys.argv[1], "10.77.0.1"), open_end(sys.argv[2], "10.77.0.2")))
