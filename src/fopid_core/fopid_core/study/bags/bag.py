"""Reading a run from a rosbag2 bag: mcap or sqlite3, whole or cut off, with or without ROS on the machine."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from rosbags.interfaces import Connection

from fopid_core.design.specification import Achieved
from fopid_core.errors import InputError
from fopid_core.model.arrays import Floats
from fopid_core.model.fopid import Fopid
from fopid_core.model.two_degrees import MeasurementFilter, SetpointWeights
from fopid_core.study.bags.files import bag_of, opened
from fopid_core.study.bags.topics import Recorded, read_topics
from fopid_core.study.reports.run import ParameterChange, Phase, Run, Signal, Tuning

SIGNALS = ("setpoint", "disturbance", "control", "measurement")
"""The loop's signals; the topic of that name, in whatever namespace, carries each."""

STATE, RESULT, PHASE = (f"fopid_msgs/msg/{name}" for name in ("FopidState", "TuningResult", "ExperimentPhase"))
PARAMETERS = "rcl_interfaces/msg/ParameterEvent"

SIM_TIME_LIMIT_NS = 1_000_000_000 * 10**9
"""Stamps before 2001 [ns] are of a simulated clock and kept; later ones count from the first."""

_PARAMETER_FIELDS = {
    1: "bool_value", 2: "integer_value", 3: "double_value", 4: "string_value", 5: "byte_array_value",
    6: "bool_array_value", 7: "integer_array_value", 8: "double_array_value", 9: "string_array_value",
}  # fmt: skip
"""Where ``rcl_interfaces/ParameterValue`` keeps a value of each type."""


def read_bag(
    path: Path | str,
    namespace: str | None = None,
    needed: Sequence[str] = ("control", "measurement"),
    topics: Mapping[str, str] | None = None,
) -> Run:
    """Read a run.

    Parameters
    ----------
    path : Path or str
        The folder of a bag, or of an experiment with its ``bag``, or one ``.mcap`` or ``.db3`` file.
    namespace : str, optional
        Which loop, when the bag holds several.
    needed : sequence of str
        The signals that must be there.
    topics : mapping, optional
        Signal -> its topic, where that has another name, and its field if need be: ``/oven/state:temperature``.

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
    path, named = bag_of(Path(path)), _named(topics or {})
    with opened(path) as bag:
        if namespace is None:
            namespace = _only_namespace(path, [c for c in bag.connections if c.topic not in named])
        namespace = namespace.rstrip("/")
        wanted = _topics(bag.connections, namespace, named)
        found = read_topics(bag.readers, wanted, bag.most)
        known = ", ".join(sorted({c.topic for c in bag.connections})) or "no topics"
    chosen = {f"{signal}.field": field for signal, field in named.values() if field}
    try:
        run = _run(path, namespace, found, {**bag.custom, **chosen}, bag.whole)
    except AttributeError as error:  # a type of this name as the bag defines it lacks one of its fields
        raise InputError(f"bag {str(path)!r} cannot be read: its messages lack {error.name!r}") from None
    missing = [topic for topic, (signal, _) in named.items() if signal not in found]
    missing += [f"{run.namespace}/{name}" for name in needed if name not in run.signals]
    if missing:
        raise InputError(f"bag {str(path)!r} has no messages on {missing[0]}; it has {known}")
    return run


def _named(topics: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """Topic -> the signal it was said to carry, and the field."""
    found = {}
    for signal, place in topics.items():
        if signal not in SIGNALS:
            raise InputError(f"signal {signal!r}; allowed: {', '.join(SIGNALS)}")
        topic, _, field = place.partition(":")
        found["/" + topic.lstrip("/")] = (signal, field)
    return found


def _topics(connections: Iterable[Connection], namespace: str, named: Mapping[str, tuple[str, str]]) -> dict[str, str]:
    """Topic -> the signal it carries, or its type when it tells about the loop."""
    found: dict[str, str] = {}
    elsewhere = {signal for signal, _ in named.values()}
    for c in sorted(connections, key=lambda c: c.topic):
        above, name = _above(c.topic), c.topic.rpartition("/")[2]
        if c.topic in named:
            found[c.topic] = named[c.topic][0]
        elif above == namespace and name in SIGNALS and name not in elsewhere:
            found[c.topic] = name
        elif c.msgtype == PARAMETERS or (c.msgtype in (STATE, RESULT, PHASE) and namespace in (above, _above(above))):
            found.setdefault(c.topic, c.msgtype)
    return found


def _only_namespace(path: Path, connections: Sequence[Connection]) -> str:
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


def _run(path: Path, namespace: str, found: Mapping[str, Recorded], custom: Mapping[str, str], whole: bool) -> Run:
    first = [int(found[key].stamps[0]) for key in (*SIGNALS, STATE) if key in found]
    start = min(first, default=0)
    start = 0 if start < SIM_TIME_LIMIT_NS else start
    clock = None if start else _loop_clock(found)

    def each(key: str) -> Iterator[tuple[float, Any]]:
        if key not in found:
            return iter(())
        recorded = found[key] if clock is None else found[key].on(clock, SIM_TIME_LIMIT_NS)
        return zip(_seconds(recorded, start).tolist(), recorded.objects(), strict=True)

    state = _state(found[STATE], start) if STATE in found else {}
    signals = {name: Signal(state["time"], state[name]) for name in SIGNALS if name in state}
    for name in SIGNALS:
        if name in found:
            signals[name] = _signal(found[name], start, custom.get(f"{name}.field"))
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


def _loop_clock(found: Mapping[str, Recorded]) -> Recorded | None:
    """What tells the loop's simulated time from the time of the recording."""
    return next((found[key] for key in ("measurement", "control", STATE) if key in found), None)


