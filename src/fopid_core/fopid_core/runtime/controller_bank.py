"""Many controllers as one: each joint has its own gains, limits and memory, and one product does all their filters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fopid_core.errors import InputError
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.operators import TICKS_BETWEEN_SWEEPS, TINY, Operators
from fopid_core.runtime.settings import ControllerSettings

Signals = tuple[float, float, float, float, float | None]
"""Setpoint, measurement, feedforward, manual control and tracking of a joint, as in ``FopidController.step``."""


class ControllerBank:
    """Controllers with one sample time and one band, whose filters are one stacked array.

    Each gives the control of a ``FopidController`` of its own, bit for bit: the control law is that one, and only the
    product of its operators is made for all joints at once.

    Parameters
    ----------
    settings : sequence of ControllerSettings
        One for each joint.

    Attributes
    ----------
    controllers : tuple of FopidController
        Their ``state``, ``hold`` and ``set_mode`` are for everybody; ticks and settings are the bank's.

    Raises
    ------
    InputError
        If there are none, or their sample times or bands differ.

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> bank = ControllerBank([ControllerSettings(Fopid(2.0)), ControllerSettings(Fopid(3.0))])
    >>> bank.step([(1.0, 0.0, 0.0, 0.0, None), (1.0, 0.5, 0.0, 0.0, None)])
    [2.0, 1.5]
    """

    def __init__(self, settings: Sequence[ControllerSettings]) -> None:
        _refuse_different(settings)
        self.controllers = tuple(FopidController(each) for each in settings)
        self._ticks = 0
        self._stack()

    def _stack(self) -> None:
        """Put all filters into one array."""
        count, width = len(self.controllers), len(self.controllers[0].operators.matrix)
        # Each matrix stands column by column, as in Operators: BLAS then takes the same way, to the same bits.
        self._matrices = np.zeros((count, width, width)).transpose(0, 2, 1)
        self._memory, self._after = np.zeros((count, width)), np.zeros((count, width))
        self._columns, self._columns_after = self._memory[:, :, np.newaxis], self._after[:, :, np.newaxis]
        self._pushed, self._outputs = self._memory[:, -3:], self._after[:, -2:]
        self._stacked: list[Operators | None] = [None] * count
        self._adopt()

    def _adopt(self) -> None:
        """Take in the filters that are not part of the stack yet."""
        for k, controller in enumerate(self.controllers):
            operators = controller.operators
            if operators is not self._stacked[k]:
                operators.keep_in(self._matrices[k], self._memory[k])
                self._stacked[k] = operators

    def reset(self) -> None:
        """Make all as new, with the same settings and modes."""
        for controller in self.controllers:
            controller.reset()

    def reconfigure(self, settings: Sequence[ControllerSettings]) -> None:
        """Change settings between two ticks, as ``FopidController.reconfigure`` does; equal ones are left alone.

        Raises
        ------
        InputError
            If there are not as many as controllers, or their sample times or bands differ: nothing is changed then.
        """
        _refuse_different(settings)
        if len(settings) != len(self.controllers):
            raise InputError(f"{len(settings)} settings; allowed: {len(self.controllers)}, one for each joint")
        for controller, each in zip(self.controllers, settings, strict=True):
            if each != controller.settings:
                controller.reconfigure(each)
        if len(self.controllers[0].operators.matrix) != self._memory.shape[1]:
            self._stack()
        else:
            self._adopt()

    def step(self, signals: Sequence[Signals | None]) -> list[float]:
        """One tick of all joints.

        Parameters
        ----------
        signals : sequence of tuples or None
            For each joint; None for one that makes no tick, since it was told to ``hold``.

        Returns
        -------
        list of float
            The controls until the next tick.

        Raises
        ------
        InputError
            If a signal is not finite, or beyond 1e100, naming the first such joint; it and all such joints are then as
            they were before the call, and the others have made their tick.
        """
        ticking: list[int] = []
        pushed: list[tuple[float, float, float]] = []
        refused = ""
        for k, each in enumerate(signals):
            if each is None:
                continue
            try:
                integrated, differentiated, correction = self.controllers[k].begin(*each)
            except InputError as error:
                refused = refused or f"joint {k}: {error}"
                continue
            ticking.append(k)
            pushed.append((correction, integrated, differentiated))
        for k, (integral, derivative) in zip(ticking, self._push(ticking, pushed), strict=True):
            self.controllers[k].finish(integral, derivative)
        if refused:
            raise InputError(refused)
        return [controller.state.control for controller in self.controllers]

    def _push(self, ticking: list[int], pushed: list[tuple[float, float, float]]) -> list[list[float]]:
        """Correct and carry on what the ticking joints remember: integral and derivative of each."""
        self._ticks += 1
        if self._ticks == TICKS_BETWEEN_SWEEPS:
            self._ticks = 0
            self._memory[np.abs(self._memory) < TINY] = 0.0
        if len(ticking) < len(self.controllers):
            return [self._push_one(k, each) for k, each in zip(ticking, pushed, strict=True)]
        self._pushed[...] = pushed
        np.matmul(self._matrices, self._columns, out=self._columns_after)
        self._memory[...] = self._after
        return self._outputs.tolist()  # type: ignore[no-any-return]

    def _push_one(self, k: int, pushed: tuple[float, float, float]) -> list[float]:
        """The same for one joint, while others stand still."""
        memory = self._memory[k]
        memory[-3:] = pushed
        memory[...] = self._matrices[k].dot(memory)
        return memory[-2:].tolist()  # type: ignore[no-any-return]


def _refuse_different(settings: Sequence[ControllerSettings]) -> None:
    if not settings:
        raise InputError("a bank of 0 controllers; allowed: 1 and more")
    first = settings[0]
    if any(each.variable_step for each in settings):
        raise InputError("variable_step = True in a bank of controllers; allowed: False, all joints tick together")
    for each in settings:
        if (each.sample_time, each.active_band) != (first.sample_time, first.active_band):
            raise InputError(
                f"sample_time = {each.sample_time}, {each.active_band} beside {first.sample_time}, "
                f"{first.active_band}; allowed: one sample time and one band for all joints"
            )
