"""Reading a run from a rosbag2 bag: mcap or sqlite3, whole or cut off, with or without ROS on the machine."""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.rosbag2 import Reader, ReaderError
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from fopid_core.design.specification import Achieved
from fopid_core.errors import InputError
from fopid_core.model.arrays import Floats
from fopid_core.model.fopid import Fopid
from fopid_core.study.bag_repair import is_whole, repaired_copy
from fopid_core.study.run import ParameterChange, Phase, Run, Signal, Tuning

SIGNALS = ("setpoint", "disturbance", "control", "measurement")
"""The loop's signals; the topic of that name, in whatever namespace, carries each."""

STATE, RESULT, PHASE = (f"fopid_msgs/msg/{name}" for name in ("FopidState", "TuningResult", "ExperimentPhase"))
PARAMETERS = "rcl_interfaces/msg/ParameterEvent"

SIMULATED_BELOW = 1_000_000_000 * 10**9
"""Stamps before 2001 [ns] are of a simulated clock and kept; later ones count from the first."""

_UNREADABLE = (ReaderError, SerdeError, TypesysError, sqlite3.Error, OSError)

_PARAMETER_FIELDS = {
    1: "bool_value", 2: "integer_value", 3: "double_value", 4: "string_value", 5: "byte_array_value",
    6: "bool_array_value", 7: "integer_array_value", 8: "double_array_value", 9: "string_array_value",
}  # fmt: skip
"""Where ``rcl_interfaces/ParameterValue`` keeps a value of each type."""

Messages = list[tuple[int, Any]]
"""Messages with their instants [ns], in order."""


def read_bag(path: Path | str, namespace: str | None = None, needed: Sequence[str] = ("control", "measurement")) -> Run:
    """Read a run.

    Parameters
    ----------
    path : Path or str
        The folder of a bag, or one ``.mcap`` or ``.db3`` file.
    namespace : str, optional
        Which loop, when the bag holds several.
    needed : sequence of str
        The signals that must be there.

    Raises
    ------
    InputError
        If it is not a bag, is damaged beyond a missing end, or lacks a signal; the message names what is there.

    Examples
    --------
    >>> read_bag("no/such/bag")
    Traceback (most recent call last):
    fopid_core.errors.InputError: bag 'no/such/bag' does not exist
    """
    path = Path(path)
    with _opened(path) as (reader, whole):
        namespace = _only_namespace(path, reader.connections) if namespace is None else namespace.rstrip("/")
        messages = _messages(reader, _topics(reader.connections, namespace))
        custom = dict(reader.storage.metadata.custom or {})
        known = ", ".join(sorted(c.topic for c in reader.connections)) or "no topics"
    run = _run(path, namespace, messages, custom, whole)
    for name in needed:
        if name not in run.signals:
            raise InputError(f"bag {str(path)!r} has no messages on {run.namespace}/{name}; it has {known}")
    return run


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Reader, bool]]:
    """A reader of the bag, and whether the bag is whole."""
    if not path.exists():
        raise InputError(f"bag {str(path)!r} does not exist")
    with TemporaryDirectory() as folder:
        try:
            whole = all(map(is_whole, _mcap_files(path)))
            with Reader(_storage(path) if whole else repaired_copy(path, Path(folder))) as reader:
                yield reader, whole
        except _UNREADABLE as error:
            raise InputError(f"bag {str(path)!r} cannot be read: {' '.join(str(error).split())}") from None


def _mcap_files(path: Path) -> list[Path]:
    return sorted(path.glob("*.mcap")) if path.is_dir() else [path] * (path.suffix == ".mcap")


def _storage(path: Path) -> Path:
    """What to open: the folder, or its one file when ``metadata.yaml`` is missing."""
    if path.is_file() or (path / "metadata.yaml").exists():
        return path
    files = [*_mcap_files(path), *sorted(path.glob("*.db3"))]
    if len(files) != 1:
        names = sorted(item.name for item in path.iterdir())
        found = ", ".join(names[:5]) + (" and more" if len(names) > 5 else "") if names else "nothing"
        raise InputError(f"{str(path)!r} is no bag, it holds {found}; allowed: a folder with metadata.yaml")
    return files[0]


def _topics(connections: Iterable[Connection], namespace: str) -> dict[str, str]:
    """Topic -> the signal it carries, or its type when it tells about the loop."""
    found: dict[str, str] = {}
    for c in sorted(connections, key=lambda c: c.topic):
        above, name = _above(c.topic), c.topic.rpartition("/")[2]
        if above == namespace and name in SIGNALS:
            found[c.topic] = name
        elif c.msgtype == PARAMETERS or (c.msgtype in (STATE, RESULT, PHASE) and namespace in (above, _above(above))):
            found.setdefault(c.topic, c.msgtype)
    return found


def _only_namespace(path: Path, connections: Iterable[Connection]) -> str:
    """The namespace that a loop is in."""
    ends = {"/measurement", "/control"}
    found = {_above(c.topic) for c in connections if c.topic.removeprefix(_above(c.topic)) in ends}
    found |= {_above(_above(c.topic)) for c in connections if c.msgtype == STATE}
    if len(found) > 1:
        names = ", ".join(name or "/" for name in sorted(found))
        raise InputError(f"bag {str(path)!r} holds several loops; choose a namespace: {names}")
    return found.pop() if found else ""


def _above(name: str) -> str:
    return name.rpartition("/")[0]


