"""The tuner's action as the page sees it: whoever started it, what it is at, what it came to.

The parts of the action are used by themselves, since a client of the whole hears of its own goals only.
"""

from __future__ import annotations

import asyncio
import math
import time
import uuid
from collections.abc import Callable
from typing import Any

from action_msgs.msg import GoalStatus, GoalStatusArray
from action_msgs.srv import CancelGoal
from rclpy.node import Node
from rclpy.qos import QoSProfile

from fopid_msgs.action import Autotune
from fopid_ros.common.managed_node import latched_qos
from fopid_ros.dashboard.remote_parameters import ANSWER_TIME, RefusedError, answer
from fopid_ros.dashboard.results import autotune_told

UNDER_WAY = (GoalStatus.STATUS_ACCEPTED, GoalStatus.STATUS_EXECUTING, GoalStatus.STATUS_CANCELING)
RESULT_TIME = 10.0  # [s] that a result may take once its goal has ended
MOST_PLANS = 100

PHASES = ("measuring", "exciting", "identifying", "tuning", "verifying", "applying", "watching")


class Autotuning:
    """Follows the autotunings of a tuner, and starts, plans and cancels them.

    Parameters
    ----------
    node : Node
    tuner : str
        Its name.
    instant : callable
        The time of the page's plots [s], None before there is one.
    tuner_lives : callable
        Whether anything is heard of the tuner.
    """

    def __init__(
        self, node: Node, tuner: str, instant: Callable[[], float | None], tuner_lives: Callable[[], bool]
    ) -> None:
        action = f"{tuner}/autotune/_action"
        self._name, self._instant, self._tuner_lives = f"{tuner}/autotune", instant, tuner_lives
        self._send = node.create_client(Autotune.Impl.SendGoalService, f"{action}/send_goal")
        self._cancel = node.create_client(CancelGoal, f"{action}/cancel_goal")
        self._get = node.create_client(Autotune.Impl.GetResultService, f"{action}/get_result")
        node.create_subscription(GoalStatusArray, f"{action}/status", self._on_status, latched_qos())
        node.create_subscription(Autotune.Impl.FeedbackMessage, f"{action}/feedback", self._on_feedback,
                                 QoSProfile(depth=10))  # fmt: skip
        self._plans: list[bytes] = []
        self._own: bytes | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._goal: bytes | None = None
        self._heard = -math.inf
        self._canceling = False
        self._stage: dict[str, Any] | None = None
        self._phases: list[dict[str, Any]] = []
        self._began = 0.0
        self.result: dict[str, Any] | None = None

    # What is heard.

    def _on_status(self, message: GoalStatusArray) -> None:
        states = {bytes(one.goal_info.goal_id.uuid): one.status for one in message.status_list}
        under_way = [goal for goal, status in states.items() if status in UNDER_WAY and goal not in self._plans]
        if under_way and under_way[-1] != self._goal:
            self._begin(under_way[-1])
        if self._goal is not None:
            self._canceling = states.get(self._goal) == GoalStatus.STATUS_CANCELING
            if states.get(self._goal) not in UNDER_WAY:
                self._end(self._goal)

    def _begin(self, goal: bytes) -> None:
        self._goal, self._began, self._heard = goal, time.monotonic(), time.monotonic()
        self._stage, self._phases, self.result = None, [], None

    def _on_feedback(self, message: Any) -> None:
        goal = bytes(message.goal_id.uuid)
        if goal in self._plans:
            return
        stage, self._heard = message.feedback, time.monotonic()
        if goal != self._goal:
            self._begin(goal)
        if not self._phases or self._phases[-1]["name"] != stage.phase:
            self._phases.append({"name": stage.phase, "from": self._instant()})
        self._stage = {name: _plain(getattr(stage, name))
                       for name in ("phase", "progress", "remaining", "deviation", "fit_pct", "message")}  # fmt: skip

    def _end(self, goal: bytes) -> None:
        self._goal = None
        task = asyncio.ensure_future(self._fetch(goal))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _fetch(self, goal: bytes) -> None:
        request = Autotune.Impl.GetResultService.Request()
        request.goal_id.uuid = list(goal)
        phase = self._phases[-1]["name"] if self._phases else ""
        try:
            got = await answer(self._get.call_async(request), self._name, RESULT_TIME, self._get.service_is_ready)
        except RefusedError as error:
            self.result = _lost(f"its result is not known: {error}")
            return
        if phase or not got.result.success:
            self.result = {**autotune_told(got.result, phase), "stamp": time.time(),
                           "canceled": got.status == GoalStatus.STATUS_CANCELED}  # fmt: skip

    def look(self) -> None:
        """See whether the tuner has died in the middle."""
        if self._goal is None or self._tuner_lives() or time.monotonic() - self._heard < ANSWER_TIME:
            return
        self._goal = None
        self.result = _lost("the tuner fell silent in the middle; the controller takes gains on trial back by itself")

    # What is told and done.

    @property
    def active(self) -> bool:
        """Whether one is under way."""
        return self._goal is not None

    def told(self) -> dict[str, Any]:
        """For the page."""
        return {
            "active": self.active, "here": self.active and self._goal == self._own, "canceling": self._canceling,
            "elapsed": int(time.monotonic() - self._began) if self.active else None,
            "stage": self._stage if self.active else None, "phases": self._phases, "result": self.result,
            "order": PHASES,
        }  # fmt: skip

    async def start(self, goal: Autotune.Goal) -> str:
        """Begin one.

        Raises
        ------
        RefusedError
            If there is no tuner, or it is busy.
        """
        if self.active:
            raise RefusedError("an autotuning is under way; cancel it first, or wait for its end")
        self._own = await self._ask(goal)
        return "autotuning has begun"

    async def plan(self, goal: Autotune.Goal) -> dict[str, Any]:
        """What a goal would do, and for how long.

        Raises
        ------
        RefusedError
            With the tuner's reason.
        """
        if self.active:
            raise RefusedError("an autotuning is under way")
        goal.plan_only = True
        request = Autotune.Impl.GetResultService.Request()
        request.goal_id.uuid = list(await self._ask(goal))
        got = await answer(self._get.call_async(request), self._name, RESULT_TIME, self._get.service_is_ready)
        if not got.result.success:
            raise RefusedError(got.result.message)
        return {"message": got.result.message, "plan": list(got.result.plan),
                "duration": _plain(got.result.expected_duration)}  # fmt: skip

    async def _ask(self, goal: Autotune.Goal) -> bytes:
        if not self._send.service_is_ready():
            raise RefusedError("the tuner is not there")
        identity = uuid.uuid4().bytes
        if goal.plan_only:
            self._plans = [*self._plans, identity][-MOST_PLANS:]
        request = Autotune.Impl.SendGoalService.Request(goal=goal)
        request.goal_id.uuid = list(identity)
        got = await answer(self._send.call_async(request), self._name, ANSWER_TIME, self._send.service_is_ready)
        if not got.accepted:
            raise RefusedError("the tuner does not accept it: it is busy with another request, or not active")
        return identity

    async def cancel(self) -> str:
        """End the one under way, whoever started it; the tuner puts everything back.

        Raises
        ------
        RefusedError
            If there is none, or the tuner does not answer.
        """
        if self._goal is None:
            raise RefusedError("no autotuning is under way")
        request = CancelGoal.Request()
        request.goal_info.goal_id.uuid = list(self._goal)
        got = await answer(self._cancel.call_async(request), self._name, ANSWER_TIME, self._cancel.service_is_ready)
        if got.return_code != CancelGoal.Response.ERROR_NONE:
            raise RefusedError("the tuner does not cancel it: it has just ended")
        return "cancelled; the tuner puts gains and control back"

    def reject(self) -> str:
        """Put the result away."""
        self.result = None
        return "rejected; nothing was changed"


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _lost(message: str) -> dict[str, Any]:
    return {"success": False, "message": message, "applied": False, "rolled_back": False, "canceled": False,
            "model": None, "models": [], "proposals": [], "gains": None, "advice": "See the tuner's log.",
            "stamp": time.time()}  # fmt: skip
