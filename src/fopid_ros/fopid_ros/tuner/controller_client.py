"""The running controller as the tuner sees it: a node whose parameters are read and set, all at once."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.two_degrees import NO_FILTER, MeasurementFilter, SetpointWeights
from fopid_core.runtime.settings import Pace
from fopid_ros.common.background import Background
from fopid_ros.common.design_parameters import DEADBAND, FILTER, GAINS, LONGEST_CERTIFICATE, PACE, WEIGHTS

OF_ALL_JOINTS = ("sample_time", "mode")
"""Parameters of a controller of many joints that are not each joint's own."""
ANSWER_TIME = 3.0
"""How long the controller may take to answer [s]."""
LOOK_AGAIN = 0.05  # [s]
RENEW_PERIOD = 0.5
"""How often the controller is told that gains on trial still have an author [s of the wall clock]."""


@dataclass(frozen=True)
class RunningDesign:
    """What a controller runs and a tuner may change, all at once.

    Attributes
    ----------
    gains : Fopid
    filter : MeasurementFilter
        Of the measurement: part of the loop, and so of what is verified.
    weights : SetpointWeights or None
        None leaves them as they are: they are not in the loop.
    pace : Pace or None
        Of control and setpoint; None leaves it as it is.
    deadband : float or None
        Errors up to this size count as none; None leaves it as it is.
    on_trial : bool
        Whether they are not known to hold the loop, so that the controller goes back to others without their author.
    """

    gains: Fopid
    filter: MeasurementFilter = NO_FILTER
    weights: SetpointWeights | None = None
    pace: Pace | None = None
    deadband: float | None = None
    on_trial: bool = field(default=False, compare=False)

    @property
    def parameters(self) -> dict[str, float | int]:
        """As the controller's parameters."""
        found: dict[str, float | int] = dict(zip(GAINS, self.gains.gains, strict=True))
        found |= dict(zip(FILTER, (self.filter.order, self.filter.time), strict=True))
        if self.weights is not None:
            found |= dict(zip(WEIGHTS, (self.weights.proportional, self.weights.derivative), strict=True))
        found |= _of_pace(self.pace) if self.pace is not None else {}
        return found if self.deadband is None else {**found, DEADBAND: self.deadband}

    def is_same_loop(self, other: RunningDesign) -> bool:
        """Whether gains and filter are the same, whatever the setpoint weights."""
        both_idle = self.filter.is_idle and other.filter.is_idle
        return self.gains == other.gains and (both_idle or self.filter == other.filter)


def _of_pace(pace: Pace) -> dict[str, float]:
    """As the controller's parameters."""
    return dict(zip(PACE, (pace.control, pace.setpoint), strict=True))


class UnconfirmedError(InputError):
    """The controller was asked to take a design and did not answer: it may have it or not.

    Attributes
    ----------
    previous : RunningDesign
        What it ran before.
    """

    def __init__(self, message: str, previous: RunningDesign) -> None:
        super().__init__(message)
        self.previous = previous


