"""The command ``autotune`` ends when it is told to, and when its tuner is gone; what it prints is all that runs."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from fopid_msgs.msg import ScalarStamped

from ..conftest import Graph
from .test_autotune import PI, ForeignLoop

AUTOTUNE = Path(sys.executable).with_name("autotune")
SOON, LATER = 20.0, 60.0
"""A command ends so soon [s]; and so late where it must first be noticed that a process has died."""


@pytest.fixture
def loop(graph: Graph) -> ForeignLoop:
    return ForeignLoop(graph, "saturating", PI, steps=False)


@pytest.fixture
def command(loop: ForeignLoop) -> Iterator[subprocess.Popen[str]]:
    """One that is moving the loop."""
    arguments = [AUTOTUNE, "--deviation-max", "0.3", "--duration", "40", "--method", "frequency"]
    added = loop.graph.listen(ScalarStamped, "feedforward")
    begun = subprocess.Popen(
        arguments, env=loop.graph.environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    loop.graph.until(lambda: added and added[-1].value, "the excitation")
    yield begun
    begun.kill()
    begun.communicate()


@pytest.mark.slow
@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_whoever_ends_it_ends_the_experiment(loop: ForeignLoop, command: subprocess.Popen[str], ending: int) -> None:
    command.send_signal(ending)
    told, _ = command.communicate(timeout=SOON)
    assert command.returncode == 3
    assert "cancel" in told
    loop.graph.until(lambda: loop.added[-1].value == 0.0, "the end of the excitation")
    assert loop.gains()[:2] == [PI["kp"], PI["ki"]]


@pytest.mark.slow
@pytest.mark.parametrize("replaced", [False, True])
def test_a_tuner_that_dies_is_noticed(loop: ForeignLoop, command: subprocess.Popen[str], replaced: bool) -> None:
    loop.tuner.kill()
    loop.tuner.wait()
    if replaced:
        loop.graph.start("fopid_tuner", {})
    _, told = command.communicate(timeout=LATER)
    assert command.returncode == 2
    assert told.splitlines()[-1].startswith("error: the tuner is gone")
    assert ("knows nothing of this" in told) == replaced


@pytest.mark.slow
def test_one_whose_command_was_killed_is_found_and_ended_by_another(
    loop: ForeignLoop, command: subprocess.Popen[str]
) -> None:
    def asked(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [AUTOTUNE, *arguments], env=loop.graph.environment, text=True, capture_output=True, timeout=LATER
        )

    command.kill()
    told = asked()
    assert told.returncode == 2
    assert told.stderr.endswith("another autotuning is under way, which autotune --cancel ends\n")
    told = asked("--cancel")
    assert (told.returncode, told.stdout) == (0, "the autotuning under way was asked to end\n")
    loop.graph.until(lambda: loop.added[-1].value == 0.0, "the end of the excitation")
    assert loop.gains()[:2] == [PI["kp"], PI["ki"]]
    loop.graph.spin(2.0)
    told = asked("--cancel")
    assert (told.returncode, told.stdout) == (3, "no autotuning is under way\n")
