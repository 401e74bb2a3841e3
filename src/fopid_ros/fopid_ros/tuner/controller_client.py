"""The running controller as the tuner sees it: a node whose parameters are read and set, all at once."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_ros.common.background import Background

GAINS = ("kp", "ki", "kd", "lam", "mu")
OF_ALL_JOINTS = ("sample_time", "mode")
"""Parameters of a controller of many joints that are not each joint's own."""
ANSWER_TIME = 3.0
"""How long the controller may take to answer [s]."""
LOOK_AGAIN = 0.05  # [s]
LONGEST_CERTIFICATE = 20_000
"""Characters that a controller keeps; a longer proof is not handed over, the gains are."""


class UnconfirmedError(InputError):
    """The controller was asked to take gains and did not answer: it may have them or not.

    Attributes
    ----------
    previous : Fopid
        The gains before.
    """

    def __init__(self, message: str, previous: Fopid) -> None:
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

    def gains(self) -> Fopid:
        """The gains in force."""
        return Fopid(*self.get(*GAINS))

    def apply(self, gains: Fopid, status: str = "", certificate: str = "") -> Fopid:
        """Hand over the gains: the controller swaps them between two ticks; the gains before.

        Parameters
        ----------
        gains : Fopid
        status : str
            ``verified``, or ``trial`` for gains that a controller which is started again must not begin with. Empty
            for gains that were in force before: the controller knows what they are.
        certificate : str
            That the gains hold the loop, where there is one; kept with them.

        Raises
        ------
        UnconfirmedError
            If the controller does not answer when it is asked to take them.
        InputError
            If it does not answer before, or refuses them.
        """
        previous = self.gains()
        provenance = {"gains.status": status, "gains.origin": self._origin} if status else {}
        if 0 < len(certificate) <= LONGEST_CERTIFICATE:
            provenance["gains.certificate"] = certificate
        self._set({**dict(zip(GAINS, gains.gains, strict=True)), **provenance}, previous)
        return previous

    def renew_trial(self) -> None:
        """Say that whoever put the gains on trial lives; nothing is waited for, since it is said again and again."""
        trial = [Parameter(self._called("gains.status"), value="trial")]
        self._background.on_executor(lambda: self._client.set_parameters_atomically(trial))

    def confirm(self, gains: Fopid) -> None:
        """The gains that were on trial hold the loop; raises as ``apply`` does, and when others are in force."""
        now = self.gains()
        if now != gains:
            raise InputError(f"the gains were changed meanwhile, to {now}; they stay")
        self._set({"gains.status": "verified"}, now)

    def _set(self, values: Mapping[str, float | str], previous: Fopid) -> None:
        parameters = [Parameter(self._called(name), value=value) for name, value in values.items()]
        answer = self._background.result(lambda: self._client.set_parameters_atomically(parameters), ANSWER_TIME)
        if answer is None:
            raise UnconfirmedError(f"{self.name!r} did not confirm", previous)
        if not answer.result.successful:
            raise InputError(f"{self.name!r} refused: {answer.result.reason}")
