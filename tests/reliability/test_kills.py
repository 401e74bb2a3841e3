"""Each node is killed, stopped and restarted at random instants while it, or another, is at work."""

from __future__ import annotations

import math
import random
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import pytest
from rclpy.action import ActionClient
from rclpy.task import Future

from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import read_process
from fopid_core.model.stability import stability
from fopid_msgs.action import Autotune
from fopid_msgs.srv import Tune

from ..share import share_of
from .record import gone_at, longest_silence, outside_limits, settled_at
from .rig import LIMITS, PROCESS, SETPOINT, STATE, Rig

INSTANTS = 200
"""For each node."""
CHUNKS = 2
LONGEST = {"idle": 0.2, "tuning": 2.0, "applying": 0.6, "autotuning": 12.0}
"""Works, and the time within which the blow falls [s]."""
OFTEN = {"idle": 1, "tuning": 1, "applying": 2, "autotuning": 2}
BLOWS = ("kill", "stop", "restart")
BAND = 0.35
"""About the setpoint: an autotuning may move the loop by 0.3."""
BACK, ADDEND_GONE, TRIAL_GONE = 10.0, 1.5, 5.0
"""Within these times the loop is back, an addend without author is gone, a trial without author is over [s]: what
docs/fail_safe.md promises (1 s, 3 s), and what a busy machine takes to start a process and to notice."""
SILENT = 2.0
"""No controller is silent for longer because another node was struck [s]; it ticks every 10 ms. That is the machine's
business: eight loops on two cores; a neighbour's lock in shared memory would last for good."""
ANSWER = 60.0
"""A tuner that lives answers within that, also after it was stopped or while the controller is away [s]."""
NAMES = ("kp", "ki", "kd", "lam", "mu")


@dataclass
class Tally:
    """What was seen."""

    recovered: list[float] = field(default_factory=list)
    addends: list[float] = field(default_factory=list)
    silences: list[float] = field(default_factory=list)
    controls: int = 0
    lowest: float = math.inf
    highest: float = -math.inf
    blows: dict[str, int] = field(default_factory=dict)