class ControllerClient:
    """Asks and changes the controller; to be called from a thread of its own, while the executor spins the node.

    Attributes
    ----------
    dof : str
        The joint that is meant of a controller of many; empty for a controller of one loop.
    """

    def __init__(self, node: Node, name: str, background: Background) -> None:
        self.name = name
        self.dof = ""
        self._background = background
        self._client = AsyncParameterClient(node, name)
        self._origin = node.get_fully_qualified_name()
        self._trial_ended, self._telling = threading.Event(), threading.Lock()

    def get(self, *names: str) -> list[Any]:
        """Values of parameters, those of the joint where there is one.

        Raises
        ------
        InputError
            If the controller does not answer, or is none of ours.
        """
        self._find()
        asked = [self._called(name) for name in names]
        answer = self._background.result(lambda: self._client.get_parameters(asked), ANSWER_TIME)
        if answer is None:
            raise InputError(f"{self.name!r} did not tell its present gains")
        values = [parameter_value_to_python(value) for value in answer.values]
        if len(values) != len(names) or any(value is None for value in values):
            joint = f" of a joint {self.dof!r}; allowed as dof: one of its dof_names" if self.dof else ""
            raise InputError(f"{self.name!r} is not a FOPID controller{joint}")
        return values

    def _called(self, name: str) -> str:
        """What the controller calls a parameter."""
        if not self.dof or name in OF_ALL_JOINTS:
            return name
        return f"gains.{self.dof}.{name.removeprefix('gains.')}"

    def _find(self) -> None:
        deadline = time.monotonic() + ANSWER_TIME
        while not self._background.value(self._client.services_are_ready, ANSWER_TIME):
            if time.monotonic() > deadline:
                raise InputError(f"no controller {self.name!r} answers")
            time.sleep(LOOK_AGAIN)

    def design(self) -> RunningDesign:
        """What is in force."""
        names = (*GAINS, *FILTER, *WEIGHTS, *PACE, DEADBAND, "gains.status")
        kp, ki, kd, lam, mu, order, time, b, c, *pace, deadband, status = self.get(*names)
        gains, slow = Fopid(kp, ki, kd, lam, mu), MeasurementFilter(order, time)
        return RunningDesign(gains, slow, SetpointWeights(b, c), Pace(*pace), deadband, status == "trial")

    def apply(self, design: RunningDesign, status: str = "", certificate: str = "") -> RunningDesign:
        """Hand over a design: the controller swaps all of it between two ticks; what it ran before.

        Parameters
        ----------
        design : RunningDesign
        status : str
            ``verified``, or ``trial`` for gains that a controller which is started again must not begin with, and goes
            back from when this process ends; they are until ``confirm`` or the next ``apply``. Empty for gains that
            were in force before: the controller knows what they are, or they are on trial again.
        certificate : str
            That the gains hold the loop, where there is one; kept with them.

        Raises
        ------
        UnconfirmedError
            If the controller does not answer when it is asked to take them.
        InputError
            If it does not answer before, or refuses them.
        """
        previous, status = self.design(), status or ("trial" if design.on_trial else "")
        provenance = {"gains.status": status, "gains.origin": self._origin} if status else {}
        if 0 < len(certificate) <= LONGEST_CERTIFICATE:
            provenance["gains.certificate"] = certificate
        self.end_trial()
        self._set({**design.parameters, **provenance}, previous)
        if status == "trial":
            self._keep_on_trial()
        return previous

    def hold(self, pace: Pace) -> None:
        """Move control and setpoint no faster than that; raises as ``apply`` does."""
        self._set(_of_pace(pace), self.design())

    def _keep_on_trial(self) -> None:
        """Say again and again that whoever put the gains on trial lives, whatever it is busy with."""
        trial, ended = [Parameter(self._called("gains.status"), value="trial")], threading.Event()

        def renew() -> None:
            while not ended.wait(RENEW_PERIOD):
                with self._telling:  # never after its end has been told
                    if not ended.is_set():
                        self._background.on_executor(lambda: self._client.set_parameters_atomically(trial))

        self._trial_ended = ended
        self._background.start("trial", renew)

    def end_trial(self) -> None:
        """No more be the author of gains on trial: where they still are, the controller goes back from them."""
        with self._telling:
            self._trial_ended.set()

    def confirm(self, design: RunningDesign) -> None:
        """The design that was on trial holds the loop; raises as ``apply`` does, and when another is in force."""
        now = self.design()
        if not now.is_same_loop(design):
            raise InputError(f"the gains were changed meanwhile, to {now.gains}, {now.filter}; they stay")
        self.end_trial()
        self._set({"gains.status": "verified"}, now)

    def _set(self, values: Mapping[str, float | int | str], previous: RunningDesign) -> None:
        parameters = [Parameter(self._called(name), value=value) for name, value in values.items()]
        answer = self._background.result(lambda: self._client.set_parameters_atomically(parameters), ANSWER_TIME)
        if answer is None:
            raise UnconfirmedError(f"{self.name!r} did not confirm", previous)
        if not answer.result.successful:
            raise InputError(f"{self.name!r} refused: {answer.result.reason}")