def _seconds(recorded: Recorded, start: int) -> Floats:
    return (recorded.stamps - start) / 1e9


def _signal(recorded: Recorded, start: int, field: str | None) -> Signal:
    field = field or _number_field(recorded)
    if field not in recorded.columns:
        raise InputError(
            f"field {field!r} of {recorded.type_name}; allowed: {', '.join(list(recorded.columns)[:20]) or 'none'}"
        )
    return Signal(_seconds(recorded, start), recorded.columns[field].astype(float))


def _number_field(recorded: Recorded) -> str:
    """Where the number of a message is: in ``value`` or ``data``, or else the first floating-point field."""
    own = {name: column for name, column in recorded.columns.items() if name.isidentifier()}
    floating = [name for name, column in own.items() if column.dtype.kind == "f"]
    for name in ("value", "data", *floating[:1]):
        if name in own:
            return name
    raise InputError(
        f"message type {recorded.type_name!r} has no number of its own; allowed: a field named in the bag, "
        f"or with the topic as in TOPIC:FIELD; it has {', '.join(list(recorded.columns)[:20])}"
    )


def _state(recorded: Recorded, start: int) -> dict[str, Floats]:
    """Every number of the controller's state as an array, and ``time``."""
    own = {name: column.astype(float) for name, column in recorded.columns.items() if name.isidentifier()}
    return {"time": _seconds(recorded, start), **own}


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
        # What the message does not tell, since it is older or has no place for it, is not known.
        achieved=Achieved(**{f.name: getattr(m.achieved, f.name, math.nan) for f in fields(Achieved)}),
        stable=m.achieved.stable,
        unmet=tuple(m.unmet),
        elapsed=m.elapsed,
        **_two_degrees(getattr(m, "two_degrees", None)),
    )


def _two_degrees(m: Any) -> dict[str, Any]:
    """Filter and setpoint weights of a design; an older message has none."""
    if m is None:
        return {}
    try:
        slow = MeasurementFilter(int(m.measurement_filter_order), m.measurement_filter_time)
        return {"filter": slow, "weights": SetpointWeights(m.setpoint_weight, m.derivative_setpoint_weight)}
    except InputError:  # of a tuning that found nothing they are NaN
        return {}


def _parameter_changes(time: float, event: Any) -> Iterator[ParameterChange]:
    for parameter in (*event.new_parameters, *event.changed_parameters):
        place = _PARAMETER_FIELDS.get(parameter.value.type)
        if place:
            yield ParameterChange(time, event.node, parameter.name, getattr(parameter.value, place))
