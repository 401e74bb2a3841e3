"""The running controller as the tuner sees it: a node whose parameters are read and set, all at once."""

from __future__ import annotations

import threading
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.task import Future

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid

GAINS = ("kp", "ki", "kd", "lam", "mu")
ANSWER_TIME = 3.0
"""How long the controller may take to answer [s]."""


class ControllerClient:
    """Asks and changes the controller; to be called from a thread while others spin the node."""

    def __init__(self, node: Node, name: str, callback_group: CallbackGroup) -> None:
        self.name = name
        self._client = AsyncParameterClient(node, name, callback_group=callback_group)

    def get(self, *names: str) -> list[Any]:
        """Values of parameters.

        Raises
        ------
        InputError
            If the controller does not answer, or is none of ours.
        """
        if not self._client.wait_for_services(timeout_sec=ANSWER_TIME):
            raise InputError(f"no controller {self.name!r} answers")
        answer = _wait(self._client.get_parameters(list(names)))
        if answer is None:
            raise InputError(f"{self.name!r} did not tell its present gains")
        values = [parameter_value_to_python(value) for value in answer.values]
        if any(value is None for value in values):
            raise InputError(f"{self.name!r} is not a FOPID controller")
        return values

    def gains(self) -> Fopid:
        """The gains in force."""
        return Fopid(*self.get(*GAINS))

    def apply(self, gains: Fopid) -> Fopid:
        """Hand over the gains: the controller swaps them between two ticks; the gains before.

        Raises
        ------
        InputError
            If the controller does not answer or refuses them.
        """
        previous = self.gains()
        parameters = [Parameter(name, value=value) for name, value in zip(GAINS, gains.gains, strict=True)]
        answer = _wait(self._client.set_parameters_atomically(parameters))
        if answer is None:
            raise InputError(f"{self.name!r} did not confirm")
        if not answer.result.successful:
            raise InputError(f"{self.name!r} refused: {answer.result.reason}")
        return previous


def _wait(future: Future) -> Any:
    """A future's result, None if it does not come in time; the executor's other threads bring it."""
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    return future.result() if done.wait(ANSWER_TIME) else None
