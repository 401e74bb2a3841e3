"""Bags made without ROS and without this project's writer, by the writer of the rosbags library."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from fopid_core.model.fopid import Fopid
from fopid_core.model.process import TEST_BENCH, Process
from fopid_core.runtime.controller import ControllerSettings, FopidController, with_gains
from fopid_core.runtime.plant import Plant, PlantSettings

MESSAGES = Path(__file__).parents[3] / "src" / "fopid_msgs" / "msg"

START = Fopid(kp=1.0, ki=0.25)
BY_FREQUENCY = Fopid(kp=1.2726, ki=0.5317, kd=0.9134, lam=0.9817, mu=0.8213)
IN_TIME = Fopid(kp=3.0, ki=0.75, kd=2.6, lam=1.0, mu=1.1)
SAMPLE_TIME = 0.05
STRETCH = 30.0

EXPERIMENT = f"""\
process: P1
name: demo
sample_time: {SAMPLE_TIME}
controller:
  control_min: -10.0
  control_max: 10.0
"""


def message_types() -> Typestore:
    """The types of ROS 2 Jazzy and of fopid_msgs."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types = {}
    for path in MESSAGES.glob("*.msg"):
        types.update(get_types_from_msg(path.read_text(), f"fopid_msgs/msg/{path.stem}"))
    store.register(types)
    return store


class Recording:
    """A bag in the making, by the rosbags library."""

    def __init__(
        self,
        folder: Path,
        storage: StoragePlugin,
        namespace: str = "",
        compression: CompressionMode = CompressionMode.NONE,
    ) -> None:
        self.types = message_types()
        self.namespace = namespace
        self.writer = Writer(folder, version=9, storage_plugin=storage)
        if compression != CompressionMode.NONE:
            self.writer.set_compression(compression, CompressionFormat.ZSTD)
        self.writer.open()
        self._connections: dict[str, Any] = {}

    def header(self, time: float) -> Any:
        seconds, nanoseconds = divmod(round(time * 1e9), 10**9)
        stamp = self.types.types["builtin_interfaces/msg/Time"](seconds, nanoseconds)
        return self.types.types["std_msgs/msg/Header"](stamp, "")

    def write(self, topic: str, log_time: float, type_name: str, /, **fields: Any) -> None:
        """One message; what is not given is NaN, zero or empty."""
        name = topic if topic.startswith("/") else f"{self.namespace}/{topic}"
        if name not in self._connections:
            self._connections[name] = self.writer.add_connection(name, type_name, typestore=self.types)
        raw = self.types.serialize_cdr(self.message(type_name, **fields), type_name)
        self.writer.write(self._connections[name], round(log_time * 1e9), raw)

    def end_chunk(self) -> None:
        """Hand what was written so far to the file."""
        if self.writer.storage_plugin == StoragePlugin.MCAP and any(self.writer.counts.values()):
            self.writer.storage.close_chunk()

    def message(self, type_name: str, **fields: Any) -> Any:
        kind = self.types.types[type_name]
        _, layout = self.types.fielddefs[type_name]
        return kind(**{name: fields.get(name, self._blank(shape)) for name, shape in layout})

    def _blank(self, shape: Any) -> Any:
        kind, detail = shape
        if kind.name == "NAME":
            return self.message(detail)
        if kind.name == "BASE":
            return {"string": "", "bool": False, "float64": math.nan, "float32": math.nan}.get(detail[0], 0)
        return [] if detail[0][0].name == "NAME" or detail[0][1][0] == "string" else np.zeros(0, detail[0][1][0])

    def gains(self, controller: Fopid) -> Any:
        return self.message(
            "fopid_msgs/msg/Gains", **dict(zip(("kp", "ki", "kd", "lam", "mu"), controller.gains, strict=True))
        )


def record_loop(
    recording: Recording, origin: float = 0.0, process: str = TEST_BENCH["P1"], stretch: float = STRETCH
) -> dict[str, np.ndarray]:
    """Step, tune by frequency and step, load step, tune in time and step; what was written is returned."""
    plant = Plant(PlantSettings(Process.parse(process), sample_time=SAMPLE_TIME))
    settings = ControllerSettings(START, sample_time=SAMPLE_TIME, control_min=-10.0, control_max=10.0)
    controller = FopidController(settings)
    per_phase = round(stretch / SAMPLE_TIME)
    setpoints, loads = (1.0, 2.0, 2.0, 3.0), (0.0, 0.0, -0.5, -0.5)
    names = ("starting gains", "tuned by frequency", "load disturbance", "tuned in the time domain")
    tunings = {per_phase: ("frequency", BY_FREQUENCY), 3 * per_phase: ("time", IN_TIME)}
    rows = []
    for k in range(4 * per_phase):
        now, phase = origin + k * SAMPLE_TIME, k // per_phase
        header = recording.header(now)
        if k in tunings:
            method, gains = tunings[k]
            _record_tuning(recording, now, method, gains, controller.settings.gains, process)
            controller.reconfigure(with_gains(settings, gains))
        if k % per_phase == 0:
            recording.end_chunk()
            recording.write("experiment/phase", now, "fopid_msgs/msg/ExperimentPhase", header=header, name=names[phase])
            for topic, value in (("setpoint", setpoints[phase]), ("disturbance", loads[phase])):
                recording.write(topic, now, "fopid_msgs/msg/ScalarStamped", header=header, value=value)
        measurement = plant.measurement
        control = controller.step(setpoints[phase], measurement)
        rows.append((now, setpoints[phase], loads[phase], control, measurement))
        _record_tick(recording, now, controller, measurement)
        plant.step(control, loads[phase])
    return dict(zip(("time", "setpoint", "disturbance", "control", "measurement"), np.array(rows).T, strict=True))


def _record_tick(recording: Recording, now: float, controller: FopidController, measurement: float) -> None:
    header, state = recording.header(now), controller.state
    scalar = "fopid_msgs/msg/ScalarStamped"
    recording.write("measurement", now, scalar, header=header, value=measurement)
    recording.write("control", now, scalar, header=header, value=state.control)
    gains = dict(zip(("kp", "ki", "kd", "lam", "mu"), controller.settings.gains.gains, strict=True))
    parts = {name: getattr(state, name) for name in ("setpoint", "measurement", "error", "control", "saturated")}
    recording.write("fopid_controller/state", now, "fopid_msgs/msg/FopidState", header=header, **gains, **parts)


def _record_tuning(recording: Recording, now: float, method: str, gains: Fopid, before: Fopid, process: str) -> None:
    measures = recording.message("fopid_msgs/msg/LoopMeasures", stable=True, ms=1.5, phase_margin=math.radians(60.0))
    recording.write(
        "fopid_tuner/result", now, "fopid_msgs/msg/TuningResult", header=recording.header(now), method=method,
        process=process, success=True, applied=True, message=f"tuned by {method}", gains=recording.gains(gains),
        previous_gains=recording.gains(before), achieved=measures, unmet=[], elapsed=0.02,
    )  # fmt: skip