class Campaign:
    """Blows against one node of a loop at work."""

    def __init__(self, rig: Rig, victim: str, draw: random.Random) -> None:
        self.rig, self.graph, self.victim, self.draw = rig, rig.graph, victim, draw
        self.tally = Tally()
        self._tune = self.graph.client(Tune, "fopid_tuner/tune")
        self._autotune = ActionClient(self.graph.node, Autotune, "fopid_tuner/autotune")
        self._former: list[list[float]] = []

    def gains(self) -> tuple[list[float], str]:
        *gains, status = self.graph.get("fopid_controller", *NAMES, "gains.status")
        return gains, status

    def instant(self) -> None:
        """One blow, and all that is promised after it."""
        rig, blow = self.rig, self.draw.choice(BLOWS)
        (work,) = self.draw.choices(list(OFTEN), list(OFTEN.values()))
        before, _ = self.gains()
        began = time.monotonic()
        asked, goal = self._begin(work)
        self.graph.spin(self.draw.uniform(0.0, LONGEST[work]))
        struck, ended, back = self._strike(blow)
        what = f"{work}, {blow} of {self.victim} at {struck:.3f}"
        settled = rig.wait(
            lambda: settled_at(rig.samples("measurement", back), SETPOINT, BAND, 0.3)
            if rig.samples("control", back) else None, f"the loop is back after {what}", BACK,
        )  # fmt: skip
        self.tally.recovered.append(max(0.0, settled - back))
        self._addend_is_gone(ended, blow, what)
        self._end(asked, goal, answers=self.victim != "fopid_tuner" or blow == "stop", what=what)
        self._gains_are_as_promised(before, work, what)
        self._controls_are_within_limits(began, what)
        self._controls_went_on(struck, back, what)
        key = f"{work}, {blow}"
        self.tally.blows[key] = self.tally.blows.get(key, 0) + 1

    def _begin(self, work: str) -> tuple[Future | None, Any]:
        """The answer to come, and the goal that it belongs to."""
        if work == "idle":
            return None, None
        if work == "autotuning":
            goal = self._accepted_goal()
            return goal.get_result_async(), goal
        margin = self.draw.uniform(1.1, 1.35)
        wanted = {"phase_margin": margin, "crossover": 6.0} if work == "applying" else {"method": "time"}
        return self._tune.call_async(Tune.Request(process=PROCESS, apply=work == "applying", **wanted)), None

    def _accepted_goal(self) -> Any:
        """A goal is sent until a tuner accepts it: a killed one is listed for a while yet, a busy one ends its work."""
        deadline = time.monotonic() + 60.0
        while time.monotonic() < deadline:
            sent: Future = self._autotune.send_goal_async(Autotune.Goal(method="frequency", deviation_max=0.3))
            self.graph.executor.spin_until_future_complete(sent, timeout_sec=2.0)
            if sent.done() and sent.result().accepted:
                return sent.result()
            self.graph.spin(0.5)
        raise AssertionError(f"no tuner accepts a goal; logs: {self.rig.logs()}")

    def _strike(self, blow: str) -> tuple[float, float, float]:
        """When it was struck, when it had ended, and from when on it is there again [s]."""
        node = self.rig.nodes[self.victim]
        struck = ended = time.monotonic()
        if blow == "stop":
            node.send_signal(signal.SIGSTOP)
            self.graph.spin(self.draw.uniform(0.1, 3.0))
            node.send_signal(signal.SIGCONT)
        else:
            node.kill() if blow == "kill" else node.terminate()
            node.wait(15)
            ended = time.monotonic()
            self.graph.spin(self.draw.uniform(0.0, 1.0))
            self.rig.start(self.victim)
        return struck, ended, time.monotonic()

    def _addend_is_gone(self, ended: float, blow: str, what: str) -> None:
        """What the dead tuner added to the control has faded; while a controller has no turn it cannot fade."""
        if self.victim != "fopid_tuner" or blow == "stop":
            return
        rig = self.rig
        rig.wait(lambda: rig.samples(STATE, ended + ADDEND_GONE), f"a state after {what}", BACK)
        addends = rig.samples(STATE, ended)
        gone = gone_at(addends)
        assert gone is not None, what
        if addends[0][1]:
            self.tally.addends.append(gone - ended)
            ticks = [time for time, _ in addends if time <= gone]
            assert gone - ended < ADDEND_GONE + longest_silence([ended, *ticks]), what

    def _end(self, asked: Future | None, goal: Any, *, answers: bool, what: str) -> None:
        """Nothing goes on into the next instant: a tuner that has lived through the blow gives its answer first."""
        if goal is not None:
            goal.cancel_goal_async()
        if asked is not None and answers:
            self.rig.wait(asked.done, f"an answer after {what}", ANSWER)
        self.rig.graph.await_restarted("fopid_controller")
        self.rig.graph.await_restarted("fopid_tuner")

    def _gains_are_as_promised(self, before: list[float], work: str, what: str) -> None:
        """Those from before, or newer ones that were verified; and no trial lasts."""
        began = time.monotonic()
        while (now := self.gains())[1] == "trial":
            assert time.monotonic() - began < TRIAL_GONE, f"gains still on trial after {what}"
            self.graph.spin(0.2)
        gains, status = now
        if gains == before:
            return
        assert status == "verified", f"{gains}, {status} after {what}"
        assert work in ("applying", "autotuning"), what
        assert gains not in self._former, f"older gains are back after {what}"
        self._former.append(before)
        true = Loop(read_process(PROCESS), Fopid(*gains))
        assert stability(true).stable, f"{gains} after {what}"
        assert margins(true).ms < 3.0, f"{gains} after {what}"

    def _controls_are_within_limits(self, began: float, what: str) -> None:
        controls = self.rig.samples("control", began)
        assert not outside_limits(controls, *LIMITS), what
        values = [value for _, value in controls]
        tally = self.tally
        tally.controls += len(values)
        tally.lowest, tally.highest = min([*values, tally.lowest]), max([*values, tally.highest])

    def _controls_went_on(self, struck: float, back: float, what: str) -> None:
        """While another node was away and came back, the controller ticked."""
        if self.victim == "fopid_controller":
            return
        meanwhile = [time for time, _ in self.rig.samples("control", struck - 0.2) if time < back + 1.0]
        self.tally.silences.append(longest_silence(meanwhile))
        assert self.tally.silences[-1] < SILENT, what


@pytest.mark.parametrize("chunk", range(CHUNKS))
@pytest.mark.parametrize("victim", ["fopid_tuner", "fopid_controller", "plant_simulator", "dashboard"])
def test_a_loop_survives_its_nodes(rig: Rig, victim: str, chunk: int, figures: Callable[..., None]) -> None:
    campaign = Campaign(rig, victim, random.Random(f"{victim} {chunk}"))
    instants = share_of(INSTANTS // CHUNKS)
    for _ in range(instants):
        campaign.instant()
    assert "internal error" not in rig.logs()
    tally = campaign.tally
    figures(f"kills-{victim}-{chunk}", victim=victim, instants=instants, recovered=tally.recovered,
            addends=tally.addends, silences=tally.silences, controls=tally.controls, lowest=tally.lowest,
            highest=tally.highest, blows=tally.blows)  # fmt: skip
