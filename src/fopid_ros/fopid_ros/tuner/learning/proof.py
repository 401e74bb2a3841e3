"""New gains that a loop rests with are moved once more, and compared at rest with those from before."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from fopid_core.model.process import Process
from fopid_core.runtime.convolved_plant import plant_of
from fopid_core.runtime.excitation import Excitation
from fopid_core.runtime.plant import PlantSettings
from fopid_ros.tuner.learning.closed_loop_experiment import (
    LEAST_TICKS,
    MOST_LARGER,
    MOST_SHARE,
    PROBE_SHARE_UNTIL_KNOWN,
    PROBES,
    SEEN_SWINGS,
    ClosedLoopExperiment,
    ExperimentSettings,
)
from fopid_ros.tuner.learning.loop_baseline import LoopBaseline, half_range, spread_about_drift
from fopid_ros.tuner.learning.loop_tap import LoopTap, Tick
from fopid_ros.tuner.learning.loop_wait import LoopWait, Stage
from fopid_ros.tuner.learning.reach import Reach

PROVED_RESPONSES, MOVED_ENOUGH = 2.0, 2.0
"""How long a move is held to see whether gains bear it, in response times; how much further it went before, at most."""
SWING_SHARE, DYING = 0.25, 0.7
"""A loop that still swings by more than that share of what it was moved by, and by more than that share of as long a
time before, does not come to rest."""
PROVED_SHARE, WORTH_A_MOVE = 0.5, 1.5
"""How far of the allowed deviation it is moved in the end, and from which factor on once more for that."""
PULSES, CAREFUL, SEEN, MOST_TICKS = 4, 0.5, 5.0, 20_000
"""So many pulses show how fast the actuator is, after one that is meant to go so far of that. Each is answered by so
many standard deviations of the noise, summed over the answer; after it so many ticks are looked at, at most."""
WORKED_OUT_ANEW = 20.0
"""About how long it takes to learn what was shown meanwhile, and how slow the actuator may be [s]; that depends on the
computer."""
RESTLESS, UNEASY, GROWING = 3.0, 1.5, 1.2
"""A loop whose measurement spreads at rest by so many times what it did before hunts: a good loop makes at most twice
its noise of it (max |S|). From so many on it is looked at for longer, while each window shows so many times more."""


def _answer_to_a_pulse(process: Process, sample_time: float, ticks: int) -> tuple[float, float]:
    """Peak and root of the summed squares, over some ticks after a process's control was moved by 1 for one of them."""
    plant = plant_of(PlantSettings(process, sample_time, delay_model="exact"))
    answer = [plant.step(move) for move in (1.0, *[0.0] * min(ticks, MOST_TICKS))]
    return max(abs(each) for each in answer), math.hypot(*answer)


