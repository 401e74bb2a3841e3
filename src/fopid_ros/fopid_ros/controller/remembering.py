"""What every controller node does about its gains: which it begins with, which are kept, and what ends a trial."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from fopid_core.errors import InputError
from fopid_ros.common.background import Later
from fopid_ros.common.managed_node import ManagedNode
from fopid_ros.common.parameter_file import write_parameter_file
from fopid_ros.common.parameters import converted
from fopid_ros.controller.gain_memory import GainMemory

TRIAL_LOOK_PERIOD = 0.25
"""How often it is looked whether whoever put gains on trial is still heard of [s]."""


class RememberingNode(ManagedNode):
    """A node with the gains of one loop, or of many joints; ``_values`` are its parameters while it is configured."""

    _values: dict[str, Any]

    def __init__(self, context: Context | None = None, namespace: str | None = None) -> None:
        super().__init__(context, namespace)
        try:
            self._memories = self.make_memories()
        except InputError:
            self.destroy_node()
            raise
        recalled = {name: value for one in self._memories for name, value in one.recalled(self.check).items()}
        if recalled:
            super().set_parameters_atomically(_as_parameters(recalled))

    def make_memories(self) -> tuple[GainMemory, ...]:
        """One for each set of gains; raises InputError if there is no place to keep them."""
        return (GainMemory(self),)

    def open_memories(self) -> None:
        """Offer ~/save_gains, and look after gains on trial."""
        save = self.endpoints.service(Trigger, "~/save_gains", self._on_save_gains)
        self.background.may_answer_later(save)
        self.endpoints.timer(TRIAL_LOOK_PERIOD, self._end_abandoned_trials, Clock(clock_type=ClockType.STEADY_TIME))
        self.take_gains(self._values)

    def take_gains(self, values: Mapping[str, Any]) -> None:
        """Keep the gains that have changed, but for those on trial."""
        for memory in self._memories:
            memory.take(values)

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """As in any managed node; gains that are set without a provenance lose the one of those before."""
        changes = {change.name: change.value for change in converted(self._specs, parameter_list)}
        for memory in self._memories:
            memory.hear_of_trial(changes)
            changes = memory.with_provenance(changes)
        return super().set_parameters_atomically(_as_parameters(changes))

    def _end_abandoned_trials(self) -> None:
        """Gains on trial die with their author, as what it adds to the control does."""
        for memory in self._memories:
            before = memory.before_abandoned_trial(self._values)
            if before:
                self.set_parameters_atomically(_as_parameters(before))

    def memory_problems(self) -> list[tuple[bytes, str]]:
        """For the diagnostics."""
        return [(DiagnosticStatus.WARN, one.trouble) for one in self._memories if one.trouble]

    def memory_facts(self, values: Mapping[str, Any]) -> dict[str, object]:
        """For the diagnostics."""
        return {name: fact for one in self._memories for name, fact in one.facts(values).items()}

    def _on_save_gains(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response | Later:
        """Write the parameters, with the gains from before where others are on trial; a disk may take its time."""
        values = self._values
        directory, name = values["directory"], values["gains_file"]
        if not directory or not name:
            response.message = (
                f"directory = {directory!r}, gains_file = {name!r}; allowed: a folder, given at start, and a file in it"
            )
            return response
        if Path(directory, name).resolve().parent != Path(directory).resolve():
            response.message = f"gains_file = {name!r} is a link out of directory; allowed: a file in it"
            return response
        everything = {name: self.get_parameter(name).value for name in self.get_parameters_by_prefix("")}
        for memory in self._memories:
            everything |= memory.lasting(everything)
        later = Later(self.background)

        def write() -> None:
            try:
                write_parameter_file(Path(directory, name), self.get_fully_qualified_name(), everything)
            except OSError as error:
                response.message = f"gains_file = {name!r}: {error.strerror}; nothing was changed"
            else:
                response.success, response.message = True, name
            later.give(response)

        self.background.start("save_gains", write)
        return later


def _as_parameters(values: Mapping[str, Any]) -> list[Parameter]:
    return [Parameter(name, value=value) for name, value in values.items()]
