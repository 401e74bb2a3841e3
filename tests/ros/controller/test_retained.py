"""Gains that were changed outlive the controller's process, whatever ends it, and nothing else is taken for them."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import random
import signal
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from fopid_core.errors import InputError
from fopid_ros.controller.parameters import SPECS
from fopid_ros.controller.retained import DESIGN, Retained, Retainer, _checksum, decoded, encoded, file_name

from ..conftest import Graph, only_line
from .fed import FedController

NAME = "fopid_controller"
NODE = f"/{NAME}"
DEFAULTS = {spec.name: spec.default for spec in SPECS}


def kept(**gains: float) -> Retained:
    return Retained.of(NODE, {**DEFAULTS, **gains, "gains.origin": "a test"})


def written(folder: Path, retained: Retained) -> Path:
    """The file of a retainer whose disk has confirmed it."""
    retainer = Retainer(folder, NODE)
    retainer.keep(retained)
    file, deadline = folder / file_name(NODE), time.monotonic() + 30
    while retainer.trouble and time.monotonic() < deadline:
        time.sleep(0.005)
    assert retainer.trouble == ""
    assert [path.name for path in folder.iterdir()] == [file.name]
    return file


numbers = st.floats(allow_nan=False, allow_infinity=False)
texts = st.text(max_size=300).filter(str.isprintable)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.tuples(*5 * [numbers]), st.sampled_from(["set", "verified"]), texts, st.text(max_size=500))
def test_what_is_encoded_is_decoded(gains: tuple, status: str, origin: str, certificate: str) -> None:
    values = dict(zip(("kp", "ki", "kd", "lam", "mu"), gains, strict=True))
    one = replace(kept(**values), status=status, origin=origin, certificate=certificate)
    assert decoded(encoded(one), NODE) == one


@settings(max_examples=300, deadline=None, derandomize=True)
@given(st.data())
def test_no_torn_or_changed_file_is_taken_for_gains(data: st.DataObject) -> None:
    whole = encoded(kept(kp=2.0, ki=0.5))
    broken = bytearray(whole[: data.draw(st.integers(0, len(whole) - 3))])
    if data.draw(st.booleans()):
        broken = bytearray(whole)
        place = data.draw(st.integers(0, len(whole) - 2))
        broken[place] ^= data.draw(st.integers(1, 255))
    with contextlib.suppress(InputError):
        assert decoded(bytes(broken), NODE).gains == kept(kp=2.0, ki=0.5).gains  # white space may change


def signed(**changes: object) -> bytes:
    """A file with a right checksum and something wrong in it."""
    content = {**json.loads(encoded(kept())), **changes}
    del content["sha256"]
    return json.dumps({**content, "sha256": _checksum(content)}).encode()


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (b"", "no JSON"),
        (b"\x00" * 800, "no JSON"),
        (b"[" * 60_000, "no JSON, or too deep"),
        (b'{"a":' * 10_000 + b"1" + b"}" * 10_000, "too deep"),
        (b"9" * 60_000, "no JSON"),
        (b"null", "it has not the entries"),
        (b"\xff\xfe{}", "no JSON"),
        (signed(node="/other"), "it is of '/other'; allowed: of '/fopid_controller'"),
        (signed(gains={"kp": 1.0}), "gains in it"),
        (signed(gains=dict.fromkeys(DESIGN, "1")), "kp in it; allowed: a number"),
        (signed(gains=dict.fromkeys(DESIGN, True)), "kp in it; allowed: a number"),
        (signed(origin="two\nlines"), "origin in it"),
        (signed(origin="\x1b[2J"), "origin in it"),
        (signed(origin="\ud800"), "origin in it"),
        (signed(origin=7), "origin in it"),
        (signed(certificate="a\ud800"), "certificate in it; allowed: whole characters"),
        (signed(status="certainly"), "status = 'certainly'"),
        (signed(basis=[]), "basis in it"),
    ],
    ids=itertools.count(),  # the data hold the time of day: no name for a test
)
def test_a_hostile_file_is_refused_in_one_line(tmp_path: Path, data: bytes, told: str) -> None:
    (tmp_path / file_name(NODE)).write_bytes(data)
    with pytest.raises(InputError) as refused:
        Retainer(tmp_path, NODE).read()
    assert told in str(refused.value)
    assert str(refused.value).isprintable()


def test_what_is_no_small_regular_file_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    file, retainer = tmp_path / file_name(NODE), Retainer(tmp_path, NODE)
    assert retainer.read() is None
    for make, told in (
        (lambda: os.mkfifo(file), "no regular file"),
        (lambda: file.mkdir(), "Is a directory"),
        (lambda: file.symlink_to("/dev/zero"), "symbolic links"),
        (lambda: os.truncate(os.open(file, os.O_CREAT | os.O_WRONLY), 10**12), "1000000000000 bytes"),
    ):
        make()
        with pytest.raises(InputError, match=told):
            retainer.read()
        file.rmdir() if file.is_dir() else file.unlink()


def test_a_torn_new_file_gives_way_to_the_old_one(tmp_path: Path) -> None:
    file = written(tmp_path, kept(kp=1.0))
    file.with_name(f"{file.name}.new").write_bytes(encoded(kept(kp=2.0))[:-30])
    assert Retainer(tmp_path, NODE).read().gains["kp"] == 1.0
    file.with_name(f"{file.name}.new").write_bytes(encoded(kept(kp=2.0)))
    assert Retainer(tmp_path, NODE).read().gains["kp"] == 2.0


def keep_on(folder: Path, told: int) -> None:
    """In a process of its own: keep one set of gains after another, and tell each that is kept."""
    retainer, count = Retainer(folder, NODE), 0
    while True:
        count += 1
        retainer.keep(kept(kp=float(count)))
        retainer._writer.submit(int).result()  # where the disk was so busy that nobody waited for it
        os.write(told, f"{count}\n".encode())


@pytest.mark.parametrize("rounds", [20, pytest.param(200, marks=pytest.mark.slow)])
def test_a_process_killed_at_any_instant_leaves_the_newest_gains_whole(tmp_path: Path, rounds: int) -> None:
    draw = random.Random(rounds)
    for number in range(rounds):
        folder = tmp_path / str(number)
        folder.mkdir()
        hear, tell = os.pipe()
        child = os.fork()
        if not child:
            keep_on(folder, tell)
        os.close(tell)
        time.sleep(draw.uniform(0.005, 0.08))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        with os.fdopen(hear) as lines:
            newest = int((lines.read().split() or ["0"])[-1])
        found = Retainer(folder, NODE).read()
        assert (0 if found is None else found.gains["kp"]) in (newest, newest + 1)  # told just then, or not yet


def start(graph: Graph, folder: Path, **gains: float) -> object:
    return graph.start(NAME, {"kp": 1.0, "ki": 0.1, "retain": True, "directory": str(folder), **gains})


def restart(graph: Graph, process: object, folder: Path) -> str:
    """Kill the controller and start another; what the new one says of its gains."""
    os.kill(process.pid, signal.SIGKILL)
    again = start(graph, folder)
    graph.until(lambda: "gains " in again.log.read_text(), "a line about the gains")
    return again, next(line for line in again.log.read_text().splitlines() if "gains " in line)


def test_a_restart_takes_the_newest_gains_and_says_where_they_come_from(graph: Graph, tmp_path: Path) -> None:
    first = start(graph, tmp_path)
    graph.until(lambda: "of the parameters, since none have been kept yet" in first.log.read_text(), "a line")
    told = {"gains__status": "verified", "gains__origin": "fopid_tuner: a test", "gains__certificate": "{}"}
    assert graph.set(NAME, kp=2.5, ki=0.25, **told).successful
    second, line = restart(graph, first, tmp_path)
    assert "2.5 + 0.25 s^-1 + 0 s^1, verified, from 'fopid_tuner: a test' at 20" in line
    assert "those of the parameters, 1 + 0.1 s^-1 + 0 s^1, are not used" in line

    file = tmp_path / file_name(NODE)
    file.write_bytes(file.read_bytes()[:-40])
    _, line = restart(graph, second, tmp_path)
    assert "gains 1 + 0.1 s^-1 + 0 s^1: of the parameters, since the kept ones cannot be used" in line
    assert "no JSON" in line
    assert str(tmp_path) not in line


@pytest.mark.slow
def test_a_restarted_controller_tells_its_gains_and_keeps_what_is_set_next(graph: Graph, tmp_path: Path) -> None:
    first = start(graph, tmp_path)
    told = {"gains__status": "verified", "gains__origin": "fopid_tuner: a test", "gains__certificate": "{}"}
    assert graph.set(NAME, kp=2.5, ki=0.25, **told).successful
    second, _ = restart(graph, first, tmp_path)
    graph.await_restarted(NAME)
    names = ("kp", "ki", "gains.status", "gains.origin", "gains.certificate")
    assert graph.get(NAME, *names) == [2.5, 0.25, "verified", "fopid_tuner: a test", "{}"]

    assert graph.set(NAME, kp=3.5).successful  # by somebody who does not say who
    assert graph.get(NAME, *names) == [3.5, 0.25, "set", "", ""]
    assert graph.set(NAME, kp=9.5, gains__status="trial").successful  # not known to hold the loop: not kept
    _, line = restart(graph, second, tmp_path)
    assert "3.5 + 0.25 s^-1 + 0 s^1, not verified, from 'somebody unnamed'" in line


@pytest.mark.slow
def test_a_controller_killed_at_random_instants_while_gains_change_comes_back_with_the_newest(
    graph: Graph, tmp_path: Path
) -> None:
    draw, process, count = random.Random(1), start(graph, tmp_path), 0
    for _ in range(10):
        count += 1
        graph.await_restarted(NAME)
        assert graph.set(NAME, kp=float(count)).successful
        client, until = graph.parameters(NAME), time.monotonic() + draw.uniform(0.05, 0.6)
        while time.monotonic() < until:
            count += 1
            assert graph.set(NAME, kp=float(count)).successful
        client.set_parameters_atomically([Parameter("kp", value=float(count + 1))])
        time.sleep(draw.uniform(0.0, 0.004))
        process, line = restart(graph, process, tmp_path)
        assert f"gains {count} + 0.1 s^-1" in line or f"gains {count + 1} + 0.1 s^-1" in line
        count += 1


def test_gains_on_trial_that_are_taken_back_are_what_they_were_before(graph: Graph, tmp_path: Path) -> None:
    start(graph, tmp_path)
    assert graph.set(NAME, kp=2.0, gains__status="verified", gains__origin="x").successful
    assert graph.set(NAME, kp=7.0, gains__status="trial", gains__origin="y").successful
    assert graph.get(NAME, "gains.status", "gains.origin") == ["trial", "y"]
    assert graph.set(NAME, kp=2.0).successful
    assert graph.get(NAME, "gains.status", "gains.origin") == ["verified", "x"]
    assert graph.set(NAME, kp=7.0, gains__status="trial", gains__origin="y").successful
    assert graph.set(NAME, gains__status="verified").successful
    graph.until((tmp_path / file_name(NODE)).exists, "the file")
    assert decoded((tmp_path / file_name(NODE)).read_bytes(), NODE).gains["kp"] in (2.0, 7.0)
    graph.until(lambda: Retainer(tmp_path, NODE).read().gains["kp"] == 7.0, "the confirmed ones")


@pytest.mark.parametrize("timeout", [0.0, 1.0])
def test_a_trial_that_is_taken_back_takes_its_control_with_it(graph: Graph, timeout: float) -> None:
    """Without a jump, gains too weak to bring it home were left with what wild ones had made of the control."""
    loop = FedController(graph, {"kp": 0.1, "ki": 0.01, "trial_timeout": timeout})
    loop.run(1.0, 1.0)
    assert graph.set(NAME, ki=50.0, gains__status="trial", gains__origin="y").successful
    loop.sensor = 0.5
    loop.wait(lambda state: state.ki == 50.0 and state.control > 20.0)
    if not timeout:
        assert graph.set(NAME, ki=0.01).successful
    back = loop.wait(lambda state: state.ki == 0.01)
    assert abs(back.control) < 1.0


def test_a_file_that_is_saved_has_no_gains_on_trial_and_those_that_begin_so_are_somebodys(
    graph: Graph, tmp_path: Path
) -> None:
    """They were on trial for ever after the next start: there were no others to go back to."""
    first = start(graph, tmp_path, gains_file="here.yaml", trial_timeout=1.0)
    assert graph.set(NAME, kp=2.0, gains__status="verified", gains__origin="x").successful
    assert graph.set(NAME, kp=7.0, gains__status="trial", gains__origin="y").successful
    assert graph.call(Trigger, f"{NAME}/save_gains").success
    saved = (tmp_path / "here.yaml").read_text()
    assert "\n    kp: 2.0\n" in saved
    assert "gains.status: 'verified'" in saved
    os.kill(first.pid, signal.SIGKILL)
    graph.start(NAME, {"kp": 3.0, "gains.status": "trial", "trial_timeout": 1.0})
    graph.await_restarted(NAME)
    graph.until(lambda: graph.get(NAME, "kp", "gains.status") == [3.0, "set"], "the end of the trial", 10.0)


@pytest.mark.parametrize(
    ("parameters", "told"),
    [({"retain": True}, "directory; allowed with retain"), ({"gains_file": "../x"}, "gains_file = '../x'")],
)
def test_a_start_without_a_place_to_keep_gains_ends_with_one_line(graph: Graph, parameters: dict, told: str) -> None:
    process = graph.start(NAME, parameters)
    assert process.wait(30) == 2
    assert only_line(process.log.read_text()).startswith(f"error: {told}")


def test_no_file_outside_the_directory_is_written(graph: Graph, tmp_path: Path) -> None:
    start(graph, tmp_path)
    for name in ("../up.yaml", "/tmp/absolute.yaml", "below/it.yaml", ".hidden", "..", "a\nb"):
        assert not graph.set(NAME, gains_file=name).successful
    assert not graph.set(NAME, directory="/tmp").successful
    assert graph.set(NAME, gains_file="here.yaml").successful
    answer = graph.call(Trigger, f"{NAME}/save_gains")
    assert (answer.success, answer.message) == (True, "here.yaml")
    assert "kp" in (tmp_path / "here.yaml").read_text()


@pytest.mark.slow
def test_a_design_is_kept_with_the_pace_it_needs_and_taken_back_with_it(graph: Graph, tmp_path: Path) -> None:
    """Gains that are only good behind a held pace ran "verified" without it after a restart."""
    pace = {"control_rate_max": 0.5, "setpoint_rate_max": 0.4, "deadband": 0.01}
    first = start(graph, tmp_path, trial_timeout=1.0)
    assert graph.set(NAME, kp=4.0, **pace, gains__status="verified", gains__origin="x").successful
    assert graph.set(NAME, kp=7.0, control_rate_max=0.1, deadband=0.5, gains__status="trial").successful
    graph.until(lambda: graph.get(NAME, "kp") == [4.0], "the gains from before the trial")
    assert graph.get(NAME, *pace) == [0.5, 0.4, 0.01]
    graph.until(lambda: Retainer(tmp_path, NODE).read().gains["kp"] == 4.0, "the file")
    os.kill(first.pid, signal.SIGKILL)
    start(graph, tmp_path, setpoint_rate_max=0.2)  # of a new actuator: the lower limit holds
    graph.await_restarted(NAME)
    assert graph.get(NAME, "kp", "gains.status", *pace) == [4.0, "verified", 0.5, 0.2, 0.01]


def test_a_write_that_failed_stays_told_while_the_one_before_reaches_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow, full = threading.Event(), OSError(28, "No space left on device")
    sync = os.fsync
    monkeypatch.setattr("os.fsync", lambda descriptor: (slow.wait(30), sync(descriptor)))
    retainer = Retainer(tmp_path, NODE)
    retainer.keep(kept(kp=1.0))
    write = Path.write_bytes

    def fail(path: Path, data: bytes) -> int:
        write(path, data[:10])
        raise full

    monkeypatch.setattr(Path, "write_bytes", fail)
    retainer.keep(kept(kp=2.0))
    deadline = time.monotonic() + 30
    while retainer.trouble == "being written" and time.monotonic() < deadline:
        time.sleep(0.005)
    slow.set()
    while not (tmp_path / file_name(NODE)).exists() and time.monotonic() < deadline:
        time.sleep(0.005)
    time.sleep(0.1)
    assert retainer.trouble == "No space left on device"
    assert [path.name for path in tmp_path.iterdir()] == [file_name(NODE)]