class Proof(ClosedLoopExperiment):
    """Moves a loop with new gains as far as it was moved to learn them, then further, and sees it come to rest.

    With play, dry friction and whatever else no linear model knows a loop that rests may swing on once it is moved,
    or hunt for ever. An actuator that is slow shows that in large moves only.

    Parameters
    ----------
    tap, wait, loop, wanted, before
        As of `ClosedLoopExperiment`.
    rest : LoopBaseline
        How the loop was at rest before its gains were changed.
    """

    def __init__(
        self, tap: LoopTap, wait: LoopWait, loop: LoopBaseline, wanted: ExperimentSettings, before: Reach,
        rest: LoopBaseline,
    ) -> None:  # fmt: skip
        super().__init__(tap, wait, loop, wanted, before)
        self._rest = rest
        self._answer = 0.0

    def usual_time(self, response_time: float) -> float:
        """About how long it takes [s]: rest, two moves there and back, what is looked at after them, pulses."""
        hold, window = self._held_and_watched(response_time)
        return 2.0 * self.rest_window + 4.0 * hold + 3.0 * window + WORKED_OUT_ANEW

    def _held_and_watched(self, response_time: float) -> tuple[float, float]:
        """How long a move is held, and how long is looked whether the loop rests after it [s]."""
        hold = max(PROBE_SHARE_UNTIL_KNOWN * self.duration, PROVED_RESPONSES * response_time)
        return hold, max(PROVED_RESPONSES * response_time, self.rest_window)

    def prove(self, response_time: float) -> str:
        """Move the loop and look.

        Parameters
        ----------
        response_time : float
            Of the loop [s].

        Returns
        -------
        str
            What speaks against the gains; empty where nothing does, or nothing could be seen.
        """
        hold, window = self._held_and_watched(response_time)
        against = self._moved_as_before(hold)
        while not against:
            against, larger = self._swings_on(window), self._larger()
            if against or larger <= WORTH_A_MOVE:
                break
            against = self._moved(larger * self._amplitude, hold)
        return against or self._hunts()

    def pulse(self, process: Process, response_time: float) -> str:
        """Show how fast the actuator is by pulses: moves as large as any, too short to take the measurement far.

        An actuator that has not come to where it was told when it is told to come back leaves less of an answer for
        good; one that has is merely later. So pulses are as short as are seen.

        Parameters
        ----------
        process : Process
            As it was learnt; it says how short.
        response_time : float
            Of the loop [s].

        Returns
        -------
        str
            As of ``prove``.
        """
        tick, allowed, most = self.loop.controller.sample_time, PROVED_SHARE * self.loop.deviation_max, self._most()
        window = max(PROVED_RESPONSES * response_time, self.rest_window)
        peak, size = _answer_to_a_pulse(process, tick, math.ceil(window / tick))
        area = allowed / max(peak, 1e-300)  # ticks of a unit move
        seen = min(SEEN * self.loop.unrest / max(most * size, 1e-300), response_time / tick)
        share, larger, made, against = CAREFUL, 1.0, 0, ""
        while made < PULSES and not against:
            ticks = max(round(min(seen, share * area / most)), LEAST_TICKS)
            wanted = min(most, share * area / ticks)
            amplitude = min(wanted, larger * self._amplitude)
            against = self._moved(amplitude, ticks * tick)
            self._watched(PROVED_RESPONSES * response_time)
            made += share == 1.0 and amplitude == wanted
            area = min(area, amplitude * ticks * allowed / max(self._peak, 1e-300))  # as the process itself answered
            share, larger = 1.0, MOST_LARGER
        return against or self._swings_on(window)

    def _moved_as_before(self, hold: float) -> str:
        """Find, from below, what moves the measurement as far as before; why a move was broken off."""
        before, most = self._before, self._wanted.amplitude or self._most()
        wanted = min(before.moved, MOST_SHARE * self.loop.deviation_max)
        amplitude = min(before.amplitude, most)
        for _ in range(PROBES):
            against = self._moved(amplitude, hold)
            larger = wanted / max(self._peak, 1e-300)
            if against or larger <= MOVED_ENOUGH or amplitude == most:
                break
            amplitude = min(amplitude * min(larger, MOST_LARGER), most)
        return against

    def _moved(self, amplitude: float, hold: float) -> str:
        """Move it there and back; what broke that off, where the loop did."""
        self._amplitude = amplitude
        excitation = Excitation(self._settings("step", amplitude, 2.0 * hold))
        self._run_excitation(excitation, lambda: 0.5)
        return "" if excitation.completed else self.escaped

    def _larger(self) -> float:
        """By how much it may be moved further than it was last; 1 where nobody says how far, or it has been enough.

        The largest answer to a move counts, beyond what it does by itself: a disturbance may come in the way of one.
        """
        asked, limited = self._wanted.amplitude, math.isfinite(self.loop.controller.control_range)
        if asked or not limited or self._tap.history.newest("setpoint") != self.loop.setpoint:
            return 1.0
        self._answer = max(self._answer, (self._peak - self.loop.swing) / self._amplitude)
        answer = max(self._answer * self._amplitude, self._peak, 1e-300)
        further = PROVED_SHARE * self.loop.deviation_max / answer
        return min(further, self._most() / self._amplitude, MOST_LARGER)

    def _swings_on(self, window: float) -> str:
        """Whether it does not come to rest after it was moved, looked at in windows of so much time [s]."""
        loop = self.loop
        most = max(SWING_SHARE * self._peak, SEEN_SWINGS * loop.swing, SEEN_SWINGS * loop.least_move)
        swing, last = self._once_small(half_range, most, window)
        if swing <= most:
            return ""
        told = f"swings by {swing:.3g} to either side, by {last:.3g} before"
        return f"the measurement does not come to rest once moved by {self._peak:.3g}, but {told}"

    def _hunts(self) -> str:
        """Whether it moves far more at rest than it did before its gains were changed, looked at for as long."""
        rest = self._rest
        usual = max(rest.spread, rest.least_move, self._quantisation())
        spread, _ = self._once_small(spread_about_drift, RESTLESS * usual, rest.figures.duration)
        while UNEASY * usual < spread <= RESTLESS * usual:  # a swing that grows is small at first
            later, _ = self._once_small(spread_about_drift, math.inf, rest.figures.duration)
            if later <= GROWING * spread:
                break
            spread = later
        if spread <= RESTLESS * usual:
            return ""
        return f"the loop hunts: at rest the measurement spreads by {spread:.3g}, by {usual:.3g} before"

    def _once_small(self, size: Callable[[Sequence[float]], float], most: float, window: float) -> tuple[float, float]:
        """How much the measurement moves once that is small, or dies out no more; and in the window before.

        0 where the setpoint is moved meanwhile.
        """
        setpoint, now = self.loop.setpoint, math.inf
        while True:
            ticks = self._watched(window)
            if any(tick.setpoint != setpoint for tick in ticks):
                return 0.0, 0.0
            last, now = now, size([tick.measurement for tick in ticks])
            if now <= most or now > DYING * last:
                return now, last

    def _watched(self, window: float) -> list[Tick]:
        """The ticks of so much time [s]."""
        ticks: list[Tick] = []
        self._tap.set_tick_hook(ticks.append)
        self._wait.until(
            lambda: bool(ticks) and ticks[-1].time - ticks[0].time >= window,
            lambda: Stage("watching", 0.9, message=f"does it come to rest, once moved by {self._amplitude:.3g}?"),
        )
        return ticks
