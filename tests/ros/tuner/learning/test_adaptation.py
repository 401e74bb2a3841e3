"""The tuner keeps learning from normal operation, and retunes when the process has drifted."""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter
from std_msgs.msg import Float64

from fopid_core.design.identification.identify import identify
from fopid_core.design.identification.record import Record
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import read_process
from fopid_core.model.stability import stability
from fopid_msgs.msg import ScalarStamped, TuningResult
from fopid_ros.common.managed_node import latched_qos
from fopid_ros.tuner.learning import adaptation
from fopid_ros.tuner.learning.adaptation import Adaptation, sensor_of

from ...conftest import SETTLE
from ..test_autotune import ForeignLoop

WINDOW = 8.0
HOLD = 150
"""Samples between two moves of the setpoint."""
DRIFTED = "2/((0.3s+1)(0.1s+1))*exp(-0.105s)"
"""Gain 2 for 1, delay 0.09 s for 0.06 s; the held control and its messages are another 15 ms late."""
QUICK = {"kp": 2.2, "ki": 6.0, "kd": 0.1}
"""Good for the process as it begins; near the border of stability on the drifted one."""


class WorkingLoop(ForeignLoop):
    """A loop in normal operation: its setpoint goes up and down."""

    _level = 0

    def __init__(self, graph: Any, **tuner: object) -> None:
        super().__init__(graph, "drifting", QUICK, **{"adapt_window": WINDOW, **tuner})
        self.results = graph.listen(TuningResult, "fopid_tuner/result", latched_qos())
        self._drift = graph.node.create_publisher(Float64, "drift", 1)
        graph.node.create_timer(0.1, self._move)

    def _move(self) -> None:
        """Up and down, by the plant's own time."""
        phase = len(self._sensed) // HOLD % 2
        if phase != self._level:
            self._level = phase
            self._setpoint.publish(ScalarStamped(value=1.0 + 0.5 * phase))

    def drift(self) -> None:
        self._drift.publish(Float64(data=1.0))

    def until_told(self, count: int) -> Any:
        self.graph.until(lambda: len(self.results) >= count, f"result {count}", 100.0)
        return self.results[count - 1]


@pytest.fixture
def working(graph: Any) -> Any:
    return partial(WorkingLoop, graph)


@pytest.mark.parametrize("stirred", [0.0, 0.02])
def test_new_gains_are_designed_for_the_noise_of_the_record_also_where_it_never_rests(stirred: float) -> None:
    time, random = np.arange(0.0, 40.0, 0.05), np.random.default_rng(3)
    noise, setpoint = 0.01 * random.standard_normal(time.size), np.where(time % 20.0 > 10.0, 1.0, 0.0)
    control = setpoint + stirred * np.cumsum(random.standard_normal(time.size))
    measurement = lfilter([0.0, 1.0 - np.exp(-0.05)], [1.0, -np.exp(-0.05)], control) + noise
    record = Record(time, control, measurement, setpoint=setpoint)
    assert sensor_of(record, identify(record)).level == pytest.approx(0.01, rel=0.15)


@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_process_whose_gain_doubles_and_whose_delay_grows_is_retuned_for(working: Any) -> None:
    loop = working(adapt="apply")
    assert "known now" in loop.until_told(1).message
    loop.graph.spin(SETTLE)
    assert loop.gains()[:3] == list(QUICK.values())
    loop.drift()
    told = loop.until_told(2)
    assert told.method == "adapt frequency"
    assert told.applied, told.message
    drifted = read_process(DRIFTED)
    before, after = Loop(drifted, Fopid(**QUICK)), Loop(drifted, Fopid(*loop.gains()))
    assert stability(after).stable
    assert margins(after).ms < 2.5 < margins(before).ms
    assert max(abs(value) for value in loop.sensed) < 3.0  # all along
    [process] = loop.graph.get("fopid_tuner", "process")
    assert process == told.process


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_tuner_that_may_only_propose_leaves_the_gains_alone(working: Any) -> None:
    loop = working(adapt="propose")
    loop.until_told(1)
    loop.drift()
    told = loop.until_told(2)
    assert told.success, told.message
    assert not told.applied
    assert told.gains.kp < QUICK["kp"]
    assert loop.gains()[:3] == list(QUICK.values())


def test_a_dead_sensor_is_no_process_that_has_drifted(monkeypatch: pytest.MonkeyPatch) -> None:
    time, noise = 0.1 * np.arange(400.0), 0.01 * np.random.default_rng(0).standard_normal(400)
    measured = np.sin(time) + noise
    measured[200:] = measured[199]
    monkeypatch.setattr(adaptation, "read_running_controller", lambda _: SimpleNamespace(gains=None))
    looks = Adaptation(SimpleNamespace(check_that_it_is_one_loop=lambda: None), None)  # type: ignore[arg-type]
    monkeypatch.setattr(looks, "_record_when_due", lambda _: Record(time, np.cos(time), measured))
    assert looks.update(10.0, apply=True, criteria=None, wait=None) is None  # type: ignore[arg-type]
    assert looks.message.endswith("is the sensor dead, or at the end of its range?")
    assert looks.model is None