def _messages(reader: Reader, topics: Mapping[str, str]) -> dict[str, Messages]:
    """Messages by what their topic carries, at the stamps they have or else at their log time."""
    wanted = [c for c in reader.connections if c.topic in topics]
    found: dict[str, Messages] = {key: [] for key in topics.values()}
    if wanted:
        types = _typestore(wanted)
        for connection, log_time, raw in reader.messages(wanted):
            found[topics[connection.topic]].append((log_time, types.deserialize_cdr(raw, connection.msgtype)))
    return {key: _at_own_stamps(messages) for key, messages in found.items()}


def _typestore(connections: Sequence[Connection]) -> Typestore:
    """The types as the bag defines them; those without a definition as ROS 2 Jazzy has them."""
    complete = all(c.msgdef.format == MessageDefinitionFormat.MSG for c in connections)
    types = {} if complete else dict(get_typestore(Stores.ROS2_JAZZY).fielddefs)
    for c in connections:
        if c.msgdef.format == MessageDefinitionFormat.MSG:
            types.update(get_types_from_msg(c.msgdef.data, c.msgtype))
    unknown = sorted({c.msgtype for c in connections} - set(types))
    if unknown:
        raise InputError(
            f"the bag has no definition of {', '.join(unknown)}; allowed: bags that hold their definitions"
        )
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    return store


def _at_own_stamps(messages: Messages) -> Messages:
    stamps = [_stamp(message) for _, message in messages]
    if not any(stamps):  # the publisher leaves them at zero, or there are none
        return messages
    return sorted(((stamp, m) for stamp, (_, m) in zip(stamps, messages, strict=True)), key=lambda pair: pair[0])


def _stamp(message: Any) -> int:
    stamp = getattr(getattr(message, "header", message), "stamp", None)
    return 0 if stamp is None else int(stamp.sec) * 10**9 + int(stamp.nanosec)


def _run(path: Path, namespace: str, messages: Mapping[str, Messages], custom: Mapping[str, str], whole: bool) -> Run:
    loop = [found[0][0] for key in (*SIGNALS, STATE) if (found := messages.get(key))]
    start = min(loop, default=0)
    start = 0 if start < SIMULATED_BELOW else start

    def each(key: str) -> Iterator[tuple[float, Any]]:
        return (((stamp - start) / 1e9, message) for stamp, message in messages.get(key, []))

    state = _columns(each(STATE))
    signals = {name: Signal(state["time"], state[name]) for name in SIGNALS if name in state}
    for name in SIGNALS:
        if messages.get(name):
            signals[name] = _signal(each(name), custom.get(f"{name}.field"))
    return Run(
        path=path,
        signals=signals,
        namespace=namespace,
        start=start,
        state=state,
        tunings=tuple(_tuning(time, message) for time, message in each(RESULT)),
        phases=tuple(Phase(time, message.name, message.description) for time, message in each(PHASE)),
        parameters=tuple(change for time, m in each(PARAMETERS) if _above(m.node) == namespace
                         for change in _parameter_changes(time, m)),
        metadata=custom,
        whole=whole,
    )  # fmt: skip


def _signal(messages: Iterable[tuple[float, Any]], path: str | None) -> Signal:
    times, numbers = zip(*messages, strict=True)
    read = _reader_of(path or _number_path(numbers[0]))
    return Signal(np.array(times), np.array([float(read(message)) for message in numbers]))


def _number_path(message: Any) -> str:
    """Where the number of a message is: in ``value`` or ``data``, or else the first floating-point field."""
    names = [f.name for f in fields(message) if not f.name.startswith("_")]
    for name in ("value", "data"):
        if name in names:
            return name
    for name in names:
        if isinstance(getattr(message, name), float):
            return name
    raise InputError(
        f"message type {message.__msgtype__!r} has no number of its own; allowed: a field named in the bag"
    )


def _reader_of(path: str) -> Callable[[Any], Any]:
    """What reads a field such as ``pose.position.x`` or ``data[2]``."""
    steps = [int(step) if step.isdigit() else step for step in re.findall(r"\w+", path)]

    def read(message: Any) -> Any:
        for step in steps:
            message = message[step] if isinstance(step, int) else getattr(message, step)
        return message

    return read


def _columns(messages: Iterable[tuple[float, Any]]) -> dict[str, Floats]:
    """Every number of the messages as an array, and ``time``; empty without messages."""
    rows = list(messages)
    if not rows:
        return {}
    first = rows[0][1]
    names = [f.name for f in fields(first) if f.name.islower() and isinstance(getattr(first, f.name), (int, float))]
    columns = {name: np.array([float(getattr(message, name)) for _, message in rows]) for name in names}
    return {"time": np.array([time for time, _ in rows]), **columns}


def _tuning(time: float, m: Any) -> Tuning:
    try:
        gains = Fopid(m.gains.kp, m.gains.ki, m.gains.kd, m.gains.lam, m.gains.mu)
    except InputError:
        gains = None
    return Tuning(
        time=time,
        method=m.method,
        process=m.process,
        success=m.success,
        applied=m.applied,
        message=m.message,
        gains=gains,
        achieved=Achieved(**{f.name: getattr(m.achieved, f.name) for f in fields(Achieved)}),
        stable=m.achieved.stable,
        unmet=tuple(m.unmet),
        elapsed=m.elapsed,
    )


def _parameter_changes(time: float, event: Any) -> Iterator[ParameterChange]:
    for parameter in (*event.new_parameters, *event.changed_parameters):
        place = _PARAMETER_FIELDS.get(parameter.value.type)
        if place:
            yield ParameterChange(time, event.node, parameter.name, getattr(parameter.value, place))
