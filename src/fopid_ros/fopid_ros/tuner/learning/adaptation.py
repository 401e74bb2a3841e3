"""Learning on from normal operation: when the process has drifted from its model, new gains are proposed or applied."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from fopid_core.design.identification.drift import drift
from fopid_core.design.identification.identified_model import IdentifiedModel
from fopid_core.design.identification.identify import IdentificationResult, identify
from fopid_core.design.identification.noise import SensorNoise, sensor_noise
from fopid_core.design.identification.record import Record
from fopid_core.design.identification.sensor_faults import while_alive, without_dropouts
from fopid_core.design.response_verification import checked
from fopid_core.errors import InputError
from fopid_core.runtime.performance_monitor import LoopPerformance, PerformanceMeter
from fopid_ros.tuner.controller_client import ControllerClient
from fopid_ros.tuner.learning.gain_update import AcceptanceCriteria, GainUpdate, Outcome
from fopid_ros.tuner.learning.loop_tap import LoopTap
from fopid_ros.tuner.learning.loop_wait import LoopWait
from fopid_ros.tuner.learning.running_controller import (
    INTEGRAL_TIMES,
    RunningController,
    integral_time,
    read_running_controller,
)

CHECKS_PER_WINDOW = 4
"""How often the model is judged, while the window of signals that it is judged by passes once."""
ERROR_FACTOR = 2.0
"""By how much the mean square of the error may grow under new gains."""


class Adaptation:
    """Judges the model of the process by the signals of normal operation.

    Parameters
    ----------
    tap : LoopTap
    client : ControllerClient

    Attributes
    ----------
    model : IdentifiedModel or None
        What the process is taken for; None until something was learnt.
    message : str
        What the last look saw.
    """

    def __init__(self, tap: LoopTap, client: ControllerClient) -> None:
        self._tap, self._client = tap, client
        self.model: IdentifiedModel | None = None
        self.message = ""
        self._since = self._checked = math.inf

    def set_model(self, model: IdentifiedModel) -> None:
        """Judge this model from now on, by signals from now on."""
        self.model = model
        self._since = self._checked = self._tap.history.newest_time("control")

    def update(self, window: float, apply: bool, criteria: AcceptanceCriteria, wait: LoopWait) -> Outcome | None:
        """Learn the process when it is not known; else judge the model, and retune when the process has drifted.

        Parameters
        ----------
        window : float
            Signals to judge by [s]; 0 for 18 integral times of the present gains.
        apply : bool
            Whether new gains may be applied, or are only proposed.
        criteria : AcceptanceCriteria
            What new gains must fulfil.
        wait : LoopWait

        Returns
        -------
        Outcome or None
            None while there is nothing new.

        Raises
        ------
        InputError
            If the controller does not answer or is in manual mode, its gains show no time scale for the window, or
            several nodes publish a signal of the loop.
        CancelledError
            When asked to stop; gains under trial are taken back.
        """
        controller = read_running_controller(self._client)
        record = self._record_when_due(window or INTEGRAL_TIMES * integral_time(controller.gains))
        if record is None:
            return None
        self._tap.check_that_it_is_one_loop()
        record = without_dropouts(record)[0]
        dead = while_alive(record)[1]
        if dead:
            self.message = dead
            return None
        if self.model is None:
            return self._identify_first_model(record)
        seen = drift(self.model, record)
        self.message = seen.message
        if not seen.drifted or seen.proposal is None:
            return None
        outcome = self._retune(controller, record, seen.proposal, apply, criteria, wait)
        return replace(outcome, message=f"the process has drifted: {seen.message}; {outcome.message}")

    def _record_when_due(self, window: float) -> Record | None:
        """The newest signals, when it is time for a look."""
        if not math.isfinite(window):
            raise InputError("adapt_window = 0; allowed: above 0 s, since the present gains show no time scale")
        now = self._tap.history.newest_time("control")
        if now < self._since:  # the first look, or a clock that was set back
            self._since = self._checked = now
        if now - self._since < window or now - self._checked < window / CHECKS_PER_WINDOW:
            return None
        self._checked = now
        return self._tap.history.record(now - window)

    def _identify_first_model(self, record: Record) -> Outcome | None:
        found = checked(record, identify(record, unstable=False))
        self.message = found.message
        if found.best is None or not found.success:
            return None
        self.set_model(found.best)
        return Outcome(True, f"the process is known now: {found.message}", model=found.best)

    def _retune(
        self, controller: RunningController, record: Record, found: IdentificationResult, apply: bool,
        criteria: AcceptanceCriteria, wait: LoopWait,
    ) -> Outcome:  # fmt: skip
        gain_update = GainUpdate(self._tap, self._client, wait, controller, criteria)
        sensor, rate = sensor_of(record, found), control_rate(record, controller.pace.control)
        outcome = gain_update.design(found, sensor, control_rate=rate, record=record)
        learnt = outcome.model
        if not outcome.success or learnt is None:
            return outcome  # what was learnt is not taken over: the next look tries again
        if apply:
            try:
                figures = _figures(record, controller)
                outcome = gain_update.apply_and_monitor(outcome, figures, learnt.noise, ERROR_FACTOR)
                outcome = gain_update.kept(outcome)
            except BaseException:
                gain_update.roll_back()
                raise
        self.set_model(learnt)
        return outcome


def sensor_of(record: Record, found: IdentificationResult) -> SensorNoise:
    """The noise of the measurement; where it never rests in the record, what the learnt model leaves of it."""
    sensor = sensor_noise(record)
    if sensor.at_rest or found.best is None:
        return sensor
    return SensorNoise(found.best.noise, sensor.step)


def control_rate(record: Record, most: float) -> float:
    """How fast a unit step of the setpoint may move the control [1/s], if the largest of the record is to keep a limit.

    Examples
    --------
    >>> time = np.arange(0.0, 5.0, 0.1)
    >>> stepped = Record(time, 0.0 * time, 0.0 * time, setpoint=5.0 * (time > 1.0) - 3.0 * (time > 3.0))
    >>> control_rate(stepped, 10.0)
    2.0
    >>> control_rate(Record(time, 0.0 * time, 0.0 * time), 10.0)
    inf
    """
    step = 0.0 if record.setpoint is None else float(np.abs(np.diff(record.setpoint)).max(initial=0.0))
    return most / step if step else math.inf


def _figures(record: Record, controller: RunningController) -> LoopPerformance:
    """What the loop did over a record."""
    meter = PerformanceMeter(controller.sample_time)
    setpoint = record.measurement if record.setpoint is None else record.setpoint
    for wanted, measured, control in zip(setpoint, record.measurement, record.control, strict=True):
        meter.step(float(wanted), float(measured), controller.saturated(float(control)))
    return meter.figures
