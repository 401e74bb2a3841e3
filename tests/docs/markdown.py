"""The code blocks of a page, run as they stand.

A block of ``sh`` is run by bash; one after a paragraph that ends with "leave it running:" runs in the background until
the end. A block after a sentence that ends with a file's name, as in "`loop.yaml`:", becomes that file. Blocks of
``python`` make one program. Each line of a block of ``text`` must stand in what the commands before have printed, its
numbers within 2 %. What stands in a ``console`` block needs what no test has (the network, another machine).
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

BIN = Path(sys.executable).parent
PATIENCE = 300.0

_BLOCK = re.compile(r"^```(?P<kind>\w+)\n(?P<body>.*?)^```$", re.MULTILINE | re.DOTALL)
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


@dataclass(frozen=True)
class Block:
    """One block of code.

    Attributes
    ----------
    kind : str
        Its language.
    body : str
    before : str
        The last paragraph before it, in one line.
    """

    kind: str
    body: str
    before: str

    @property
    def file(self) -> str | None:
        """The file that it is, where the sentence before says so."""
        named = re.search(r"`([\w./-]+\.\w+)`:$", self.before)
        return named[1] if named and self.kind not in ("sh", "text", "console") else None

    @property
    def in_background(self) -> bool:
        """Whether it runs until the end."""
        return self.before.endswith("leave it running:")


def blocks(page: str) -> list[Block]:
    """All blocks of a page, in order."""
    found, last = [], 0
    for match in _BLOCK.finditer(page):
        paragraphs = re.split(r"\n\s*\n", page[last : match.start()].strip())
        found.append(Block(match["kind"], match["body"], " ".join(paragraphs[-1].split())))
        last = match.end()
    return found


def run(page: Path, folder: Path, environment: Mapping[str, str] | None = None) -> str:
    """Run a page in a folder; what its commands have printed."""
    surroundings = {**os.environ, **(environment or {}), "MPLBACKEND": "Agg"}
    surroundings["PATH"] = f"{BIN}:{surroundings['PATH']}"
    told, program, running = "", "", []
    try:
        for number, block in enumerate(blocks(page.read_text())):
            if block.file:
                (folder / block.file).parent.mkdir(parents=True, exist_ok=True)
                (folder / block.file).write_text(block.body)
            elif block.kind == "python":
                program += block.body
                told += _done([sys.executable, "-c", program], folder, surroundings)
            elif block.kind == "sh" and block.in_background:
                running.append(_begun(block.body, folder, surroundings, folder / f"background-{number}.log"))
            elif block.kind == "sh":
                told += _done(["bash", "-euo", "pipefail", "-c", block.body], folder, surroundings)
            elif block.kind == "text":
                for line in block.body.splitlines():
                    assert stands_in(line, told), f"{line!r} is not in\n{told}"
    finally:
        for process in running:
            os.killpg(process.pid, signal.SIGTERM)
        for process in running:
            process.wait(20)
    return told


def _done(arguments: list[str], folder: Path, environment: Mapping[str, str]) -> str:
    with subprocess.Popen(arguments, cwd=folder, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                          stderr=subprocess.PIPE, text=True, start_new_session=True) as process:  # fmt: skip
        try:
            out, errors = process.communicate(timeout=PATIENCE)
        except BaseException:
            os.killpg(process.pid, signal.SIGKILL)  # and what it has started
            raise
    logs = "".join(f"{log.name}: {log.read_text()}" for log in sorted(folder.glob("background-*.log")))
    assert process.returncode == 0, f"{arguments[-1]}\n{out}\n{errors}\n{logs}"
    return out


def _begun(command: str, folder: Path, environment: Mapping[str, str], log: Path) -> subprocess.Popen[bytes]:
    with log.open("wb") as out:
        process = subprocess.Popen(["bash", "-euc", command], cwd=folder, env=environment, stdout=out, stderr=out,
                                   stdin=subprocess.DEVNULL, start_new_session=True)  # fmt: skip
    time.sleep(1.0)
    assert process.poll() is None, log.read_text()
    return process


def stands_in(line: str, text: str) -> bool:
    """Whether a line stands in a text, whatever its blanks, with numbers within 2 % (or both next to nothing)."""
    return any(_alike(line, other) for other in text.splitlines())


def _alike(line: str, other: str) -> bool:
    if _NUMBER.sub("#", "".join(line.split())) != _NUMBER.sub("#", "".join(other.split())):
        return False
    pairs = zip(_NUMBER.findall(line), _NUMBER.findall(other), strict=False)
    return all(abs(float(a) - float(b)) <= 0.02 * abs(float(a)) + 1e-9 for a, b in pairs)
