"""What is read from others, as bytes, and what must hold for each: an answer or one line, soon; never a traceback."""

from __future__ import annotations

import atexit
import json
import math
import shutil
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from fopid_core.errors import InputError
from fopid_core.study.bags.bag import read_bag
from fopid_core.study.experiments.experiment import read_experiment
from fopid_core.study.records import read_record

from .texts import limited, text_fault

SECONDS = 2.0
"""Of processor time, for each case of most readers."""
CONFIG = Path(__file__).parents[2] / "config"


@dataclass(frozen=True)
class Target:
    """A reader.

    Attributes
    ----------
    read : callable
        Takes the bytes; raises InputError for what it refuses, and AssertionError for a wrong answer.
    seeds : callable
        Cases to begin with.
    seconds : float
        Of processor time, for each case.
    """

    read: Callable[[bytes], object]
    seeds: Callable[[], Iterable[bytes]]
    seconds: float = SECONDS


def fault(target: Target, case: bytes) -> str:
    """What is wrong with how a case is answered; empty when nothing is."""
    try:
        with limited(target.seconds):
            target.read(case)
    except InputError as error:
        return "" if str(error) and "\n" not in str(error) else f"not one line: {error}"
    except Exception as error:  # noqa: BLE001  -- whatever it is, it is a fault
        return f"{type(error).__name__}: {error}"
    return ""


@cache
def folder() -> Path:
    """Where the cases lie as files, until this process ends."""
    made = Path(tempfile.mkdtemp(prefix="fopid_fuzzing-"))
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    return made


def _text(case: bytes) -> None:
    found = text_fault(case.decode("utf-8", "replace"))
    assert not found, found


def _experiment(case: bytes) -> None:
    file = folder() / "experiment.yaml"
    file.write_bytes(case)
    experiment = read_experiment(file)
    file.write_text(experiment.to_yaml(), encoding="utf-8")
    assert read_experiment(file).to_yaml() == experiment.to_yaml(), "does not read back as it is"


def _csv(case: bytes) -> None:
    file = folder() / "record.csv"
    file.write_bytes(case)
    record = read_record(file)
    assert all(map(math.isfinite, (*record.time, *record.control, *record.measurement))), "not finite"


@cache
def _bag_folder() -> Path:
    """A short bag, whose file the cases take the place of."""
    from rosbags.rosbag2 import StoragePlugin

    from ..core.study.recording import Recording, record_loop

    recording = Recording(folder() / "bag", StoragePlugin.MCAP)
    record_loop(recording, stretch=0.5)
    recording.writer.close()
    return folder() / "bag"


def _bag(case: bytes) -> None:
    bag = _bag_folder()
    (bag / "bag.mcap").write_bytes(case)
    read_bag(bag)


def _object(case: bytes) -> Mapping[str, Any]:
    """Fields of a message or parameters, typed as JSON; what is none has no fields."""
    try:
        given = json.loads(case)
    except (ValueError, RecursionError):
        return {}
    return given if isinstance(given, dict) else {}


def _parameters(case: bytes) -> None:
    from fopid_ros.controller import parameters

    values = {spec.name: spec.default for spec in parameters.SPECS}
    for name, value in _object(case).items():
        if isinstance(values.get(name), float) and type(value) is int and abs(value) < 1 << 63:
            value = float(value)
        if name in values and type(value) is type(values[name]):  # the middleware keeps to the type
            values[name] = value
    parameters.controller_settings(values, parameters.signal_types(values)["control"])
    parameters.check_timeouts(values)
    parameters.check_file_name(values)


def _request(case: bytes) -> None:
    from fopid_msgs.action import Autotune
    from fopid_msgs.srv import Tune
    from fopid_ros.tuner import messages, parameters

    defaults = {spec.name: spec.default for spec in parameters.SPECS}
    request, goal = Tune.Request(), Autotune.Goal()
    for name, value in _object(case).items():
        for message in (request, goal):
            if type(value) is type(getattr(message, name, None)):
                try:
                    setattr(message, name, value)
                except AssertionError:  # the message itself does not hold it
                    continue
    try:
        messages.tuning_request(request, defaults)
    finally:
        messages.autotune_request(goal, defaults)


def _message(case: bytes) -> None:
    """Bytes that somebody publishes on a topic of the loop."""
    from rclpy.serialization import deserialize_message

    from fopid_msgs.msg import FopidState, ScalarStamped
    from fopid_ros.common.cdr import Layout, fault_finder

    for kind in (ScalarStamped, FopidState):
        told = fault_finder(kind)(case)
        try:
            deserialize_message(case, kind)
        except RuntimeError:
            pass
        else:
            assert not told, "refused, though rclpy reads it"
        if not told:
            Layout(kind).unpack(case)


def _explore(case: bytes) -> None:
    """A request of the page without ROS: ``ask``, and the fields of what is asked."""
    from fopid_core.study.explore.desk import AT_THE_HAND, LONG_WORK, SEARCHES

    work = {**AT_THE_HAND, **SEARCHES, **LONG_WORK}
    fields = dict(_object(case))
    asked = fields.pop("ask", None)
    if isinstance(asked, str) and asked in work:
        json.dumps(work[asked](fields), allow_nan=False)


