"""A process that is told to stop ends, whatever hangs in it."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import pytest

HANGS = """
import threading
from fopid_ros.common.spinning import StopSignal
StopSignal()
print("ready", flush=True)
while True:
    threading.Event().wait(1.0)
"""


STRUCK_AT_EACH_LINE = """
import faulthandler, os, signal, sys
from fopid_ros.common.spinning import StopSignal

def strike(*_):
    global left
    left -= 1
    if left == 0:
        os.kill(os.getpid(), signal.SIGTERM)
    return strike

for lines in range(1, 60):
    stop, left = StopSignal(), lines
    sys.settrace(strike)
    while not stop.wait(0.001):
        pass
    sys.settrace(None)
faulthandler.cancel_dump_traceback_later()
"""


STARTS_FOR_EVER = """
import time
from fopid_ros.common import spinning
from fopid_ros.common.managed_node import run_all
spinning.START_LIMIT = 1.0
run_all([lambda: time.sleep(100.0)], [])
"""


def test_a_signal_at_any_instant_of_the_wait_ends_it() -> None:
    """With an event of threading the handler waited for a lock that the thread it had interrupted held."""
    ended = subprocess.run([sys.executable, "-c", STRUCK_AT_EACH_LINE], capture_output=True, text=True, timeout=60)
    assert ended.returncode == 0, ended.stderr


@pytest.mark.slow
def test_a_process_whose_start_hangs_is_ended_outright_and_says_where() -> None:
    ended = subprocess.run([sys.executable, "-c", STARTS_FOR_EVER], capture_output=True, text=True, timeout=60)
    assert ended.returncode != 0
    assert "run_all" in ended.stderr


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_process_that_hangs_is_ended_outright_and_says_where(number: int) -> None:
    process = subprocess.Popen([sys.executable, "-c", HANGS], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stdout.readline() == "ready\n"
        told = time.monotonic()
        process.send_signal(number)
        _, traceback = process.communicate(timeout=20)
    finally:
        process.kill()
    assert process.returncode != 0
    assert "wait" in traceback
    assert 5.0 < time.monotonic() - told < 12.0
