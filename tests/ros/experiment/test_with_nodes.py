"""An interrupt is never lost, whenever it comes."""

from __future__ import annotations

import subprocess
import sys

import pytest

PREAMBLE = """
import os, signal, sys
from fopid_ros.experiment.child_processes import Children
from fopid_ros.experiment.with_nodes import _watch, interruptible

def interrupt():
    os.kill(os.getpid(), signal.SIGINT)

def watched():
    with Children() as children:
        children.start("sleeper", ["sleep", "60"])
        return _watch(children)
"""
# Python ignores what callbacks of a fork and destructors raise.
WHILE_A_CHILD_STARTS = "os.register_at_fork(after_in_parent=interrupt)"
WHERE_EXCEPTIONS_ARE_IGNORED = "type('Freed', (), {'__del__': lambda self: interrupt()})()"


@pytest.mark.parametrize(
    ("when", "said"), [(WHILE_A_CHILD_STARTS, False), (WHERE_EXCEPTIONS_ARE_IGNORED, True)], ids=["fork", "destructor"]
)
def test_an_interrupt_is_heard(when: str, said: bool) -> None:
    work = f"def work():\n    {when}\n    return watched()\n\nsys.exit(interruptible(work))"
    done = subprocess.run([sys.executable, "-c", f"{PREAMBLE}\n{work}"], capture_output=True, text=True, timeout=30)
    assert done.returncode == 130
    assert ("Exception ignored" in done.stderr) == said