def _http(case: bytes) -> None:
    from .web import answer

    answered = answer(case)
    assert not answered or answered.startswith(b"HTTP/1.1 "), answered[:100]
    assert not answered.startswith(b"HTTP/1.1 5"), answered[:100]


def _files(pattern: str) -> Callable[[], list[bytes]]:
    return lambda: [path.read_bytes() for path in sorted(CONFIG.glob(pattern))]


TARGETS = {
    "text": Target(_text, lambda: [b"2/(s+1)^3*exp(-0.2s)", b"1/(0.8s^2.2+0.5s^0.9+1)", b"9/((s+1)(s^2+2s+9))", b"P1"]),
    "experiment": Target(_experiment, _files("experiments/*.yaml")),
    "csv": Target(
        _csv,
        lambda: [
            b"time,control,measurement\n0,0,0\n1,1,0\n2,1,0.5\n3,1,0.8\n",
            b"time;control;measurement;setpoint\n0;0,5;0;1\n1;1;0,1;1\n2;1;0,5;1\n",
            b"\xef\xbb\xbftime [s]\tcontrol\tmeasurement\n0\t0\t0\n1e-1\t1\t0\n2e-1\t1\tnan\n",
        ],
    ),
    "bag": Target(_bag, lambda: [(_bag_folder() / "bag.mcap").read_bytes()]),
    "message": Target(
        _message,
        lambda: [
            bytes.fromhex("00010000 03000000 04000000 05000000 6261736500000000 000000000000f03f"),
            bytes.fromhex("00000000 00000003 00000004 00000005 6261736500000000 000000000000 c004000000000000"),
            bytes.fromhex("00010000") + bytes(180),
        ],
    ),
    "parameters": Target(
        _parameters,
        lambda: [
            b'{"kp": 1.0, "ki": 0.5, "kd": 0.1, "lam": 0.9, "mu": 0.8, "sample_time": 0.01, "horizon": 50.0}',
            b'{"band.low": 0.01, "band.high": 100.0, "band.poles": 9, "control_min": -1.0, "control_max": 1.0}',
            b'{"measurement.type": "std_msgs/msg/Float64", "measurement.field": "data", "tracking_time": 1.0}',
            b'{"gains_file": "gains.yaml", "measurement_timeout": 0.1, "derivative_filter_time": 0.1, "mode": "auto"}',
        ],
    ),
    "request": Target(
        _request,
        lambda: [
            b'{"method": "frequency", "process": "1/(s+1)^3", "phase_margin": 1.2, "crossover": 0.3, "timeout": 1.0}',
            b'{"method": "time", "index": "itae", "ms_max": 1.6, "u_max": 9.0, "horizon": 40.0, "via": "nioptd2"}',
            b'{"method": "rule", "rule": "simc-pi", "t_max_db": -20.0, "t_max_frequency": 10.0, "s_max_db": -20.0}',
            b'{"excitation": "relay", "amplitude": 0.1, "deviation_max": 0.2, "duration": 9.0, "template_name": "all"}',
        ],
    ),
    "explore": Target(
        _explore,
        lambda: [
            b'{"ask": "predict", "process": "1/(s+1)^3", "sets": [{"kp": 2, "ki": 0.5, "lam": 0.9}, {"kp": 9}]}',
            b'{"ask": "predict", "process": "2/(s+1)*exp(-0.5s)", "horizon": 9.0, "quick": true, "sample_time": 0.1,'
            b' "sets": [{"kp": 1.0, "ki": 1.0, "filter_order": 2, "filter_time": 0.1, "setpoint_weight": 0.5}]}',
            *(
                b'{"ask": "take", "process": "P1", "kind": "%s", "gains": {"kp": 2, "kd": 0.5, "mu": 1.2}}' % kind
                for kind in (b"yaml", b"python", b"c")
            ),
            b'{"ask": "learn", "name": "a.csv", "columns": "PV,OP,SP", "content": "UFYsT1AsU1AKMCwwLDAKMSwxLDAK"}',
        ],
    ),
    "wishes": Target(
        _explore,
        lambda: [
            b'{"ask": "process", "process": "2/(s+1)*exp(-0.5s)", "sample_time": 0.01}',
            b'{"ask": "designs", "process": "1/(s+1)^3", "ms_max": 1.4, "effort": 2.0}',
            b'{"ask": "fronts", "process": "1/(s(s+1))", "effort": 5.0}',
        ],
        seconds=60.0,
    ),
    "http": Target(
        _http,
        lambda: [
            b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n",
            b"GET /report_page.css HTTP/1.0\r\nHost: 127.0.0.1:80\r\nIf-None-Match: *\r\nRange: bytes=1-2\r\n\r\n",
            *(
                b"POST /api/%s HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer t\r\nContent-Length: %d\r\n\r\n%s"
                % (name, len(body), body)
                for name, body in (
                    (b"parameters", b'{"kp": 1.0, "mode": "auto"}'), (b"tune", b'{"method": "time", "ms_max": 1.5}'),
                    (b"signal", b'{"signal": "setpoint", "value": 1.0}'), (b"rollback", b"{}"), (b"token", b""),
                )
            ),
            b"GET /live HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n",
        ],
    ),
}  # fmt: skip
"""By name; a case is a file, a transfer function, the JSON of parameters or of a request, or what a socket brings."""
